"""The fibre ξ = ξ̄: where α = A_K(c(q, ξ̄) − c̄) is small it has no fold, and what it covers.

Where ∂α/∂q is regular, α is one-to-one nearby (inverse function theorem).
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from flint import arb, arb_mat

from necc_casadi.certificate.checker.arithmetic.balls import Box, ball
from necc_casadi.certificate.checker.arithmetic.definite import norm, regular
from necc_casadi.certificate.checker.arithmetic.tapes import Tape

__all__ = ["Fibre", "FibreChart"]


#: Cells of the fibre per axis, by dimension.
_CELLS, _FEWEST = {1: 512, 2: 64, 3: 16}, 5


Index = tuple[int, ...]


@dataclass(frozen=True)
class Fibre:
    """Cells of a box of q that cover |α| ≤ a, one of which holds q̄; ∂α/∂q is regular on them."""

    q_bar: Sequence[float]
    cells: dict[Index, tuple[Box, arb, arb]]  # with bounds of |α| from below and from above

    def within(self, a: arb) -> list[arb]:
        """A box around |α| ≤ a."""
        near = [cell for cell, least, _ in self.cells.values() if not least > a]
        return [
            ball(min(cell[i][0] for cell in near), max(cell[i][1] for cell in near))
            for i in range(len(self.q_bar))
        ]

    def around(self, rho: arb) -> list[Box]:
        """Cells with |α| ≤ rho that are joined to one that holds q̄ by cells of this kind."""
        inside = {index for index, (_, _, most) in self.cells.items() if most <= rho}
        todo = [index for index in inside if _holds(self.cells[index][0], self.q_bar)]
        found = set(todo)
        while todo:
            index = todo.pop()
            for move in itertools.product((-1, 0, 1), repeat=len(self.q_bar)):
                other = tuple(k + m for k, m in zip(index, move, strict=True))
                if other in inside and other not in found:
                    found.add(other)
                    todo.append(other)
        return [self.cells[index][0] for index in found]


def _holds(cell: Box, point: Sequence[float]) -> bool:
    return all(lo <= v <= hi for v, (lo, hi) in zip(point, cell, strict=True))


@dataclass(frozen=True)
class FibreChart:
    """The map α on the fibre."""

    casimirs: Tape  # c in (q, ξ)
    slopes: Tape  # ∂c/∂q by rows
    xi_bar: Sequence[float]
    middle: Sequence[float]  # c̄ (r,)
    scale: arb_mat  # A_K, r × r

    def cover(self, box: Box, q_bar: Sequence[float], a: float) -> Fibre | None:
        """Cells of the box with |α| ≤ a, one of which holds q̄.

        None where they may meet the border of the box or a fold, or |α| > a at q̄.
        """
        r = len(box)
        parts = _CELLS.get(r, _FEWEST)
        if not all(lo < q < hi for q, (lo, hi) in zip(q_bar, box, strict=True)):
            return None
        if not self.bounds(tuple((q, q) for q in q_bar))[1] <= a:
            return None
        edges = [[lo + (hi - lo) * k / parts for k in range(parts)] + [hi] for lo, hi in box]
        cells: dict[Index, tuple[Box, arb, arb]] = {}
        for index in itertools.product(range(parts), repeat=r):
            cell = tuple((e[k], e[k + 1]) for e, k in zip(edges, index, strict=True))
            least, most, slopes = self.bounds(cell)
            if least > a:
                continue
            if any(k in (0, parts - 1) for k in index) or not regular(slopes):
                return None
            cells[index] = (cell, least, most)
        return Fibre(q_bar, cells) if cells else None

    def bounds(self, cell: Box) -> tuple[arb, arb, arb_mat]:
        """Bounds of |α| on a cell of the fibre, and ∂α/∂q."""
        r, xi = len(cell), [arb(v) for v in self.xi_bar]
        at = [arb(lo / 2 + hi / 2) for lo, hi in cell]
        c = self.casimirs((*at, *xi))
        shift = arb_mat([[v - m] for v, m in zip(c, self.middle, strict=True)])
        alpha = [row[0] for row in (self.scale * shift).tolist()]
        balls = [ball(*b) for b in cell]
        G = self.scale * arb_mat(r, r, self.slopes((*balls, *xi)))
        steps = [b - m for b, m in zip(balls, at, strict=True)]
        change = (G * arb_mat([[s] for s in steps])).tolist()
        wide = norm([v + row[0] for v, row in zip(alpha, change, strict=True)])
        u = [float(v.mid()) for v in alpha]
        size = float(np.linalg.norm(u)) or 1.0
        weights = arb_mat([[v / size for v in u]])
        along = (weights * G).tolist()[0]
        side = (weights * arb_mat([[v] for v in alpha])).tolist()[0][0]
        side = side + sum((g * s for g, s in zip(along, steps, strict=True)), arb(0))
        length = norm([arb(v / size) for v in u]).upper().max(arb(1))
        return wide.lower().max((side / length).lower()), wide.upper(), G
