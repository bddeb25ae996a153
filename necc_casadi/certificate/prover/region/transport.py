"""Motion along the Casimirs: where the plant's states go while the controller's move off ξ̄.

By the Casimir condition c is constant along dq = A(q)B(ξ)⁻¹dξ, with A and B the rows for q and ξ of
the columns of Jcl − Rcl that belong to the momenta. Ways ξ̄ + sA_H⁻¹v start in every direction v of
a cube; cone by cone and step by step in s, boxes are found that q cannot leave: where
q₀ + [0, h]·A(Q)B⁻¹v ⊂ Q, the solution that starts in q₀ stays in Q (Picard–Lindelöf).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce

import numpy as np
import sympy as sp

from necc_casadi.arrays import Truth, Vector
from necc_casadi.certificate.prover.arithmetic.boxes import subdivide
from necc_casadi.certificate.prover.arithmetic.definite import inverse, solve
from necc_casadi.certificate.prover.arithmetic.intervals import (
    Interval,
    concatenate,
    matmul,
    point,
    stack,
)
from necc_casadi.certificate.prover.arithmetic.jets import expression_values

__all__ = ["Transport", "values_on"]


#: Cells per axis on each face of the cube of directions, how often they are cut in two per axis,
#: and pieces of q per axis.
_CONES, _CUTS, _PIECES = 4, 2, 3


#: Tries of Picard's condition, and how much wider each is.
_PICARD, _SLACK = 6, 0.1


#: Room for the checker's arithmetic, which rounds radii and steps otherwise.
_EASE = 1e-6


@dataclass(frozen=True, eq=False)
class Transport:
    """dq = A(q)B(ξ)⁻¹dξ, in the scale η = A_H(ξ − ξ̄)."""

    along: sp.MatrixBase  # A, r × nc
    across: sp.MatrixBase  # B, nc × nc
    q: Sequence[sp.Symbol]
    xi: Sequence[sp.Symbol]
    xi_bar: Vector  # (nc,)
    scale: Vector  # A_H, nc × nc

    def hull(
        self, radii: Vector, starts: Sequence[Interval], lo: Vector, hi: Vector
    ) -> Interval | None:
        """A box in [lo, hi] (r,) that q does not leave; None where none is found.

        Between radii[k] and radii[k + 1] of |η|, a way started from q in starts[k] ⊂ starts[k − 1].
        Cones on which q may leave [lo, hi] are cut.
        """
        cones, hulls = _cube(len(self.scale)), []
        for _ in range(_CUTS + 1):
            found = self._ways(cones, radii, starts)
            inside: Truth = np.asarray(((found.lo >= lo) & (found.hi <= hi)).all(1))
            hulls.append(found[inside])
            if inside.all():
                every = reduce(concatenate, hulls)
                return Interval(every.lo.min(0), every.hi.max(0))
            cones = _quartered(cones[~inside])
        return None

    def _ways(self, v: Interval, radii: Vector, starts: Sequence[Interval]) -> Interval:
        """A box that q does not leave, cone by cone (cones, r); not finite where none is found."""
        shortest = np.sqrt(np.square(np.maximum(np.maximum(v.lo, -v.hi), 0.0)).sum(1)) * (1 - _EASE)
        scaled = matmul(inverse(self.scale), v[..., None])[..., 0]  # A_H⁻¹v
        moved = point(np.zeros((v.shape[0], len(self.q))))
        found = Interval(moved.lo + np.inf, moved.hi - np.inf)
        for inner, outer, start in zip(radii[:-1], radii[1:], starts, strict=True):
            s = Interval(inner / shortest * (1 - _EASE), outer / shortest * (1 + _EASE))
            xi = scaled * s[:, None] + self.xi_bar
            width = (outer - inner) / shortest
            reached, change = self._step(start + moved, xi, scaled, width)
            found = Interval(np.minimum(found.lo, reached.lo), np.maximum(found.hi, reached.hi))
            moved = moved + change
        return found

    def _step(
        self, start: Interval, xi: Interval, v: Interval, width: Vector
    ) -> tuple[Interval, Interval]:
        """(q during a step, its change at the end), (cones, r); not finite where not enclosed."""
        span = Interval(np.zeros_like(width), width * (1 + _EASE))[:, None]
        turned, Q = self._turned(xi, v), start
        for _ in range(_PICARD):
            rate = self._rate(Q, turned)
            reached = start + rate * span
            enclosed: Truth = np.asarray(((reached.lo >= Q.lo) & (reached.hi <= Q.hi)).all(1))
            if enclosed.all():
                break
            slack = _SLACK * (reached.hi - reached.lo)
            wide = Interval(
                np.minimum(Q.lo, reached.lo - slack), np.maximum(Q.hi, reached.hi + slack)
            )
            keep = enclosed[:, None]
            Q = Interval(np.where(keep, Q.lo, wide.lo), np.where(keep, Q.hi, wide.hi))
        lost = np.where(enclosed, 0.0, np.inf)[:, None]
        change = rate * Interval(width * (1 - _EASE), width * (1 + _EASE))[:, None]
        spoilt = Interval(-lost, lost)
        return reached + spoilt, change + spoilt

    def _turned(self, xi: Interval, v: Interval) -> Interval:
        """B(ξ)⁻¹A_H⁻¹v, (cones, nc); not finite where B is not proved regular."""
        nc = len(self.scale)
        B = values_on(list(self.across), self.xi, xi).reshape(-1, nc, nc)
        return solve(B, v[..., None])[..., 0]

    def _rate(self, Q: Interval, turned: Interval) -> Interval:
        """A(q)B(ξ)⁻¹A_H⁻¹v over boxes of q, (cones, r); boxes are cut for sharpness."""
        r, nc = self.along.shape
        pieces = _cut(Q, [k for k, s in enumerate(self.q) if self.along.has(s)])
        A = values_on(list(self.along), self.q, pieces).reshape(-1, r, nc)
        count = pieces.shape[0] // Q.shape[0]
        x = Interval(*(np.repeat(end, count, 0)[..., None] for end in (turned.lo, turned.hi)))
        rate = matmul(A, x)[..., 0].reshape(-1, count, r)
        return Interval(rate.lo.min(1), rate.hi.max(1))


def _cube(d: int) -> Interval:
    """The surface of ‖v‖∞ = 1 in cells, (cells, d)."""
    if d == 1:
        return point(np.array([[-1.0], [1.0]]))
    face = subdivide(Interval(-np.ones(d - 1), np.ones(d - 1)), _CONES)
    sides = [
        np.stack([np.insert(end, axis, sign, axis=1) for end in (face.lo, face.hi)])
        for axis in range(d)
        for sign in (-1.0, 1.0)
    ]
    return Interval(*np.concatenate(sides, axis=1))


def _quartered(cones: Interval) -> Interval:
    """Cells cut in two along each of their axes but the one on which they have no width."""
    for axis in range(cones.shape[1]):
        wide = cones.hi[:, axis] > cones.lo[:, axis]
        middle = (cones.lo[:, axis] + cones.hi[:, axis]) / 2
        low, high = cones.hi.copy(), cones.lo.copy()
        low[:, axis] = np.where(wide, middle, cones.hi[:, axis])
        high[:, axis] = middle
        first, second = Interval(cones.lo, low), Interval(high, cones.hi)
        cones = concatenate(first, second[np.flatnonzero(wide)])
    return cones


def _cut(boxes: Interval, used: list[int]) -> Interval:
    """Boxes (B, d) cut along some of their axes, box by box."""
    parts = _PIECES
    for axis in used:
        width = (boxes.hi - boxes.lo)[:, axis, None]
        edges = boxes.lo[:, axis, None] + width * (np.arange(parts + 1) / parts)
        edges[:, -1] = boxes.hi[:, axis]
        lo, hi = (np.repeat(end, parts, 0) for end in (boxes.lo, boxes.hi))
        lo[:, axis], hi[:, axis] = edges[:, :-1].ravel(), edges[:, 1:].ravel()
        boxes = Interval(lo, hi)
    return boxes


def values_on(
    expressions: Sequence[sp.Expr], symbols: Sequence[sp.Symbol], box: Interval
) -> Interval:
    """Expressions over boxes (B, symbols), (B, expressions)."""
    variables = {s: box[:, k] for k, s in enumerate(symbols)}
    zero = point(np.zeros(box.shape[0]))
    return stack([zero + v for v in expression_values(list(expressions), variables)], 1)
