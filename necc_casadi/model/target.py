"""``--target`` text to an exact equilibrium x*: the states not given are solved for."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import sympy as sp

from necc_casadi.arrays import Vector
from necc_casadi.errors import TargetError
from necc_casadi.model.control_affine import ControlAffine, Equilibria
from necc_casadi.symbolic.elimination import eliminated
from necc_casadi.symbolic.expressions import parse_number
from necc_casadi.symbolic.floats import to_floats
from necc_casadi.symbolic.linear_algebra import kernel
from necc_casadi.symbolic.zero import Undecided, is_zero

__all__ = [
    "free_coordinates",
    "nearest_equilibrium",
    "parse_target",
    "solve_target",
    "target_from_model",
]


#: Digits to which roots are evaluated, and the share of one that is no imaginary part.
_DIGITS, _REAL = 30, 1e-12


#: Relative to the largest singular value of an equilibrated matrix; what is smaller counts as 0.
_RELATIVE = 1e-9

_CONVERGED, _NEWTON_STEPS, _SCALINGS = 1e-12, 60, 8


def parse_target(
    plant: Equilibria, text: str, own: Mapping[str, sp.Expr] | None = None
) -> dict[sp.Symbol, sp.Expr]:
    """x* from ``pi/4``, ``q=pi/4``, ``q1=pi/4,q2=-pi/3`` or all states in order.

    Parameters
    ----------
    plant
        Whose equilibrium condition gives the states that are not named.
    text
        Constant expressions, in the units of the model.
    own
        The ``target`` of the model file: of several equilibria that fit the text it is meant.

    Returns
    -------
    dict
        Exact value of each of the n states. Where all are given they are taken as they are: the
        verdict says whether they are an equilibrium.

    Raises
    ------
    TargetError
        ``target_length, target_value, target_ambiguous, duplicate_state``; see
        docs/contract.md#errors.

    Examples
    --------
    >>> from necc_casadi import load_model, parse_target
    >>> parse_target(load_model("pendulum.py").loop.plant, "q=pi/4")
    {q: pi/4, p: 0}
    """
    entries = _split(text)
    named = [entry for entry in entries if "=" in entry]
    if named and len(named) < len(entries):
        raise TargetError(
            "target_value",
            f"--target {text}: some values have a name and some have none",
            "Name all of them (q=pi/4,p=0) or none (pi/4,0).",
        )
    if named:
        return _completed(plant, _named_values(plant, entries), own)
    values = [_number(entry) for entry in entries]
    if len(values) == plant.n:
        return dict(zip(plant.x, values, strict=True))
    free = _free_for(plant, len(values), text)
    return _completed(plant, dict(zip(free, values, strict=True)), own)


def _completed(
    plant: Equilibria, given: Mapping[sp.Symbol, sp.Expr], own: Mapping[str, sp.Expr] | None
) -> dict[sp.Symbol, sp.Expr]:
    """The equilibrium with these values; of several the model's own target, where it is one."""
    try:
        return solve_target(plant, given)
    except TargetError as several:
        if several.code != "target_ambiguous" or own is None:
            raise
        meant = target_from_model(plant, own)
        if not all(is_zero(meant[s] - value) is True for s, value in given.items()):
            raise
        return meant


def target_from_model(plant: Equilibria, given: Mapping[str, sp.Expr]) -> dict[sp.Symbol, sp.Expr]:
    """x* from the ``target`` of a model file, {state: value}.

    Raises
    ------
    TargetError
        As :func:`parse_target`.
    """
    symbols = dict(zip(plant.states, plant.x, strict=True))
    for name, value in given.items():
        if name not in symbols:
            raise TargetError(
                "target_value",
                f"target names {name}, which is no state of the plant",
                f"States: {', '.join(plant.states)}.",
            )
        if not value.is_number or value.is_real is not True:
            raise TargetError(
                "target_value", f"target[{name}] = {value} is not a real number", "Give a constant."
            )
    return solve_target(plant, {symbols[name]: value for name, value in given.items()})


def _split(text: str) -> list[str]:
    """Split at commas outside parentheses."""
    parts, depth, current = [], 0, ""
    for character in text:
        depth += (character == "(") - (character == ")")
        if character == "," and depth == 0:
            parts.append(current)
            current = ""
        else:
            current += character
    return [*parts, current]


def _number(text: str, label: str = "--target") -> sp.Expr:
    return parse_number(text, label, "target_value", TargetError)


def _named_values(plant: Equilibria, entries: list[str]) -> dict[sp.Symbol, sp.Expr]:
    symbols = dict(zip(plant.states, plant.x, strict=True))
    given: dict[sp.Symbol, sp.Expr] = {}
    for entry in entries:
        name, _, value = (part.strip() for part in entry.partition("="))
        if name not in symbols:
            raise TargetError(
                "target_value",
                f"--target {entry.strip()}: {name} is no state of the plant",
                f"States: {', '.join(plant.states)}.",
            )
        if symbols[name] in given:
            raise TargetError(
                "duplicate_state", f"--target gives {name} twice", "Give each state once."
            )
        given[symbols[name]] = _number(value, f"--target {name}")
    return given


def _free_for(plant: Equilibria, count: int, text: str) -> list[sp.Symbol]:
    """The coordinates that `count` bare values stand for."""
    free, dimension = free_coordinates(plant)
    names = ", ".join(map(str, free))
    if count == dimension == len(free):
        return free
    if count != dimension:
        raise TargetError(
            "target_length",
            f"--target {text} has {count} value{'s' * (count != 1)}, but the equilibria form a set "
            f"of dimension {dimension}",
            f"Give {dimension} of {names or '(none)'}, or all {plant.n} states: "
            f"{', '.join(plant.states)}.",
        )
    raise TargetError(
        "target_ambiguous",
        f"--target {text}: the values could stand for any {dimension} of {names}",
        "Name them: " + " or ".join(f"{symbol}={text}" for symbol in free[:4]) + ".",
    )


def free_coordinates(plant: Equilibria) -> tuple[list[sp.Symbol], int]:
    """Coordinates that vary along the equilibrium set, and the dimension of that set.

    Read off the kernel of the equilibrium equations' Jacobian at equilibria found from several
    starts; it interprets bare values only, every target is checked exactly afterwards.
    """
    written = sp.Matrix(_equilibrium_equations(plant))
    symbolic = written.jacobian(plant.x) if written else sp.zeros(0, plant.n)
    if symbolic.is_zero_matrix or all(entry.is_Rational for entry in symbolic):
        null = kernel(symbolic)
        along = [s for i, s in enumerate(plant.x) if any(null[i, j] != 0 for j in range(null.cols))]
        return along, null.cols
    varies, dimension = np.zeros(plant.n, bool), 0
    equations = _equations(plant)
    for seed in range(4):
        point = _project(equations, np.random.default_rng(seed).uniform(-1, 1, plant.n))
        if point is None:
            continue
        null_space = _null_space(equations.jacobian(point))
        dimension = max(dimension, null_space.shape[1])
        varies |= np.linalg.norm(null_space, axis=1) > _RELATIVE
    return [s for s, v in zip(plant.x, varies, strict=True) if v], dimension


def _equilibrium_equations(plant: Equilibria) -> tuple[sp.Expr, ...]:
    """Those of the plant; constants of G that may or may not be 0 are taken not to be.

    The verdict on the target looks at G as it is.
    """
    try:
        return plant.equilibrium_equations
    except Undecided:
        unknown = [e for e in plant.directions if e.is_number and is_zero(e) is None]
        acting = plant.directions.xreplace(dict.fromkeys(unknown, sp.Integer(1)))
    try:
        return ControlAffine("", plant.x, plant.drift, acting).equilibrium_equations
    except Undecided:
        return ()


def _null_space(matrix: Vector) -> Vector:
    """A basis of the null space, in coordinates in which every row and column has size 1."""
    if matrix.shape[0] == 0:
        return np.eye(matrix.shape[1])
    _, values, right = np.linalg.svd(_equilibrated(matrix)[0])
    rank = int(np.sum(values > _RELATIVE * values[0])) if values[0] > 0 else 0
    null: Vector = right[rank:].T
    return null


def _equilibrated(matrix: Vector) -> tuple[Vector, Vector, Vector]:
    """(r·A·c, r, c): rows and columns scaled until each has a largest entry of about 1.

    The units of states and equations cancel; which coordinates a kernel vector has does not
    change.
    """
    rows, columns = np.ones(matrix.shape[0]), np.ones(matrix.shape[1])
    for _ in range(_SCALINGS):
        scaled = np.abs(rows[:, None] * matrix * columns)
        rows = rows / np.sqrt(_or_one(scaled.max(1)))
        scaled = np.abs(rows[:, None] * matrix * columns)
        columns = columns / np.sqrt(_or_one(scaled.max(0)))
    return rows[:, None] * matrix * columns, rows, columns


def _or_one(sizes: Vector) -> Vector:
    return np.where(sizes > 0, sizes, 1.0)


@dataclass(frozen=True)
class _Equations:
    """Residual r: (n,) → (k,) of the equilibrium equations, and its Jacobian (n,) → (k, n)."""

    residual: Callable[[Vector], Vector]
    jacobian: Callable[[Vector], Vector]


def _equations(plant: Equilibria) -> _Equations:
    equations = sp.Matrix(_equilibrium_equations(plant))
    if not equations:
        return _Equations(lambda x: np.zeros(0), lambda x: np.zeros((0, plant.n)))
    residual = sp.lambdify([plant.x], equations, "numpy", cse=True)
    jacobian = sp.lambdify([plant.x], equations.jacobian(plant.x), "numpy", cse=True)
    return _Equations(
        lambda x: np.asarray(residual(x), float).ravel(),
        lambda x: np.asarray(jacobian(x), float),
    )


def _project(equations: _Equations, x: Vector) -> Vector | None:
    """A point of the equilibrium set near x, by Gauss–Newton; None if it does not converge."""
    with np.errstate(all="ignore"):
        for _ in range(_NEWTON_STEPS):
            r, slopes = equations.residual(x), equations.jacobian(x)
            if not (np.all(np.isfinite(r)) and np.all(np.isfinite(slopes))):
                return None
            scaled, rows, columns = _equilibrated(slopes)
            step = columns * (np.linalg.pinv(scaled, rcond=_RELATIVE) @ (rows * r))
            x = x - step
            if np.all(np.abs(step) <= _CONVERGED * (np.abs(x) + columns)):
                return np.where(np.abs(x) <= _CONVERGED * columns, 0.0, x)
    return None


def nearest_equilibrium(plant: Equilibria, x_star: Mapping[sp.Symbol, sp.Expr]) -> Vector | None:
    """The equilibrium that Gauss–Newton finds from x*, (n,), to suggest it; None if none."""
    return _project(_equations(plant), to_floats(x_star[s] for s in plant.x))


def solve_target(plant: Equilibria, given: Mapping[sp.Symbol, sp.Expr]) -> dict[sp.Symbol, sp.Expr]:
    """Solve the equilibrium equations for the states that are not in `given`.

    Where they have no solution the missing states become 0: the verdict says why the target
    cannot be held.

    Raises
    ------
    TargetError
        ``target_ambiguous`` where several solutions, or a free coordinate, remain.
    """
    unknown = [s for s in plant.x if s not in given]
    if not unknown:  # nothing to solve: the equations may be long
        return {s: given[s] for s in plant.x}
    solutions = _solutions(plant, given, unknown)
    if not solutions:
        return {s: given.get(s, sp.Integer(0)) for s in plant.x}
    loose = [s for s in unknown if any(s not in sol or sol[s].free_symbols for sol in solutions)]
    if loose:
        names = ", ".join(map(str, loose))
        raise TargetError(
            "target_ambiguous",
            f"--target leaves {names} free: equilibria exist for many values",
            f"Give {names} too.",
        )
    if len(solutions) > 1:
        shown = [",".join(f"{s}={_short(sol[s])}" for s in unknown) for sol in solutions[:6]]
        raise TargetError(
            "target_ambiguous",
            f"--target fits {len(solutions)} equilibria: " + "; ".join(shown),
            "Name the one that is meant, e.g. --target "
            + ",".join(f"{s}={_short(v)}" for s, v in (dict(given) | solutions[0]).items())
            + ".",
        )
    return {s: given[s] if s in given else solutions[0][s] for s in plant.x}


def _short(value: sp.Expr) -> str:
    return str(sp.sstr(value)).replace(" ", "")


def _solutions(
    plant: Equilibria, given: Mapping[sp.Symbol, sp.Expr], unknown: list[sp.Symbol]
) -> list[dict[sp.Symbol, sp.Expr]]:
    """All real solutions; linear equations first, then sympy's solver on what remains."""
    equations = [sp.simplify(e.subs(given)) for e in _equilibrium_equations(plant)]
    solved, left = eliminated(equations, unknown)
    if any(_contradicts(e) for e in left):
        return []
    equations = [e for e in left if e.free_symbols]
    rest = [s for s in unknown if s not in solved]
    if not equations:
        return [solved]
    try:
        found = sp.solve(equations, rest, dict=True)
    except NotImplementedError:
        raise TargetError(
            "target_ambiguous",
            "--target: the states that are not given cannot be solved in closed form",
            f"Give all states in order: {', '.join(plant.states)}.",
        ) from None
    real = [sol for sol in found if not any(_is_complex(v) for v in sol.values())]
    return [{s: v.subs(sol) for s, v in solved.items()} | sol for sol in real]


def _is_complex(value: sp.Expr) -> bool:
    """Whether a solution is not real; a cubic's real roots may be written with i."""
    if value.is_real is not None or value.free_symbols:
        return value.is_real is False
    number = complex(value.evalf(_DIGITS))
    return abs(number.imag) > _REAL * abs(number)


def _contradicts(equation: sp.Expr) -> bool:
    """Whether an equation e = 0 is certainly violated; a constant that may be 0 says nothing."""
    return not equation.free_symbols and is_zero(equation) is False
