"""Definite and regular ball matrices, and what exact arithmetic says of binary numbers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction
from functools import reduce
from typing import Any

import numpy as np
from flint import arb, arb_mat

__all__ = [
    "exactly_positive",
    "hurwitz",
    "lyapunov_matrix",
    "middle_of",
    "norm",
    "positive",
    "regular",
    "solve",
]


#: Of the matrix sign; it converges in about ten.
_NEWTON_STEPS = 60


def norm(v: Sequence[arb]) -> arb:
    """‖v‖; not a number where an entry is not finite."""
    if not all(x.is_finite() for x in v):
        return arb.nan()
    ends = [(x.abs_lower(), x.abs_upper()) for x in v]  # a ball around 0 squares badly
    low, high = (sum((end[k] * end[k] for end in ends), arb(0)) for k in (0, 1))
    return max(low.lower(), arb(0)).sqrt().union(high.upper().sqrt())


def middle_of(A: arb_mat) -> np.ndarray[Any, Any]:
    """The midpoints, rounded: a guess to start from, no bound."""
    return np.array([[float(v.mid()) for v in row] for row in A.tolist()])


def positive(A: arb_mat, mu: float) -> bool:
    """Whether A − μI ≻ 0: close to diagonal in the eigenvectors of its middle, then Gershgorin."""
    n = A.nrows()
    if n == 0:
        return True
    middle = middle_of(A)
    if not np.isfinite(middle).all():
        return False
    values, vectors = np.linalg.eigh(middle / 2 + middle.T / 2 - mu * np.eye(n))
    if values[0] <= 0:
        return False
    S = arb_mat((vectors / np.sqrt(values)).T.tolist())
    shifted = arb_mat(A)
    for i in range(n):
        shifted[i, i] = shifted[i, i] - mu
    B = S * shifted * S.transpose()
    rows = B.tolist()
    return all(
        bool(row[i] > sum((abs(v) for j, v in enumerate(row) if j != i), arb(0)))
        for i, row in enumerate(rows)
    )


def regular(A: arb_mat) -> bool:
    """Whether every matrix enclosed is regular: ‖CA − I‖∞ < 1 with C near A⁻¹ (Neumann series)."""
    return _near_inverse(A) is not None


def solve(A: arb_mat, v: Sequence[arb]) -> list[arb] | None:
    """A⁻¹v for every matrix enclosed; None where A may be singular.

    With C near A⁻¹ and E = CA − I, A⁻¹v = Cv − ECv + E²(I + E)⁻¹Cv.
    """
    found = _near_inverse(A)
    if found is None:
        return None
    C, E, excess = found
    x = C * arb_mat([[t] for t in v])
    size = reduce(arb.max, (abs(row[0]).upper() for row in x.tolist())).upper()
    rest = excess * excess / (1 - excess) * size
    slack = (-rest).union(rest)
    return [row[0] + slack for row in (x - E * x).tolist()]


def _near_inverse(A: arb_mat) -> tuple[arb_mat, arb_mat, arb] | None:
    """(C, E = CA − I, a bound of ‖E‖∞ below 1) with C ≈ A⁻¹; None where there is none."""
    middle, n = middle_of(A), A.nrows()
    if not np.isfinite(middle).all():
        return None
    try:
        C = arb_mat(np.linalg.inv(middle).tolist())
    except np.linalg.LinAlgError:
        return None
    E = C * A
    for i in range(n):
        E[i, i] = E[i, i] - 1
    excess = reduce(arb.max, (sum(map(abs, row), arb(0)).upper() for row in E.tolist())).upper()
    return (C, E, excess) if excess < 1 else None


def hurwitz(A: arb_mat) -> bool:
    """Whether every member of A has its spectrum in the left half plane: AᵀP + PA ≺ 0, P ≻ 0."""
    guess = lyapunov_matrix(middle_of(A))
    if guess is None:
        return False
    P = arb_mat(guess.tolist())
    PA = P * A
    return positive(P, 0) and positive(-(PA + PA.transpose()), 0)


@np.errstate(all="ignore")  # a guess that overflows is none
def lyapunov_matrix(A: np.ndarray[Any, Any]) -> np.ndarray[Any, Any] | None:
    """A guess of P with AᵀP + PA = −I; what it is worth is decided afterwards.

    On purpose not the prover's way to guess one: a P that both find by one method could share
    its faults, though either is proved to do before it counts.

    Newton's iteration for the matrix sign of [[A, 0], [I, −Aᵀ]], which is [[−I, 0], [2P, I]] where
    every eigenvalue of A has a negative real part.
    """
    if not np.isfinite(A).all():
        return None
    identity = np.eye(len(A))
    S, Q = A, identity
    for _ in range(_NEWTON_STEPS):
        try:
            inverse = np.linalg.inv(S)
        except np.linalg.LinAlgError:
            return None
        scale = np.sqrt(np.linalg.norm(inverse) / np.linalg.norm(S))
        S = (scale * S + inverse / scale) / 2
        Q = (scale * Q + inverse.T @ Q @ inverse / scale) / 2
        if not np.isfinite(Q).all() or np.abs(S + identity).max() < 1e-13 * len(A):
            break
    symmetric: np.ndarray[Any, Any] = (Q + Q.T) / 4
    return symmetric if np.isfinite(symmetric).all() else None


def exactly_positive(A: list[list[float]]) -> bool:
    """Whether the symmetric part is ≻ 0: pivots of exact elimination."""
    if not all(math.isfinite(v) for row in A for v in row):
        return False
    n = len(A)
    S = [[Fraction(A[i][j]) + Fraction(A[j][i]) for j in range(n)] for i in range(n)]
    for k in range(n):
        if S[k][k] <= 0:
            return False
        for i in range(k + 1, n):
            factor = S[i][k] / S[k][k]
            S[i] = [a - factor * b for a, b in zip(S[i], S[k], strict=True)]
    return True
