"""Definite and regular interval matrices, and exact definiteness of binary numbers."""

from __future__ import annotations

import numpy as np
from flint import fmpq, fmpq_mat

from necc_casadi.arrays import Truth, Vector
from necc_casadi.certificate.prover.arithmetic.intervals import Interval, matmul, point

__all__ = [
    "exactly_positive_definite",
    "inverse",
    "lowest_eigenvalue",
    "norm",
    "positive_definite",
    "regular",
    "solve",
]


#: More than the roundings of a few operations on doubles, as a share.
_ROUND = 1e-12


def positive_definite(A: Interval, mu: Vector | float = 0.0) -> Truth:
    """Whether A − μI ≻ 0 for every symmetric matrix in the enclosures (B, N, N); (B,) of bool.

    S = Λ^(−1/2) Qᵀ of the middle matrix makes S(A − μI)Sᵀ close to I; where the rows of the
    difference sum to less than 1 in absolute value, S is regular and A − μI positive definite.
    """
    size = A.shape[-1]
    if size == 0:
        return np.ones(A.shape[:-2], dtype=bool)
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


def regular(A: Interval) -> Truth:
    """Whether every matrix in the enclosures (B, n, n) is regular, (B,) of bool.

    By the Neumann series: ‖CA − I‖∞ < 1 for a C near A⁻¹.
    """
    if A.shape[-1] == 0:
        return np.ones(A.shape[:-2], dtype=bool)
    return np.asarray(_near_inverse(A)[2] < 1)


def solve(A: Interval, v: Interval) -> Interval:
    """Enclosures of A⁻¹v, (B, n, k); not finite where A (B, n, n) is not proved regular.

    With C near A⁻¹ and E = CA − I, A⁻¹v = Cv − ECv + E²(I + E)⁻¹Cv.
    """
    C, E, excess = _near_inverse(A)
    x = matmul(point(C), v)
    rest = excess**2 / (1 - excess) * (1 + _ROUND)
    slack = rest[:, None] * x.magnitude.max(1)
    slack = np.where((excess < 1)[:, None], slack, np.inf)[:, None, :]
    return x - matmul(E, x) + Interval(-slack, slack)


def inverse(A: Vector) -> Interval:
    """A⁻¹ of a matrix of doubles (n, n)."""
    return solve(point(A[None]), point(np.eye(len(A))[None]))[0]


def _near_inverse(A: Interval) -> tuple[Vector, Interval, Vector]:
    """(C, E = CA − I, a bound of ‖E‖∞, ∞ where it is not known) with C ≈ A⁻¹."""
    size = A.shape[-1]
    finite: Truth = np.asarray(np.isfinite(A.lo + A.hi).all((-1, -2)))
    middle = np.where(finite[..., None, None], A.mid, np.eye(size))
    try:
        C = np.asarray(np.linalg.inv(middle), float)
    except np.linalg.LinAlgError:  # one of them is singular; its pseudoinverse proves nothing
        C = np.asarray(np.linalg.pinv(middle), float)
    with np.errstate(all="ignore"):
        E = matmul(point(C), A) - np.eye(size)
        excess = point(E.magnitude).sum().hi.max(-1)
    return C, E, np.where(finite & np.isfinite(excess), excess, np.inf)


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
