"""What must hold over the marked cells besides V: bounds that the model names, inertia, reach."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

import sympy as sp
from flint import arb

from necc_casadi.certificate.checker.arithmetic.balls import Box, ball, by_bisection
from necc_casadi.certificate.checker.arithmetic.definite import positive
from necc_casadi.certificate.checker.arithmetic.potential import Energy
from necc_casadi.certificate.checker.region.cells import CellsProof
from necc_casadi.certificate.checker.region.floor import evaluated
from necc_casadi.certificate.checker.region.reduced import Reduced
from necc_casadi.certificate.claims.regions import Side

__all__ = ["BoundProof", "stays_positive"]

#: How often a fibre may be halved before a test on it counts as failed.
_DEPTH = 9


def stays_positive(A: sp.Matrix, variables: Sequence[sp.Symbol], boxes: Sequence[Box]) -> bool:
    """Whether a matrix is ≻ 0 on boxes of its variables."""
    counts = [A.has(v) for v in variables]

    def test(box: Box) -> bool:
        values = {v: ball(*side) for v, side in zip(variables, box, strict=True)}
        return positive(evaluated(A, values), 0)

    return all(by_bisection(box, test, _DEPTH, counts) for box in boxes)


class BoundProof:
    """The user's bounds of states that s does not hold: V > c where one of them is met."""

    def __init__(self, cells: CellsProof, inertia: sp.Matrix, resting: Sequence[int]) -> None:
        self.cells, self.A, self.resting = cells, inertia, list(resting)
        self.reduced, self.energy = cells.reduced, cells.reduced.energy
        self.delta = self.energy.model.delta

    def momentum_stays(self, i: int, reach: arb) -> bool:
        """Whether |pᵢ| = reach is met nowhere in {V ≤ c} over the marked cells."""
        k = self.resting.index(i)
        kept = {self.energy.variables[j] for j in self.reduced.s}
        if self.A.free_symbols <= kept and self.energy.phi is None:
            return self._jointly(k, reach)
        return self._over_cells(lambda room, box: self._within(k, reach, room, box))

    def _jointly(self, k: int, reach: arb) -> bool:
        """W + ½ reach² det A/det A₍ₖ₎ > c, the sum as one energy."""
        others = [j for j in range(self.A.rows) if j != k]
        minor = self.A.extract(others, others)
        stiff = sp.cancel(sp.together(self.A.det() / minor.det()))
        half = sp.Rational(*float(reach.lower()).as_integer_ratio()) ** 2 / 2
        raised = Energy(self.energy.model, self.energy.active, half * stiff)
        return self._above(self.reduced.over(raised), lambda cell: cell)

    def _within(self, k: int, reach: arb, room: arb, box: Box) -> bool:
        """A − 2(c − w)/(δ reach²) eₖeₖᵀ ≻ 0 on a fibre."""
        shift, variables = 2 * room / (self.delta * reach * reach), self.energy.variables
        counts = [self.A.has(v) for v in variables]

        def test(piece: Box) -> bool:
            values = {v: ball(*side) for v, side in zip(variables, piece, strict=True)}
            matrix = evaluated(self.A, values)
            matrix[k, k] = matrix[k, k] - shift
            return positive(matrix, 0)

        return by_bisection(box, test, _DEPTH, counts)

    def state_stays(self, position: int, end: float) -> bool:
        """Whether eᵢ = end is met nowhere in {V ≤ c}: min {V(s, e): eᵢ = end} > c."""
        held = self.reduced.holding(position)
        at = held.s.index(position)
        return self._above(held, lambda cell: (*cell[:at], (end, end), *cell[at:]))

    def _above(self, other: Reduced, placed: Callable[[Box], Box]) -> bool:
        """Whether another w, at a place that belongs to each cell, is above c where w is not."""
        level = self.cells.level

        def test(cell: Box) -> bool:
            cover = other.cover(placed(cell))
            if cover is not None and bool(cover.low > level):
                return True
            own = self.reduced.cover(cell)
            return own is not None and bool(own.low > level)

        return self.cells.everywhere(test)

    def _over_cells(self, test: Callable[[arb, Box], bool]) -> bool:
        """Whether a test holds of (c − w at most, fibre) over all marked cells."""
        level = self.cells.level

        def on(cell: Box) -> bool:
            cover = self.reduced.cover(cell)
            if cover is None:
                return False
            return bool(cover.low > level) or test(*self.cells.fibre(cell, cover, level))

        return self.cells.everywhere(on)

    def reach(self, sides: Mapping[int, Side]) -> bool:
        """Whether Ω is within these sides of all states; bounds that are proved count as such."""
        bounds, active = self.energy.model.named_bounds, self.energy.active
        free = {
            i: min(-lo if lo > bounds[i][0] else math.inf, hi if hi < bounds[i][1] else math.inf)
            for i, (lo, hi) in sides.items()
        }

        def inside(room: arb, box: Box) -> bool:
            held = all(
                (sides[i][0] <= lo or sides[i][0] <= bounds[i][0])
                and (hi <= sides[i][1] or sides[i][1] >= bounds[i][1])
                for i, (lo, hi) in zip(active, box, strict=True)
            )
            return held and all(
                free[i] == math.inf or (free[i] > 0 and self._within(k, arb(free[i]), room, box))
                for k, i in enumerate(self.resting)
            )

        return self._over_cells(inside)
