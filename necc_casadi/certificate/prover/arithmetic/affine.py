"""Matrices in affine form, {A₀ + Σ εₖAₖ + E : |εₖ| ≤ 1, |E| ≤ R}, for many boxes at once.

What depends on the same εₖ cancels or adds with its sign, to the first order; products of two of
them, and roundings, go into R.

References
----------
de Figueiredo and Stolfi (2004).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from necc_casadi.arrays import Truth, Vector
from necc_casadi.certificate.prover.arithmetic.intervals import TINY, UNIT, Interval

__all__ = ["Affine", "affine_matrices", "negative_definite"]


#: More than the relative error of a few hundred roundings.
_ROUND = 1024 * UNIT


@dataclass(frozen=True, eq=False)
class Affine:
    """Matrices (B, r, c) that depend on K numbers in [−1, 1], to the first order."""

    center: Vector  # (B, r, c)
    parts: Vector  # (B, K, r, c)
    error: Vector  # (B, r, c), ≥ 0

    @property
    def T(self) -> Affine:
        """The transposes."""
        return Affine(*(np.swapaxes(v, -1, -2) for v in (self.center, self.parts, self.error)))

    @property
    def magnitude(self) -> Vector:
        """Upper bounds of absolute values."""
        size: Vector = np.abs(self.center) + self._first + self.error
        return size * (1 + _ROUND)

    @property
    def _first(self) -> Vector:
        total: Vector = np.abs(self.parts).sum(1)
        return total

    def __add__(self, other: Affine) -> Affine:
        error = self.error + other.error + _ROUND * (self.magnitude + other.magnitude)
        return Affine(self.center + other.center, self.parts + other.parts, error)

    def __matmul__(self, other: Affine) -> Affine:
        a, b = self, other
        center = a.center @ b.center
        parts = a.center[:, None] @ b.parts + a.parts @ b.center[:, None]
        size_a, size_b = a.magnitude, b.magnitude
        error = a._first @ b._first + a.error @ size_b + (size_a - a.error) @ b.error
        error = error + _ROUND * (size_a @ size_b)
        return Affine(center, parts, error * (1 + _ROUND) + TINY)

    def scaled(self, factor: Affine) -> Affine:
        """Times numbers (B, 1, 1)."""
        center = self.center * factor.center
        parts = self.center[:, None] * factor.parts + self.parts * factor.center[:, None]
        mine, given = self.magnitude, factor.magnitude
        error = self._first * factor._first + self.error * given
        error = error + (mine - self.error) * factor.error + _ROUND * mine * given
        return Affine(center, parts, error * (1 + _ROUND) + TINY)

    def times(self, factor: float) -> Affine:
        """Times a number."""
        error = abs(factor) * self.error + _ROUND * abs(factor) * self.magnitude + TINY
        return Affine(self.center * factor, self.parts * factor, error)

    def symmetric(self) -> Affine:
        """(A + Aᵀ)/2."""
        return (self + self.T).times(0.5)

    def widened(self, error: Vector) -> Affine:
        """With more error, (B, r, c) or what broadcasts to it."""
        return Affine(self.center, self.parts, self.error + error)


def affine_matrices(
    boxes: Sequence[Interval], symmetric: Sequence[bool]
) -> tuple[list[Affine], int]:
    """Interval matrices (B, r, c) in affine form, and how many numbers they depend on.

    Each entry that varies depends on a number of its own, which a symmetric matrix has twice.
    """
    places: list[list[tuple[int, int]]] = []
    for box, same in zip(boxes, symmetric, strict=True):
        wide = (box.hi > box.lo).any(0) | ~np.isfinite(box.lo + box.hi).all(0)
        rows, columns = np.nonzero(np.triu(wide | wide.T) if same else wide)
        places.append(list(zip(rows.tolist(), columns.tolist(), strict=True)))
    count = sum(map(len, places))
    made, at = [], 0
    for box, same, entries in zip(boxes, symmetric, places, strict=True):
        center, radius = box.mid, box.rad
        parts = np.zeros((len(center), count, *center.shape[1:]))
        for i, j in entries:
            parts[:, at, i, j] = radius[:, i, j]
            if same:
                parts[:, at, j, i] = radius[:, i, j]
                center[:, j, i] = center[:, i, j]
            at += 1
        made.append(Affine(center, parts, np.zeros_like(center)))
    return made, count


def negative_definite(A: Affine, share: float = 1.0) -> Truth:
    """Whether every symmetric matrix enclosed is ≺ 0, (B,).

    C(−A₀)Cᵀ is close to I for a C near the inverse of a factor; A ≺ 0 where what is left is shorter
    than 1, or a share of it: all Y = CAₖCᵀ together by the rows of Σ|Y|, or by the matrix Σ VMVᵀ,
    M = |Λ|, which is above every Σ εₖY, Y = VΛVᵀ; the error by a diagonal matrix above it.
    """
    finite: Truth = np.asarray(np.isfinite(A.center + A.error).all((-1, -2)))
    finite = finite & np.isfinite(A.parts).all((-1, -2, -3))
    size = A.center.shape[-1]
    identity = np.eye(size)
    safe = np.where(finite[:, None, None], A.center, -identity)
    values, vectors = np.linalg.eigh(safe)
    usable = finite & (values[:, -1] < 0)
    scale = np.where(usable[:, None], -values, 1.0) ** -0.5
    C = scale[:, :, None] * np.swapaxes(vectors, -1, -2)
    CT, size_C = np.swapaxes(C, -1, -2), np.abs(C)
    rest = np.where(finite[:, None, None], A.error + _ROUND * A.magnitude, 1.0)
    apart = C @ safe @ CT + identity
    parts = np.where(finite[:, None, None, None], A.parts, 0.0)
    moved = C[:, None] @ parts @ CT[:, None]
    error = _above(C, rest)
    together = np.abs(moved).sum(1).sum(-1).max(-1) + _greatest(error)
    joint, left = _sum_above(moved)
    total = np.minimum(together, _greatest(joint + error) + left)
    rounded = np.abs(safe) + np.abs(parts).sum(1)
    total = total + np.sqrt((apart**2).sum((-1, -2)))
    total = total + _ROUND * (size_C @ rounded @ np.swapaxes(size_C, -1, -2)).sum((-1, -2))
    return np.asarray(usable & (total * (1 + _ROUND) < share), dtype=bool)


def _sum_above(Y: Vector) -> tuple[Vector, Vector]:
    """A matrix above Σ εₖYₖ, |εₖ| ≤ 1, of symmetric Y (B, K, N, N), but for a rest, (B,)."""
    values, V = np.linalg.eigh(Y)
    VT = np.swapaxes(V, -1, -2)
    joint = ((V * np.abs(values)[..., None, :]) @ VT).sum(1)
    found = (V * values[..., None, :]) @ VT
    size = np.abs(Y) + (np.abs(V) * np.abs(values)[..., None, :]) @ np.abs(VT)
    symmetric = (Y + np.swapaxes(Y, -1, -2)) / 2
    left = np.sqrt(((np.abs(symmetric - found) + _ROUND * size) ** 2).sum((-1, -2))).sum(1)
    return joint, left * (1 + _ROUND)


def _greatest(A: Vector) -> Vector:
    """Upper bounds of the eigenvalues of symmetric matrices ⪰ 0, (B,)."""
    A = (A + np.swapaxes(A, -1, -2)) / 2
    values, V = np.linalg.eigh(A)
    VT = np.swapaxes(V, -1, -2)
    rest = A - (V * values[:, None, :]) @ VT
    turned = V @ VT - np.eye(A.shape[-1])
    most = np.maximum(values[:, -1], 0.0)
    slack = np.sqrt((rest**2).sum((-1, -2))) + most * np.sqrt((turned**2).sum((-1, -2)))
    bound: Vector = most + slack + _ROUND * np.abs(A).sum((-1, -2))
    return bound


def _above(C: Vector, error: Vector) -> Vector:
    """A matrix above CECᵀ for every symmetric E with |E| ≤ error, (B, N, N).

    2|xᵢxⱼ| ≤ xᵢ²vⱼ/vᵢ + xⱼ²vᵢ/vⱼ for v > 0, here the columns of C by their lengths, so that E ⪯ D,
    diagonal, and −E ⪯ D.
    """
    lengths = np.sqrt((C**2).sum(1)) + TINY
    error = np.maximum(error, np.swapaxes(error, -1, -2))
    diagonal = (error @ lengths[..., None])[..., 0] / lengths * (1 + _ROUND)
    moved: Vector = C @ (diagonal[..., None] * np.swapaxes(C, -1, -2))
    return moved
