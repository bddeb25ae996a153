"""A region on a grid: V > c around the marked cells, and no critical point but z̄ in them.

The component of {V ≤ c} around z̄ is connected, so it stays within cells on whose outer faces V > c.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence

import numpy as np
from flint import arb, arb_mat

from necc_casadi.certificate.checker.arithmetic.balls import Box, by_bisection
from necc_casadi.certificate.checker.arithmetic.definite import middle_of, positive
from necc_casadi.certificate.checker.arithmetic.potential import Energy
from necc_casadi.certificate.checker.evidence import Evidence, Obligation
from necc_casadi.certificate.checker.region.sizes import sides_of, sizes_hold
from necc_casadi.certificate.claims.regions import GridRegion, LimitedBy

__all__ = ["GridProof"]


#: How often a cell is halved before it counts as one that may hold a critical point.
_NEAR = 2


#: So many cells may lie between the marked ones and the one that limits c: a pass.
_BESIDE = 3


class GridProof:
    """Cells [kh, (k+1)h]: V > c around the marked ones, no critical point but z̄ in them."""

    def __init__(self, evidence: Evidence, energy: Energy, region: GridRegion, z_bar: Box) -> None:
        self.model, self.energy, self.region, self.z_bar = evidence.model, energy, region, z_bar
        self.level, self.step = region.level, region.step
        self.first, self.shape = region.first, region.shape
        self.low, self.high = region.convex_block
        self.cells = {tuple(map(int, index)) for index in np.argwhere(region.mask)}

    def box(self, cell: Sequence[int]) -> Box:
        """The cell in the active states."""
        return tuple(
            ((f + k) * h, (f + k + 1) * h)
            for f, k, h in zip(self.first, cell, self.step, strict=True)
        )

    def boxes(self) -> list[Box]:
        """Boxes that cover the region."""
        return [self.box(cell) for cell in self.cells]

    def hull(self) -> Box:
        """A box that holds the region."""
        lows, highs = ([f(c[k] for c in self.cells) for k in range(len(self.shape))]
                       for f in (min, max))  # fmt: skip
        return tuple((a[0], b[1]) for a, b in zip(self.box(lows), self.box(highs), strict=True))

    def obligations(self, sizes: Mapping[str, float], share: float) -> list[Obligation]:
        """Cells, the convex block around z̄, ∇V ≠ 0 and V > c around, and the sizes."""
        return [
            ("the cells are exact", lambda: all(math.frexp(h)[0] == 0.5 for h in self.step)),
            ("the cells lie in the domain", self._in_domain),
            ("∇²V ≻ 0 on the cells around z̄", self._convex),
            ("no other cell holds a critical point", lambda: all(map(self._regular, self.cells))),
            ("V > c around the cells", lambda: all(map(self._enclosed, self.cells))),
            ("the sizes claimed", lambda: sizes_hold(self._sizes(), sizes, share)),
        ]

    def ends_at(self, limit: LimitedBy) -> bool:
        """Whether the region reaches a cell that is as the limit says."""
        if not limit.names_a_cell:
            return False
        border = limit.kind != "critical"
        named = not border or self._at_domain(limit.at) == (limit.kind == "border")
        return named and self._touches(limit.at, border)

    def _touches(self, cell: tuple[int, ...], border: bool) -> bool:
        """Whether the region reaches a cell of the border, or one that may hold a critical point.

        Beside the convex block such a cell would be part of it.
        """
        pairs = list(zip(cell, self.shape, strict=True))
        reach = range(-_BESIDE, _BESIDE + 1)
        beside = (
            tuple(map(sum, zip(cell, move, strict=True)))
            for move in itertools.product(reach, repeat=len(cell))
        )
        if not (all(0 <= k < n for k, n in pairs) and any(c in self.cells for c in beside)):
            return False
        if border:
            return any(k in (0, n - 1) for k, n in pairs)
        sides = zip(self.low, cell, self.high, strict=True)
        at_block = all(a <= k + 1 and k - 1 <= b for a, k, b in sides)
        return not at_block and not by_bisection(
            self.box(cell), lambda b: self._decided(b) or self._falls(b), _NEAR
        )

    def _decided(self, box: Box) -> bool:
        """Whether a component of ∇V cannot vanish on a box."""
        gradient = self.energy.gradient(box)
        return all(g.is_finite() for g in gradient) and any(
            bool(g > 0) or bool(g < 0) for g in gradient
        )

    def _at_domain(self, cell: Sequence[int]) -> bool:
        """Whether the domain ends at a cell or at the one beside it."""
        around = [(lo - h, hi + h) for (lo, hi), h in zip(self.box(cell), self.step, strict=True)]
        return not self.model.in_domain(self.region.active, around)

    def _in_domain(self) -> bool:
        parts = zip(self.first, self.shape, self.step, strict=True)
        return self.model.in_domain(self.region.active, [(f * h, (f + n) * h) for f, n, h in parts])

    def _convex(self) -> bool:
        """z̄ is inside a block of cells on which V is convex, and in a marked cell."""
        block = [range(a, b + 1) for a, b in zip(self.low, self.high, strict=True)]
        lo, hi = self.box(self.low), self.box(self.high)
        inside = all(
            a[0] <= z[0] and z[1] <= b[1] for a, b, z in zip(lo, hi, self.z_bar, strict=True)
        )
        within = all(
            a >= 0 and b < n for a, b, n in zip(self.low, self.high, self.shape, strict=True)
        )
        cells = list(itertools.product(*block))
        return (
            inside
            and within
            and self._marked()
            and all(
                by_bisection(self.box(c), lambda b: positive(self.energy.hessian(b), 0), 6)
                for c in cells
            )
        )

    def _marked(self) -> bool:
        return any(
            all(
                lo <= z[1] and z[0] <= hi
                for (lo, hi), z in zip(self.box(c), self.z_bar, strict=True)
            )
            for c in self.cells
        )

    def _regular(self, cell: tuple[int, ...]) -> bool:
        if all(a <= k <= b for a, k, b in zip(self.low, cell, self.high, strict=True)):
            return True

        def test(box: Box) -> bool:
            finite = all(g.is_finite() for g in self.energy.gradient(box))
            settled = self._decided(box) or (finite and self._falls(box))
            return settled or bool(self.energy.value(box) > self.level)

        return by_bisection(self.box(cell), test, 8)

    def _falls(self, box: Box) -> bool:
        """Whether V falls or rises along a direction in which the Casimirs hardly change."""
        middle: Box = tuple((lo / 2 + hi / 2,) * 2 for lo, hi in box)
        slopes = middle_of(arb_mat(self.energy.casimirs(middle)[1]))
        if not np.isfinite(slopes).all():
            return False
        directions = np.linalg.svd(slopes)[2][len(slopes) :]
        along = (self.energy.slope_along(box, t.tolist()) for t in directions)
        return any(bool(v > 0) or bool(v < 0) for v in along)

    def _enclosed(self, cell: tuple[int, ...]) -> bool:
        """V > c on every face of a marked cell that no other marked cell shares."""
        box = self.box(cell)
        for axis, (lo, hi) in enumerate(box):
            for move, end in ((-1, lo), (1, hi)):
                other = (*cell[:axis], cell[axis] + move, *cell[axis + 1 :])
                face = (*box[:axis], (end, end), *box[axis + 1 :])
                if other not in self.cells and not by_bisection(
                    face, lambda b: bool(self.energy.value(b) > self.level), 10
                ):
                    return False
        return True

    def _sizes(self) -> dict[str, arb]:
        """Volume, shares and reach of the cells that are wholly in {V ≤ c}; see the claim."""
        active, model = self.region.active, self.model
        n = self.energy.d - model.nc  # of the plant's axes
        inside = {c for c in self.cells if self._below(self.box(c))}
        volume = len(inside) * self._cell(range(self.energy.d))
        seen = {c[:n] for c in inside}
        rest = sorted(self.cells - inside)
        seen |= {c[:n] for c in rest if c[:n] not in seen and self._below(self._thin(c, n))}
        plant = self._cell(range(n)) / sides_of(model, active[:n])
        reach = {f"reach_{model.states[i]}": self._reach(k, inside) for k, i in enumerate(active)}
        return {
            "volume": volume,
            "domain_share": volume / sides_of(model, active),
            "slice_share": len(self._slice(n)) * plant,
            "plant_share": len(seen) * plant,
            **reach,
        }

    def _below(self, box: Box) -> bool:
        return by_bisection(box, lambda b: self.energy.at_most(b, self.level), 3)

    def _cell(self, axes: Sequence[int]) -> arb:
        """Product of a cell's sides along some axes."""
        result = arb(1)
        for k in axes:
            result = result * self.step[k]
        return result

    def _thin(self, cell: Sequence[int], n: int) -> Box:
        """The plant's part of a cell at the middle of its ξ."""
        box = self.box(cell)
        return (*box[:n], *((lo / 2 + hi / 2,) * 2 for lo, hi in box[n:]))

    def _slice(self, n: int) -> set[tuple[int, ...]]:
        """Cells of the plant's axes on which V ≤ c at ξ = ξ*, which lies in the component."""
        at = [(v, v) for v in self.model.xi_star]
        return {
            cell[:n]
            for cell in self.cells
            if all(lo <= v <= hi for (lo, hi), (v, _) in zip(self.box(cell)[n:], at, strict=True))
            and self._below((*self.box(cell)[:n], *at))
        }

    def _reach(self, axis: int, inside: set[tuple[int, ...]]) -> arb:
        """How far points in the region are from z̄ along an axis, the shorter side."""
        low, high = self.z_bar[axis]
        indices = [self.first[axis] + cell[axis] for cell in inside]
        if not indices:
            return arb(0)
        h = self.step[axis]
        return arb((low - arb(min(indices)) * h).min(arb(max(indices) + 1) * h - high).max(arb(0)))
