"""What a model file may say beside the plant: limits, ranges, sizes, weights and damping."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import sympy as sp

from necc_casadi.arrays import Vector
from necc_casadi.errors import InputError, ModelError, OptionError
from necc_casadi.model.cost import weight_matrix
from necc_casadi.model.ranges import Range
from necc_casadi.model.reader import Reader

__all__ = [
    "damping",
    "damping_matrix",
    "disturbance",
    "inputs",
    "limits",
    "parameters",
    "sides_of_states",
    "sizes",
    "told",
    "weight",
]


def limits(file: Reader) -> list[tuple[float, float]] | None:
    """U_limits: (lo, hi) of each input; None where there are none."""
    value = file.space.get("u_limits")
    if value is None:
        return None
    result = []
    for index, pair in enumerate(value if isinstance(value, (list, tuple)) else [value]):
        try:
            lo, hi = (float(file.read(bound)) for bound in pair)
        except (TypeError, ValueError):
            lo, hi = 1.0, 0.0
        if not (lo < hi and math.isfinite(hi - lo)):
            raise ModelError(
                "limits",
                f"u_limits[{index}] = {pair} is not a pair (lo, hi) with lo < hi",
                "Give one pair of numbers per input, large where there is no limit.",
            )
        result.append((lo, hi))
    return result


def inputs(file: Reader, m: int, states: Sequence[str]) -> tuple[str, ...]:
    """Names of the inputs, (m,); () where there are none."""
    value = file.space.get("inputs")
    if value is None:
        return ()
    names = value if isinstance(value, (tuple, list)) else (value,)
    words = all(isinstance(name, str) and name.isidentifier() for name in names)
    if not words or len(names) != m or len(set(names)) < m:
        raise ModelError(
            "model_file",
            f"inputs = {value} is not a name for each of {m} input(s)",
            'Write inputs = ("torque",): words of letters and digits, in order, each once.',
        )
    for name in names:
        if name in {*states, *file.parameters}:
            raise ModelError(
                "name_clash", f"inputs names {name}, a state or a parameter", "Rename one of them."
            )
    return tuple(map(str, names))


def sides_of_states(file: Reader, label: str, states: Sequence[str]) -> dict[str, Range]:
    """The `domain` or the `setpoints`: (lo, hi) by the names of states."""
    result = {}
    for name, side in file.table(label).items():
        if name not in states:
            raise ModelError(
                "domain",
                f"{label} names {name}, which is no state",
                f"States: {', '.join(states)}.",
            )
        pair = _pair(file, side)
        if pair is None or not pair[0] < pair[1]:
            raise ModelError(
                "domain",
                f"{label}[{name}] = {side} is not a pair (lo, hi) with lo < hi",
                "Give two finite numbers.",
            )
        result[name] = pair
    return result


def parameters(file: Reader, label: str) -> dict[str, Range]:
    """Ranges of parameters: those that are `uncertain`, or told at `runtime`."""
    result = {}
    for name, side in file.table(label).items():
        value = file.parameters.get(name)
        if value is None:
            raise ModelError(
                "param",
                f"{label} names {name}, which is no parameter",
                f"Parameters: {', '.join(file.parameters) or 'none; write params = {m: 1}'}.",
            )
        if not name.isidentifier():  # it stands in sentences that are proved
            raise ModelError("param", f"{label} names {name}, which is no word", "Rename it.")
        pair = _pair(file, side)
        if pair is None or not pair[0] <= value <= pair[1]:
            raise ModelError(
                "param",
                f"{label}[{name}] = {side} is not a pair (lo, hi) around {value}",
                "Give the least and the greatest value, the nominal one between them.",
            )
        result[name] = pair
    return result


def told(file: Reader) -> dict[str, Range]:
    """Ranges of parameters that the controller is told at run time, none of them unknown."""
    found, unknown = parameters(file, "runtime"), parameters(file, "uncertain")
    for name, (lo, hi) in found.items():
        if name in unknown or lo == hi:
            raise ModelError(
                "param",
                f"runtime names {name}, which is "
                + ("uncertain, too" if name in unknown else "one value alone"),
                "A parameter is told at run time, or unknown; its range has lo < hi.",
            )
    return found


def disturbance(file: Reader, m: int) -> tuple[Range, ...]:
    """Ranges of constant disturbances, one per input."""
    value = file.space.get("disturbance")
    if value is None:
        return ()
    given = value if isinstance(value, (list, tuple)) else [value]
    pairs = [pair for pair in (_pair(file, side) for side in given) if pair is not None]
    sides = tuple((lo, hi) for lo, hi in pairs if lo < hi and lo <= 0 <= hi)
    if not len(sides) == len(given) == m:
        raise ModelError(
            "limits",
            f"disturbance = {value} is not a pair (lo, hi) around 0 for each of {m} input(s)",
            "Write disturbance = [(-0.2, 0.2)], one pair per input.",
        )
    return sides


def _pair(file: Reader, value: Any) -> Range | None:
    """Two finite numbers in order, exact; None where that is not what stands there."""
    try:
        lo, hi = (file.read(bound) for bound in value)
        ordered = bool(lo <= hi) and bool(lo.is_finite and hi.is_finite)
    except (TypeError, ValueError, AttributeError):
        return None
    return (lo, hi) if ordered else None


def sizes(file: Reader, names: Sequence[str]) -> dict[str, sp.Expr]:
    """Positive sizes of states and inputs, by name."""
    result = {}
    for name, size in file.table("sizes").items():
        if name not in names:
            raise ModelError(
                "model_file",
                f"sizes names {name}, which is no state and no input",
                f"States and inputs: {', '.join(names)}.",
            )
        try:
            number = file.read(size)
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


def weight(file: Reader, label: str, size: int, strict: bool) -> Vector | None:
    """A weight of the quadratic cost, size × size; None where there is none."""
    value = file.space.get(label)
    if value is None:
        return None
    numbers = np.squeeze(_numeric(file, label, value))
    return weight_matrix(numbers, size, label, strict, ModelError, "model_file")


def _numeric(file: Reader, label: str, value: Any) -> Vector:
    """A number, vector or matrix of the file, as a matrix of floats."""
    try:
        read = file.read(value)
        whole = isinstance(value, (list, tuple, sp.MatrixBase, np.ndarray))
        return np.array(sp.Matrix(sp.sympify(read) if whole else [read]).evalf(), dtype=float)
    except (TypeError, ValueError):
        raise ModelError(
            "model_file", f"{label} = {value} is not numeric", "Give a number or a matrix."
        ) from None


def damping(file: Reader, label: str, m: int) -> Vector | None:
    """D or Dc, m × m; None where there is none."""
    value = file.space.get(label)
    if value is None:
        return None
    numbers = _numeric(file, label, value)
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
