"""The fibre ξ = ξ̄: where α = A_K(c(q, ξ̄) − c̄) is small, it has no fold, and what it covers.

Where ∂α/∂q is regular, α is one-to-one nearby (inverse function theorem).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import sympy as sp

from necc_casadi.arrays import Indices, Truth, Vector
from necc_casadi.certificate.prover.arithmetic.boxes import subdivide
from necc_casadi.certificate.prover.arithmetic.definite import regular
from necc_casadi.certificate.prover.arithmetic.intervals import Interval, matmul, point
from necc_casadi.certificate.prover.region.grid import dilated
from necc_casadi.certificate.prover.region.transport import values_on

__all__ = ["Fibre", "FibreChart"]


#: Cells per axis, by dimension.
_CELLS, _FEWEST = {1: 512, 2: 64, 3: 16}, 5


#: More than the roundings of a few operations on doubles, and room for the checker's other ones.
_ROUND, _EASE = 1e-12, 1e-6


@dataclass(frozen=True, eq=False)
class Fibre:
    """Cells of a box of q that cover |α| ≤ a, a component of which holds q̄."""

    box: Interval  # (r,)
    center: Vector  # q̄ (r,), in the box
    shape: tuple[int, ...]  # of all cells of the box
    index: Indices  # (B,) flat, of those that are kept
    cells: Interval  # (B, r)
    least: Vector  # (B,) |α| is at least this
    most: Vector  # (B,) and at most this

    def within(self, a: float) -> Interval:
        """A box around |α| ≤ a."""
        near = self.least <= a * (1 + _EASE)
        return Interval(self.cells.lo[near].min(0), self.cells.hi[near].max(0))

    def volume(self, a: float) -> float:
        """A lower bound of the volume of the component of |α| ≤ a around q̄."""
        inside = np.zeros(self.shape, dtype=bool)
        inside.ravel()[self.index[self.most <= a]] = True
        found = np.zeros_like(inside)
        home = (self.cells.lo <= self.center) & (self.center <= self.cells.hi)
        found.ravel()[self.index[home.all(1)]] = True
        while True:
            grown = inside & dilated(found & inside)
            if (grown == found).all():
                break
            found = grown
        sides = self.cells.hi[0] - self.cells.lo[0]
        return float(found.sum()) * float(np.prod(sides)) * (1 - 1e-9)


@dataclass(frozen=True, eq=False)
class FibreChart:
    """The map α on the fibre."""

    casimirs: Sequence[sp.Expr]
    q: Sequence[sp.Symbol]
    xi: Sequence[sp.Symbol]
    xi_bar: Vector  # (nc,)
    middle: Vector  # c̄ (r,)
    scale: Vector  # A_K, r × r

    def cover(self, box: Interval, q_bar: Vector, a: float) -> Fibre | None:
        """Cells of the box with |α| ≤ a, one of which holds q̄.

        None where they may meet the border of the box or a fold, or |α| > a at q̄.
        """
        r = len(self.q)
        parts = _CELLS.get(r, _FEWEST)
        inside = bool(((box.lo < q_bar) & (q_bar < box.hi)).all())
        if not (inside and self._bounds(point(q_bar[None]))[1][0] <= a):
            return None
        cells = subdivide(box, parts)
        least, most, unfolded = self._bounds(cells)
        index = np.stack(np.unravel_index(np.arange(parts**r), (parts,) * r), -1)
        border = ((index == 0) | (index == parts - 1)).any(1)
        near = least <= a * (1 + _EASE)  # so that other arithmetic can confirm it
        if (near & (border | ~unfolded)).any() or not near.any():
            return None
        kept = np.flatnonzero(near)
        return Fibre(box, q_bar, (parts,) * r, kept, cells[kept], least[kept], most[kept])

    def _bounds(self, cells: Interval) -> tuple[Vector, Vector, Truth]:
        """Bounds of |α| on cells, and where ∂α/∂q is proved regular, (B,) each."""
        r, middle = len(self.q), cells.mid
        half = (cells - middle).magnitude
        c = self._values(list(self.casimirs), point(middle)) - self.middle
        alpha = matmul(self.scale, c[..., None])[..., 0]
        slopes = self._values([sp.diff(c, s) for c in self.casimirs for s in self.q], cells)
        G = matmul(self.scale, slopes.reshape(-1, r, r))
        finite: Truth = np.asarray(np.isfinite(G.lo + G.hi).all((1, 2)))
        spread = (point(G.magnitude) * half[:, None, :]).sum().hi
        apart = np.maximum(np.maximum(alpha.lo, -alpha.hi) - spread, 0.0) * (1 - _ROUND)
        by_box = np.maximum(point(apart).square().sum().lo, 0.0)
        unit = alpha.mid / (np.linalg.norm(alpha.mid, axis=1) * (1 + _ROUND) + 1e-300)[:, None]
        along = matmul(point(unit[:, None, :]), G)[:, 0].magnitude
        by_side = ((alpha * unit).sum() - (point(along) * half).sum().hi).lo
        least = np.maximum(np.sqrt(by_box) * (1 - _ROUND), by_side)
        most = np.sqrt(point(alpha.magnitude + spread).square().sum().hi) * (1 + _ROUND)
        return np.where(finite, least, -np.inf), np.where(finite, most, np.inf), regular(G)

    def _values(self, expressions: list[sp.Expr], q: Interval) -> Interval:
        """Expressions at (q, ξ̄), boxes first."""
        xi = np.broadcast_to(self.xi_bar, (q.shape[0], len(self.xi_bar)))
        box = Interval(np.hstack([q.lo, xi]), np.hstack([q.hi, xi]))
        return values_on(expressions, [*self.q, *self.xi], box)
