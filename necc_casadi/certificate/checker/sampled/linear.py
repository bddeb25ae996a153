"""Matrices that depend on numbers εₖ in [−1, 1] to the first order, the rest in their balls."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from itertools import count

import numpy as np
from flint import arb, arb_mat

from necc_casadi.arrays import Vector
from necc_casadi.certificate.checker.arithmetic.balls import ball
from necc_casadi.certificate.checker.arithmetic.definite import middle_of, positive

__all__ = ["Linear", "falls"]


_UNIT = ball(-1.0, 1.0)


@dataclass(frozen=True)
class Linear:
    """A₀ + Σ εₖAₖ with |εₖ| ≤ 1 and A₀ in a ball."""

    center: arb_mat
    parts: Mapping[int, arb_mat]

    @classmethod
    def of(cls, A: Sequence[Sequence[arb]], names: count[int], symmetric: bool) -> Linear:
        """A matrix of balls, each entry that varies by a number of its own."""
        rows, columns = len(A), len(A[0])
        center = arb_mat([[v.mid() for v in row] for row in A])
        parts: dict[int, arb_mat] = {}
        for i in range(rows):
            for j in range(i if symmetric else 0, columns):
                radius = A[i][j].rad()
                if symmetric:
                    center[j, i] = center[i, j]
                if bool(radius == arb(0)):
                    continue
                part = arb_mat(rows, columns)
                part[i, j] = radius
                if symmetric:
                    part[j, i] = radius
                parts[next(names)] = part
        return cls(center, parts)

    def __add__(self, other: Linear) -> Linear:
        parts = dict(self.parts)
        for k, part in other.parts.items():
            parts[k] = parts[k] + part if k in parts else part
        return Linear(self.center + other.center, parts)

    def __matmul__(self, other: Linear) -> Linear:
        center, parts = self.center * other.center, self._crossed(other)
        if self.parts and other.parts:
            center = center + _balls(self._reach() * other._reach())
        return Linear(center, parts)

    def _crossed(self, other: Linear) -> dict[int, arb_mat]:
        parts = {k: part * other.center for k, part in self.parts.items()}
        for k, part in other.parts.items():
            moved = self.center * part
            parts[k] = parts[k] + moved if k in parts else moved
        return parts

    def _reach(self) -> arb_mat:
        """Σ|Aₖ|."""
        return reduce(lambda a, b: a + b, map(_absolute, self.parts.values()))

    def times(self, number: arb) -> Linear:
        """Times a number."""
        return Linear(self.center * number, {k: part * number for k, part in self.parts.items()})

    def scaled(self, period: tuple[int, arb, arb]) -> Linear:
        """Times m + rεₖ, for (k, m, r)."""
        name, middle, radius = period
        result = self.times(middle)
        moved, center = self.center * radius, result.center
        parts = dict(result.parts)
        parts[name] = parts[name] + moved if name in parts else moved
        if self.parts:
            center = center + _balls(self._reach() * radius)
        return Linear(center, parts)

    def placed(self, size: int) -> Linear:
        """As the first block of matrices (size, size) that are 0 elsewhere."""
        parts = {k: _padded(part, size) for k, part in self.parts.items()}
        return Linear(_padded(self.center, size), parts)

    def magnitude(self) -> arb_mat:
        """Upper bounds of absolute values."""
        size = _absolute(self.center)
        return size + self._reach() if self.parts else size

    @property
    def T(self) -> Linear:
        """The transposes."""
        parts = {k: part.transpose() for k, part in self.parts.items()}
        return Linear(self.center.transpose(), parts)


def _padded(A: arb_mat, size: int) -> arb_mat:
    rows = [[*row, *[arb(0)] * (size - A.ncols())] for row in A.tolist()]
    return arb_mat([*rows, *[[arb(0)] * size] * (size - A.nrows())])


def _absolute(A: arb_mat) -> arb_mat:
    return arb_mat([[v.abs_upper() for v in row] for row in A.tolist()])


def _balls(A: arb_mat) -> arb_mat:
    return arb_mat([[v * _UNIT for v in row] for row in A.tolist()])


def falls(A: Linear) -> bool:
    """Whether A + Aᵀ ≺ 0 for every matrix enclosed.

    In the axes of its middle matrix −A₀ is close to I; what is left of it and of the symmetric
    parts Y of Aₖ is less than 1, all by the rows of Σ|Y|, or I − Σ VMVᵀ ≻ 0 with M = |Λ| for Y near
    VΛVᵀ. The balls of A₀ count by a diagonal matrix above them.
    """
    if not all(v.is_finite() for row in A.center.tolist() for v in row):
        return False
    middle = middle_of(A.center)
    values, vectors = np.linalg.eigh(-(middle + middle.T) / 2)
    if not values[0] > 0:
        return False
    C = arb_mat((vectors / np.sqrt(values)).T.tolist())
    D = C.transpose()
    exact = arb_mat([[v.mid() for v in row] for row in A.center.tolist()])
    identity = _identity(exact.nrows())
    near = _row_sum(_symmetric(C * exact * D) + identity)
    error = C * _above(A.center, vectors / np.sqrt(values)) * D
    moved = [_symmetric(C * part * D) for part in A.parts.values()]
    together = near + _length(error)
    if moved:
        together = together + _row_sum(reduce(lambda a, b: a + b, map(_absolute, moved)))
    if bool(together < 1):
        return True
    joint, left = identity - error, near
    for Y in moved:
        above, rest = _near_above(Y)
        joint, left = joint - above, left + rest
    for i in range(exact.nrows()):
        joint[i, i] = joint[i, i] - left
    return positive(_symmetric(joint), 0.0)


def _near_above(Y: arb_mat) -> tuple[arb_mat, arb]:
    """VMVᵀ with M = |Λ|, V and Λ near the spectrum of Y, and how far Y is from VΛVᵀ."""
    values, vectors = np.linalg.eigh(middle_of(Y))
    V = arb_mat(vectors.tolist())
    signed, above = (
        arb_mat([[v * float(k) for v, k in zip(row, scale, strict=True)] for row in V.tolist()])
        * V.transpose()
        for scale in (values, abs(values))
    )
    return above, _row_sum(Y - signed)


def _above(A: arb_mat, columns: Vector) -> arb_mat:
    """A diagonal D with −D ⪯ E ⪯ D for the symmetric part E of what the balls of A leave open.

    2|xᵢxⱼ| ≤ xᵢ²vⱼ/vᵢ + xⱼ²vᵢ/vⱼ for any v > 0, here the lengths of `columns`.
    """
    size = A.nrows()
    lengths = [arb(float(v)) for v in np.linalg.norm(columns, axis=1)]
    error = [[v.rad() for v in row] for row in A.tolist()]
    D = arb_mat(size, size)
    for i in range(size):
        pairs = ((error[i][j] + error[j][i]) / 2 * lengths[j] for j in range(size))
        D[i, i] = (sum(pairs, arb(0)) / lengths[i]).upper()
    return D


def _length(Y: arb_mat) -> arb:
    """‖Y‖₂ of a symmetric matrix, from above."""
    square = Y * Y
    fourth = sum((v * v for row in square.tolist() for v in row), arb(0))
    return fourth.upper().sqrt().sqrt()


def _row_sum(A: arb_mat) -> arb:
    """‖A‖∞."""
    return reduce(arb.max, (sum(map(abs, row), arb(0)).upper() for row in A.tolist()))


def _identity(size: int) -> arb_mat:
    return arb_mat([[int(i == j) for j in range(size)] for i in range(size)])


def _symmetric(A: arb_mat) -> arb_mat:
    return (A + A.transpose()) / 2
