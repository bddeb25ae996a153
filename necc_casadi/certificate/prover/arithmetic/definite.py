"""Definiteness of interval matrices, and exact definiteness of binary numbers."""

from __future__ import annotations

import numpy as np
from flint import fmpq, fmpq_mat

from necc_casadi.arrays import Truth, Vector
from necc_casadi.certificate.prover.arithmetic.intervals import Interval, matmul, point

__all__ = ["exactly_positive_definite", "lowest_eigenvalue", "norm", "positive_definite"]


def positive_definite(A: Interval, mu: Vector | float = 0.0) -> Truth:
    """Whether A − μI ≻ 0 for every symmetric matrix in the enclosures (B, N, N); (B,) of bool.

    S = Λ^(−1/2) Qᵀ of the middle matrix makes S(A − μI)Sᵀ close to I; where the rows of the
    difference sum to less than 1 in absolute value, S is regular and A − μI positive definite.
    """
    size = A.shape[-1]
    identity = np.eye(size)
    shifted = A - np.asarray(mu, float)[..., None, None] * identity
    values, vectors, usable = _spectrum(shifted.mid)
    usable = usable & (values[..., 0] > 0)
    scale = np.where(usable[..., None], values, 1.0) ** -0.5
    S = scale[..., :, None] * np.swapaxes(vectors, -1, -2)
    half = matmul(S, shifted)
    whole = matmul(S, Interval(np.swapaxes(half.lo, -1, -2), np.swapaxes(half.hi, -1, -2)))
    row_sums = point((whole - identity).magnitude).sum().hi
    return np.asarray(usable & (row_sums.max(-1) < 1), dtype=bool)


def lowest_eigenvalue(A: Interval) -> Vector:
    """Smallest eigenvalue of the middle matrices, in plain floating point: a guide, no bound."""
    values, _, usable = _spectrum(A.mid)
    return np.where(usable, values[..., 0], np.nan)


def _spectrum(matrices: Vector) -> tuple[Vector, Vector, Truth]:
    """Eigenvalues, eigenvectors, and which matrices are finite."""
    usable: Truth = np.asarray(np.isfinite(matrices).all((-1, -2)))
    safe = np.where(usable[..., None, None], matrices, np.eye(matrices.shape[-1]))
    values, vectors = np.linalg.eigh((safe + np.swapaxes(safe, -1, -2)) / 2)
    return values, vectors, usable


def norm(v: Interval) -> Vector:
    """Upper bound of the Euclidean norm over the last axis."""
    squares = v.square().sum().hi
    return point(squares).sqrt().hi


def exactly_positive_definite(matrix: Vector) -> bool:
    """Whether the symmetric part of a matrix of doubles is ≻ 0: leading minors over ℚ."""
    if not np.isfinite(matrix).all():
        return False
    exact = [[fmpq(*float(v).as_integer_ratio()) for v in row] for row in matrix]
    size = len(exact)
    sums = [[exact[i][j] + exact[j][i] for j in range(size)] for i in range(size)]
    leading = ([row[: k + 1] for row in sums[: k + 1]] for k in range(size))
    return all(fmpq_mat(block).det() > 0 for block in leading)
