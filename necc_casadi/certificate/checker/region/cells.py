"""The marked cells of a region, proved again: what w does on them and on the faces around them.

Over the marked cells of s, w is regular or convex, and w > c on every face that no other marked
cell shares: their union holds the component of {w ≤ c} with s̄, and w has one critical point there.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import cached_property

from flint import arb

from necc_casadi.certificate.checker.arithmetic.balls import Box, ball, by_bisection, ends
from necc_casadi.certificate.checker.region.reduced import Cover, Reduced
from necc_casadi.certificate.claims.regions import Leaf, Region

__all__ = ["CellsProof"]

#: How often a cell or a face may be halved before a test on it counts as failed, and before its
#: fibre counts as not bounded.
_DEPTH, _FIBRES = 9, 3


class CellsProof:
    """The marked cells of a region: what w does on them and on the faces around them."""

    def __init__(self, reduced: Reduced, region: Region) -> None:
        self.reduced, self.region, self.level = reduced, region, region.level
        self.leaves = set(region.leaves)

    # --- geometry: integers, and ends that are computed as the region says --------------------

    def are_apart(self) -> bool:
        """Whether the box is one, and no marked cell is part of another."""
        region = self.region
        return (
            all(math.isfinite(v) for side in (region.box.lo, region.box.side) for v in side)
            and all(v > 0 for v in region.box.side)
            and not self._above_leaves & self.leaves
        )

    def _parents(self, leaf: Leaf) -> Iterator[Leaf]:
        depth, index = leaf
        while depth > 0:
            depth, index = depth - 1, tuple(k // 2 for k in index)
            yield depth, index

    def _covered(self, cell: Leaf) -> bool:
        return cell in self.leaves

    def _below_a_leaf(self, cell: Leaf) -> bool:
        """Whether a cell is marked, or part of a marked one."""
        return self._covered(cell) or any(map(self._covered, self._parents(cell)))

    @cached_property
    def _above_leaves(self) -> set[Leaf]:
        """Cells that hold smaller marked ones."""
        return {parent for leaf in self.leaves for parent in self._parents(leaf)}

    def faces(self) -> Iterator[Box]:
        """Faces of marked cells that no marked cell covers from the other side."""
        for depth, index in sorted(self.leaves):
            for axis in range(len(index)):
                for side in (-1, 1):
                    other = (depth, (*index[:axis], index[axis] + side, *index[axis + 1 :]))
                    yield from self._open(other, axis, side)

    def _open(self, other: Leaf, axis: int, side: int) -> Iterator[Box]:
        """The faces between a marked cell and the place beside it that are not covered there."""
        if self._below_a_leaf(other):
            return
        if other not in self._above_leaves:
            yield self._face(other, axis, side)
            return
        depth, index = other
        near = 0 if side > 0 else 1
        for move in range(2 ** (len(index) - 1)):
            bits = [(move >> k) & 1 for k in range(len(index) - 1)]
            bits.insert(axis, near)
            child = tuple(2 * k + b for k, b in zip(index, bits, strict=True))
            yield from self._open((depth + 1, child), axis, side)

    def _face(self, other: Leaf, axis: int, side: int) -> Box:
        """The face of a cell, which may lie outside of the box, on the side of the marked one."""
        depth, index = other
        inner = (depth, (*index[:axis], index[axis] - side, *index[axis + 1 :]))
        box = self.region.box.cell(inner)
        end = box[axis][1] if side > 0 else box[axis][0]
        return (*box[:axis], (end, end), *box[axis + 1 :])

    # --- what has to be proved -----------------------------------------------------------------

    def hold_minimum(self, s_bar: Box) -> bool:
        """Whether s̄ is inside the core, in marked cells."""
        core = self.region.core
        inside = all(a < lo and hi < b for (a, b), (lo, hi) in zip(core, s_bar, strict=True))
        meets = [leaf for leaf in self.leaves if _touch(self.region.box.cell(leaf), s_bar)]
        return inside and bool(meets)

    def core_is_convex(self) -> bool:
        """Whether ∇²w ≻ 0 on the core, which lies in the box."""
        core, whole = self.region.core, self.region.box.whole
        inside = all(a <= lo and hi <= b for (lo, hi), (a, b) in zip(core, whole, strict=True))
        return inside and by_bisection(core, self.reduced.convex, _DEPTH)

    def cells_are_settled(self) -> bool:
        """Whether every marked cell is in the core, or ∇w ≠ 0 wherever w ≤ c on it."""
        core = self.region.core
        for leaf in sorted(self.leaves):
            box = self.region.box.cell(leaf)
            if all(a <= lo and hi <= b for (lo, hi), (a, b) in zip(box, core, strict=True)):
                continue
            if not self._everywhere(box, self._settled):
                return False
        return True

    def _settled(self, cover: Cover | None) -> bool:
        return _is_regular(cover) or self._is_above(cover)

    def _is_above(self, cover: Cover | None) -> bool:
        return cover is not None and bool(cover.low > self.level)

    def faces_are_above(self) -> bool:
        """Whether w > c on every face around the marked cells."""
        return all(self._everywhere(face, self._is_above) for face in self.faces())

    def _everywhere(self, box: Box, test: Callable[[Cover | None], bool]) -> bool:
        return by_bisection(box, lambda piece: test(self.reduced.cover(piece)), _DEPTH)

    def everywhere(self, test: Callable[[Box], bool]) -> bool:
        """Whether a test holds on pieces of every marked cell."""
        cells = map(self.region.box.cell, sorted(self.leaves))
        return all(by_bisection(cell, test, _DEPTH) for cell in cells)

    def fibres(self, level: float) -> Iterator[tuple[arb, Box]]:
        """(c − w at most, box of the active states) for marked cells: their union holds {V ≤ c}."""
        for leaf in sorted(self.leaves):
            yield from self._fibre(self.region.box.cell(leaf), level, _FIBRES)

    def _fibre(self, cell: Box, level: float, depth: int) -> Iterator[tuple[arb, Box]]:
        cover = self.reduced.cover(cell)
        if cover is not None and bool(cover.low > level):
            return
        if cover is None:
            if depth == 0:
                raise ArithmeticError("a marked cell has no bound of its fibre")
            axis = max(range(len(cell)), key=lambda k: cell[k][1] - cell[k][0])
            lo, hi = cell[axis]
            middle = lo / 2 + hi / 2
            for half in ((lo, middle), (middle, hi)):
                yield from self._fibre((*cell[:axis], half, *cell[axis + 1 :]), level, depth - 1)
            return
        yield self.fibre(cell, cover, level)

    def fibre(self, cell: Box, cover: Cover, level: float) -> tuple[arb, Box]:
        """(c − w at most, box of the active states that holds {V ≤ c} over a cell)."""
        room = (level - cover.low).upper().max(arb(0))
        reach = (2 * room).sqrt()
        box: list[tuple[float, float]] = [(0.0, 0.0)] * self.reduced.energy.d
        for k, i in enumerate(self.reduced.s):
            box[i] = cell[k]
        for k, i in enumerate(self.reduced.e):
            swing = reach * self.reduced.widths[k] * ball(-1.0, 1.0)
            lo, hi = ends(cover.e[k] + swing)
            if self.region.tube:
                least, most = self.region.tube[k]
                lo, hi = min(max(lo, least), most), max(min(hi, most), least)
            box[i] = (lo, hi)
        return room, tuple(box)


def _is_regular(cover: Cover | None) -> bool:
    return cover is not None and cover.regular


def _touch(a: Box, b: Box) -> bool:
    return all(lo <= high and low <= hi for (lo, hi), (low, high) in zip(a, b, strict=True))
