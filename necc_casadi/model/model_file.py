"""A user's model file to Plant and Controller; every number in it is taken as exact.

A model file is Python and runs as the user's own code. Only ``x, J, R, G, H`` are required.
"""

from __future__ import annotations

import contextlib
import sys
import traceback
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import numpy as np
import sympy as sp

from necc_casadi.arrays import Vector
from necc_casadi.errors import InputError, ModelError, OptionError
from necc_casadi.model.closed_loop import ClosedLoop, interconnect
from necc_casadi.model.controller import Controller, default_controller, make_controller
from necc_casadi.model.plant import make_plant
from necc_casadi.model.sizes import input_names
from necc_casadi.symbolic.expressions import exact, parse_number

__all__ = ["Model", "damping_matrix", "load_model"]


_REQUIRED = ("x", "J", "R", "G", "H")


_OPTIONAL = (
    "params", "xi", "Jc", "Rc", "Gc", "casimirs", "target", "domain", "sizes", "D", "Dc",
    "u_limits", "units", "name",
)  # fmt: skip


#: Names at least this long are compared with what the file defines; alike from this ratio on.
_LONG, _ALIKE = 4, 0.8


@dataclass(frozen=True, eq=False)
class Model:
    """What a model file says (docs/contract.md#model-file).

    Examples
    --------
    >>> from necc_casadi import load_model
    >>> model = load_model("pendulum.py")
    >>> model.loop.plant.H
    p**2/2 - cos(q) + 1
    >>> model.target is None, model.D is None
    (True, True)
    """

    loop: ClosedLoop
    casimirs: tuple[sp.Expr, ...] = ()  # supplied by the user, not yet proved
    target: Mapping[str, sp.Expr] | None = None  # state -> value
    D: Vector | None = None  # m × m
    Dc: Vector | None = None  # m × m
    notes: tuple[str, ...] = ()  # names in the file that look mistyped


def load_model(path: str | Path, overrides: Mapping[str, str] | None = None) -> Model:
    """Run a model file and check everything in it.

    Parameters
    ----------
    path
        The model file.
    overrides
        Values of parameters by name, as texts (``--param``).

    Returns
    -------
    Model
        Exact and checked; the target, supplied Casimirs and damping as the file gives them.

    Raises
    ------
    ModelError
        With the code of the first fault; docs/contract.md#errors lists them.

    Examples
    --------
    >>> from necc_casadi import load_model
    >>> load_model("pendulum.py").loop.plant.states
    ('q', 'p')
    >>> load_model("pendulum.py", {"k": "4"})
    Traceback (most recent call last):
    necc_casadi.errors.ModelError: --param k: the model has no parameter k
    Its parameters: none.
    """
    path = Path(path)
    space = _execute(path)
    missing = [name for name in _REQUIRED if name not in space]
    if missing:
        raise ModelError(
            "model_file",
            f"{path.name} does not define {', '.join(missing)}",
            "A model file defines x, J, R, G and H with sympy.",
        )
    try:
        return replace(_build(path, space, overrides or {}), notes=_mistyped(space))
    except InputError:
        raise
    except (TypeError, ValueError, AttributeError, KeyError, IndexError) as problem:
        raise ModelError(
            "model_file",
            f"{path.name}: a name has a value of the wrong kind ({' '.join(str(problem).split())})",
            "Compare it with examples/pendulum.py.",
        ) from None


def _execute(path: Path) -> dict[str, Any]:
    """Run the file; what it prints goes to stderr, so that stdout stays ours."""
    try:
        source = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as problem:
        reason = problem.strerror if isinstance(problem, OSError) else "not UTF-8 text"
        raise ModelError(
            "model_file", f"{path} cannot be read: {reason}", "Name a model file in Python."
        ) from None
    space: dict[str, Any] = {"__name__": "necc_model", "__file__": str(path)}
    sys.path.insert(0, str(path.resolve().parent))
    try:
        with contextlib.redirect_stdout(sys.stderr):
            exec(compile(source, str(path), "exec"), space)
    except SyntaxError as problem:
        raise ModelError(
            "model_file",
            f"{path.name}, line {problem.lineno}: {problem.msg}",
            "Correct the Python syntax there.",
        ) from None
    except (Exception, SystemExit) as problem:
        frames = traceback.extract_tb(problem.__traceback__)
        line = next((f.lineno for f in reversed(frames) if f.filename == str(path)), "?")
        text = " ".join(str(problem).split()) or type(problem).__name__
        raise ModelError(
            "model_file",
            f"{path.name}, line {line}: {type(problem).__name__}: {text}",
            "Run the file with python to see the whole error.",
        ) from None
    finally:
        sys.path.remove(str(path.resolve().parent))
    return space


def _mistyped(space: Mapping[str, Any]) -> tuple[str, ...]:
    """Names that nothing reads, though they look like an optional name that the file lacks."""
    absent = [name for name in _OPTIONAL if name not in space and len(name) >= _LONG]
    near = {
        name: get_close_matches(name, absent, n=1, cutoff=_ALIKE)
        for name in space
        if name not in (*_REQUIRED, *_OPTIONAL) and not name.startswith("_")
    }
    return tuple(
        f"the model file's {name} is not read: did you mean {meant[0]}?"
        for name, meant in near.items()
        if meant
    )


def _build(path: Path, space: dict[str, Any], overrides: Mapping[str, str]) -> Model:
    states, xi = _symbols(space["x"], "x"), _symbols(space.get("xi", ()), "xi")
    values = _substitutions(space, states, xi, overrides)

    def read(value: Any) -> Any:
        if isinstance(value, sp.MatrixBase):
            return value.applyfunc(lambda entry: exact(entry).xreplace(values))
        if isinstance(value, (list, tuple, np.ndarray)):
            return [read(entry) for entry in value]
        expr = exact(value)
        return expr.xreplace({s: values.get(s, _real(s)) for s in expr.free_symbols})

    def attempt(value: Any) -> Any:
        try:
            return read(value)
        except (TypeError, ValueError, AttributeError):
            return value  # make_plant names it and says what would work

    plant = make_plant(
        [_real(s) for s in states],
        *(attempt(space[key]) for key in ("J", "R", "G", "H")),
        name=str(space.get("name", path.stem)),
        units={str(key): str(unit) for key, unit in dict(space.get("units", {})).items()},
        u_limits=_limits(space.get("u_limits"), read),
    )
    controller = _controller(plant, space, [_real(s) for s in xi], read)
    loop = interconnect(plant, controller)
    domain = _domain(dict(space.get("domain", {})), loop.states, read)
    sizes = _sizes(dict(space.get("sizes", {})), (*loop.states, *input_names(plant.m)), read)
    loop = replace(loop, plant=replace(plant, domain=domain, sizes=sizes))
    target = space.get("target")
    return Model(
        loop=loop,
        casimirs=tuple(read(c) for c in space.get("casimirs", ())),
        target=None if target is None else {str(k): read(v) for k, v in dict(target).items()},
        D=_damping(space.get("D"), plant.m, "D", read),
        Dc=_damping(space.get("Dc"), plant.m, "Dc", read),
    )


def _symbols(value: Any, label: str) -> list[Any]:
    if isinstance(value, sp.Symbol):
        return [value]
    try:
        return list(value)
    except TypeError:
        raise ModelError(
            "shape", f"{label} = {value!r} is not a tuple of symbols", f"Write {label} = (q, p)."
        ) from None


def _real(symbol: Any) -> Any:
    """The same symbol, real: models need not say so."""
    return sp.Symbol(symbol.name, real=True) if isinstance(symbol, sp.Symbol) else symbol


def _substitutions(
    space: dict[str, Any], states: list[Any], xi: list[Any], overrides: Mapping[str, str]
) -> dict[sp.Symbol, sp.Expr]:
    """Every symbol of the file -> a real state symbol or the exact value of a parameter."""
    params = {str(key): value for key, value in dict(space.get("params", {})).items()}
    for name in overrides:
        if name not in params:
            known = ", ".join(params) or "none"
            raise ModelError(
                "param",
                f"--param {name}: the model has no parameter {name}",
                f"Its parameters: {known}.",
            )
    names = {str(s) for s in (*states, *xi)}
    exact_values: dict[str, sp.Expr] = {}
    for name, value in params.items():
        if name in names:
            raise ModelError(
                "name_clash",
                f"{name} is a state and a parameter",
                "Rename one of them.",
            )
        text = overrides.get(name)
        number = (
            parse_number(text, f"--param {name}", "param", ModelError)
            if text is not None
            else value
        )
        number = exact(sp.sympify(number))
        if not number.is_number or number.is_real is not True:
            raise ModelError(
                "param", f"params[{name}] = {number} is not a real number", "Give it a number."
            )
        exact_values[name] = number
    everything = {s for s in (*states, *xi) if isinstance(s, sp.Symbol)}
    for value in space.values():
        if isinstance(value, (sp.Basic, sp.MatrixBase)):
            everything |= value.free_symbols
        elif isinstance(value, (list, tuple)):
            for entry in value:
                everything |= getattr(entry, "free_symbols", set())
    everything |= {key for key in dict(space.get("params", {})) if isinstance(key, sp.Symbol)}
    return {s: exact_values.get(str(s), _real(s)) for s in everything}


def _controller(plant: Any, space: dict[str, Any], xi: list[Any], read: Any) -> Controller:
    given = [key for key in ("xi", "Jc", "Rc", "Gc") if key in space]
    if not given:
        return default_controller(plant)
    if "xi" not in space:
        nc = max((sp.Matrix(read(space[key])).rows for key in given), default=plant.m)
        xi = list(sp.symbols([f"xi{i + 1}" for i in range(nc)], real=True))
    nc = len(xi)
    defaults = {"Jc": sp.zeros(nc, nc), "Rc": sp.zeros(nc, nc), "Gc": sp.eye(nc)}
    matrices = [read(space[key]) if key in space else defaults[key] for key in defaults]
    return make_controller(plant, xi, *matrices)


def _limits(value: Any, read: Any) -> list[tuple[float, float]] | None:
    if value is None:
        return None
    result = []
    for index, pair in enumerate(value if isinstance(value, (list, tuple)) else [value]):
        try:
            lo, hi = (float(read(bound)) for bound in pair)
        except (TypeError, ValueError):
            lo, hi = 1.0, 0.0
        if not lo < hi:
            raise ModelError(
                "limits",
                f"u_limits[{index}] = {pair} is not a pair (lo, hi) with lo < hi",
                "Give one pair of numbers per input.",
            )
        result.append((lo, hi))
    return result


def _domain(
    value: Mapping[Any, Any], states: Sequence[str], read: Any
) -> dict[str, tuple[sp.Expr, sp.Expr]]:
    result = {}
    for key, bounds in value.items():
        name = str(key)
        if name not in states:
            raise ModelError(
                "domain", f"domain names {name}, which is no state", f"States: {', '.join(states)}."
            )
        try:
            lo, hi = (read(bound) for bound in bounds)
            ordered = bool(lo < hi) and bool(lo.is_finite and hi.is_finite)
        except (TypeError, ValueError, AttributeError):
            ordered = False
        if not ordered:
            raise ModelError(
                "domain",
                f"domain[{name}] = {bounds} is not a pair (lo, hi) with lo < hi",
                "Give two finite numbers.",
            )
        result[name] = (lo, hi)
    return result


def _sizes(value: Mapping[Any, Any], names: Sequence[str], read: Any) -> dict[str, sp.Expr]:
    result = {}
    for key, size in value.items():
        name = str(key)
        if name not in names:
            raise ModelError(
                "model_file",
                f"sizes names {name}, which is no state and no input",
                f"States and inputs: {', '.join(names)}.",
            )
        try:
            number = read(size)
            positive = bool(number > 0) and bool(number.is_finite)
        except (TypeError, ValueError, AttributeError):
            positive = False
        if not positive:
            raise ModelError(
                "model_file",
                f"sizes[{name}] = {size} is not a positive number",
                "Give what a large value of it is.",
            )
        result[name] = number
    return result


def _damping(value: Any, m: int, label: str, read: Any) -> Vector | None:
    if value is None:
        return None
    try:
        numbers = np.array(
            sp.Matrix(sp.sympify(read(value))).evalf()
            if isinstance(value, (list, tuple, sp.MatrixBase, np.ndarray))
            else [[read(value)]],
            dtype=float,
        )
    except (TypeError, ValueError):
        raise ModelError(
            "model_file", f"{label} = {value} is not numeric", "Give a number or a matrix."
        ) from None
    return damping_matrix(numbers, m, label, ModelError, "model_file")


def damping_matrix(
    value: Vector, m: int, label: str, error: type[InputError] = OptionError, code: str = "usage"
) -> Vector:
    """An m × m damping matrix from a number, a diagonal or a matrix; it must be ≻ 0.

    Raises
    ------
    InputError
        Of the given class and code, when the shape or the definiteness is wrong.
    """
    numbers = np.atleast_1d(np.squeeze(np.asarray(value, float)))
    if numbers.size == 1:
        matrix = np.diag(np.full(m, numbers.ravel()[0]))
    elif numbers.shape == (m,):
        matrix = np.diag(numbers)
    else:
        matrix = numbers
    if matrix.shape != (m, m) or not np.allclose(matrix, matrix.T, rtol=0, atol=0):
        raise error(
            code,
            f"{label} = {np.asarray(value).tolist()} is not a symmetric {m}×{m} matrix",
            f"Give a positive number, {m} of them (a diagonal), or a symmetric {m}×{m} matrix.",
        )
    if not np.all(np.isfinite(matrix)) or np.linalg.eigvalsh(matrix)[0] <= 0:
        raise error(
            code,
            f"{label} = {matrix.tolist()} is not positive definite",
            "Damping takes energy out: every eigenvalue must be positive.",
        )
    return matrix
