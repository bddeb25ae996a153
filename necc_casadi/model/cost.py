"""The quadratic cost ∫ (x − x*)ᵀQ(x − x*) + (u − u*)ᵀR(u − u*) dt, by which responses are judged.

Bryson's rule by default: Q = diag(1/size²), R = diag(1/size²), so that a state and an input that
are away by their natural size cost the same.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from necc_casadi.arrays import Vector
from necc_casadi.errors import InputError, OptionError
from necc_casadi.model.sizes import Sizes

__all__ = ["QuadraticCost", "bryson", "weight_matrix"]


@dataclass(frozen=True, eq=False)
class QuadraticCost:
    """Weights Q ⪰ 0 (n, n) of the plant states and R ≻ 0 (m, m) of the inputs.

    References
    ----------
    Bryson and Ho (1975), section 5.2.
    """

    Q: Vector
    R: Vector

    def measured_in(self, units: Sizes) -> QuadraticCost:
        """The same cost, but for its unit of time, of states and inputs in other units."""
        x = units.state[: len(self.Q)]
        return QuadraticCost(self.Q * np.outer(x, x), self.R * np.outer(units.input, units.input))


def bryson(sizes: Sizes, n: int) -> QuadraticCost:
    """Bryson's rule; of the sizes of all states the plant's are the first n."""
    return QuadraticCost(np.diag(sizes.state[:n] ** -2.0), np.diag(sizes.input**-2.0))


def weight_matrix(
    value: npt.ArrayLike,
    size: int,
    label: str,
    strict: bool,
    error: type[InputError] = OptionError,
    code: str = "usage",
) -> Vector:
    """A weight as a matrix: from a number for each, a diagonal or a matrix.

    Parameters
    ----------
    value
        Number, vector (size,) or symmetric matrix (size, size).
    size
        Number of states or inputs.
    label
        Names the weight in errors.
    strict
        Whether it must be ≻ 0, not only ⪰ 0.

    Raises
    ------
    InputError
        Of the given class and code, when the shape or the definiteness is wrong.
    """
    numbers = np.asarray(value, float)
    if numbers.ndim == 0 or numbers.size == 1:
        matrix = float(numbers.ravel()[0]) * np.eye(size)
    else:
        matrix = np.diag(numbers) if numbers.ndim == 1 else numbers
    if matrix.shape != (size, size) or not np.array_equal(matrix, matrix.T):
        raise error(
            code,
            f"{label} = {numbers.tolist()} is not a symmetric {size}×{size} matrix",
            f"Give a number, {size} of them (a diagonal), or a symmetric {size}×{size} matrix.",
        )
    if not np.all(np.isfinite(matrix)) or not _is_weight(matrix, strict):
        kind = "positive definite" if strict else "positive semidefinite and not zero"
        raise error(code, f"{label} = {matrix.tolist()} is not {kind}", "What is away must cost.")
    return matrix


def _is_weight(matrix: Vector, strict: bool) -> bool:
    """Definiteness whatever the units: of the matrix with a diagonal of ones."""
    diagonal = np.diag(matrix)
    used = diagonal > 0
    if np.any(diagonal < 0) or np.any(matrix[~used]) or not used.any():
        return False
    root = np.sqrt(diagonal[used])
    least = np.linalg.eigvalsh(matrix[np.ix_(used, used)] / np.outer(root, root))[0]
    rounding = len(matrix) * np.finfo(float).eps
    return bool(used.all() and least > rounding) if strict else bool(least >= -rounding)
