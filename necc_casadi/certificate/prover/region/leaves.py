"""Adaptive cells that prove a component of {w ≤ c}, or that w has one critical point in a box.

Cells are cut where they are not settled: a cell is *out* where w > c, *regular* where ∇w ≠ 0, or
lies in the *core*, a box around s̄ on which ∇²w ≻ 0. The component of cells that are not out, from
the one with s̄, is the region when all of it is regular or core and w > c on the border of the box.
A second component of {w ≤ c} among its cells would hold a minimum of w in a regular cell.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np

from necc_casadi.arrays import Indices, Truth, Vector
from necc_casadi.certificate.prover.arithmetic.boxes import subdivide
from necc_casadi.certificate.prover.arithmetic.intervals import Interval
from necc_casadi.certificate.prover.region.reduced import Cover, Reduced

__all__ = ["Base", "Leaves", "prove_component", "prove_unique"]

#: Cells per axis at first; pieces per axis of the core; rounds of cutting; cells at most.
_FIRST = {0: 1, 1: 32, 2: 16, 3: 8}
_CORE = {1: 16, 2: 6, 3: 3}
_ROUNDS, _MOST = 14, 20_000
#: From this round on, cells that straddle the level are cut too.
_STRADDLING = 5
#: Halves of the box's sides that are tried for the core, largest first.
_CORE_SHARES = (0.5, 0.25, 0.125, 0.0625, 0.03, 0.01, 0.003)


#: Side of a bucket over that of the largest cell, above 1 by more than any rounding.
_COARSER = 1.01


#: Cells (B, ds) → whether everything is smooth on each, as far as s alone tells.
Defined = Callable[[Interval], Truth]


@dataclass(frozen=True, eq=False)
class Base:
    """A box that is cut into n cells a side, and each of them into halves as often as needed.

    The ends of cell i at depth k are lo + i·(side/(n·2ᵏ)), computed alike wherever they are used:
    halving a cell twice the index at one more depth gives the same doubles.
    """

    lo: Vector  # (d,)
    side: Vector  # (d,)
    parts: int  # n, a power of two

    @classmethod
    def of(cls, lo: Vector, side: Vector) -> Base:
        """With as many cells at first as the number of states allows."""
        return cls(lo, side, _FIRST[len(lo)])

    def boxes(self, depth: Indices, index: Indices) -> Interval:
        """Cells of depth (B,) and index (B, d) as boxes (B, d)."""
        step = self.side / (self.parts * 2.0 ** depth[:, None])
        return Interval(self.lo + index * step, self.lo + (index + 1) * step)

    @property
    def box(self) -> Interval:
        """The whole box (d,)."""
        return Interval(self.lo, self.lo + self.side)


@dataclass(frozen=True, eq=False)
class Leaves:
    """Cells of a base, what is known of w on each, and which of them hold the region."""

    base: Base
    depth: Indices  # (B,)
    index: Indices  # (B, d)
    cover: Cover
    marked: Truth  # (B,)
    core: Interval  # (d,)

    @property
    def boxes(self) -> Interval:
        """The cells, (B, d)."""
        return self.base.boxes(self.depth, self.index)


def prove_component(
    reduced: Reduced,
    base: Base,
    s_bar: Interval,
    level: float,
    bottom: float,
    defined: Defined | None = None,
) -> Leaves | None:
    """The component of {w ≤ c} around s̄ in the box, with one critical point; None: not proved.

    `bottom` is an upper bound of V(z̄). Cells on which `defined` finds a pole are cut.
    """
    if not level > bottom:
        return None
    return _proved(reduced, base, s_bar, level, defined)


def prove_unique(reduced: Reduced, base: Base, s_bar: Interval) -> Leaves | None:
    """All cells of the box, in which w has exactly one critical point; None: not proved."""
    return _proved(reduced, base, s_bar, None)


def _proved(
    reduced: Reduced,
    base: Base,
    s_bar: Interval,
    level: float | None,
    defined: Defined | None = None,
) -> Leaves | None:
    core = _core(reduced, base, s_bar)
    if core is None:
        return None
    d = len(base.lo)
    index = np.array(list(product(range(base.parts), repeat=d)), dtype=int)
    leaves = _leaves(reduced, base, np.zeros(len(index), dtype=int), index, core)
    for turn in range(_ROUNDS):
        marked, needed = _judged(reduced, leaves, s_bar, level, turn)
        if defined is not None:
            needed |= marked & ~defined(leaves.boxes)
        if not needed.any():
            settled = Leaves(base, leaves.depth, leaves.index, leaves.cover, marked, core)
            return settled if marked.any() else None
        if len(needed) + int(needed.sum()) * (2**d - 1) > _MOST:
            return None
        leaves = _cut(reduced, leaves, needed)
    return None


def _leaves(reduced: Reduced, base: Base, depth: Indices, index: Indices, core: Interval) -> Leaves:
    cover = reduced.cover(base.boxes(depth, index))
    return Leaves(base, depth, index, cover, np.ones(len(depth), dtype=bool), core)


def _judged(
    reduced: Reduced, leaves: Leaves, s_bar: Interval, level: float | None, turn: int
) -> tuple[Truth, Truth]:
    """The cells that hold the region as far as is known, and those that have to be cut."""
    boxes, cover = leaves.boxes, leaves.cover
    inside = ((boxes.lo >= leaves.core.lo) & (boxes.hi <= leaves.core.hi)).all(1)
    settled = cover.regular | inside
    if level is None:
        return np.ones(len(settled), dtype=bool), ~settled
    out = cover.ok & (cover.w.lo > level)
    marked = _component(boxes, ~out, s_bar)
    needed = marked & ~settled
    needed |= _open_at_border(reduced, leaves, marked & ~needed, level)
    if turn >= _STRADDLING and needed.any():
        size = (boxes.hi - boxes.lo)[:, 0]
        wide = size > 1.01 * size[needed].min()
        needed |= marked & ~(cover.w.hi <= level) & wide
    return marked, needed


def _open_at_border(reduced: Reduced, leaves: Leaves, marked: Truth, level: float) -> Truth:
    """Marked cells on the border of the box on whose face there w > c is not proved."""
    result = np.zeros(len(marked), dtype=bool)
    for rows, faces in _border_faces(leaves, marked):
        cover = reduced.cover(faces)
        result[rows] |= ~(cover.ok & (cover.w.lo > level))
    return result


def _border_faces(leaves: Leaves, marked: Truth) -> Iterator[tuple[Indices, Interval]]:
    """Rows of marked cells on each side of the box, and their faces there."""
    boxes, count = leaves.boxes, leaves.base.parts * 2**leaves.depth
    for axis in range(boxes.shape[1]):
        index = leaves.index[:, axis]
        for at_side, end in ((index == 0, "lo"), (index == count - 1, "hi")):
            rows = np.flatnonzero(marked & at_side)
            if rows.size:
                faces = Interval(boxes.lo[rows].copy(), boxes.hi[rows].copy())
                at = getattr(boxes, end)[rows, axis]
                faces.lo[:, axis] = faces.hi[:, axis] = at
                yield rows, faces


def _component(boxes: Interval, open_: Truth, s_bar: Interval) -> Truth:
    """Open cells that are connected with those that meet the box of s̄; cells that touch are."""
    home = ((boxes.lo <= s_bar.hi) & (boxes.hi >= s_bar.lo)).all(1)
    marked: Truth = np.asarray(home & open_)
    if not marked.any():
        return marked
    rows = np.flatnonzero(open_)
    first, second = (rows[ends] for ends in _touching(boxes[rows]))
    while True:
        reached = second[marked[first] & ~marked[second]]
        if not reached.size:
            return marked
        marked[reached] = True


def _touching(boxes: Interval) -> tuple[Indices, Indices]:
    """Pairs of boxes (B, d) that have a point in common.

    Looked for among neighbours in a grid that is a little coarser than the largest box, so that
    boxes that touch are never more than one bucket apart.
    """
    size = _COARSER * (boxes.hi - boxes.lo).max(0)
    at = np.floor((boxes.lo - boxes.lo.min(0)) / size).astype(int)
    keys, bucket = np.unique(at, axis=0, return_inverse=True)
    members = np.split(
        np.argsort(bucket.ravel(), kind="stable"), np.cumsum(np.bincount(bucket.ravel()))[:-1]
    )
    place = {tuple(key): k for k, key in enumerate(keys.tolist())}
    first, second = [np.zeros(0, dtype=int)], [np.zeros(0, dtype=int)]
    for key, here in zip(keys.tolist(), members, strict=True):
        for step in product((-1, 0, 1), repeat=len(key)):
            other = place.get(tuple(a + b for a, b in zip(key, step, strict=True)))
            if other is None:
                continue
            there = members[other]
            below = boxes.lo[here][:, None] <= boxes.hi[there][None]
            above = boxes.hi[here][:, None] >= boxes.lo[there][None]
            a, b = np.nonzero((below & above).all(-1))
            first.append(here[a])
            second.append(there[b])
    return np.concatenate(first), np.concatenate(second)


def _cut(reduced: Reduced, leaves: Leaves, needed: Truth) -> Leaves:
    """Each needed cell cut in two along every axis."""
    d = leaves.index.shape[1]
    corners = np.array(list(product((0, 1), repeat=d)), dtype=int)
    index = (2 * leaves.index[needed][:, None] + corners).reshape(-1, d)
    depth = np.repeat(leaves.depth[needed] + 1, len(corners))
    new = _leaves(reduced, leaves.base, depth, index, leaves.core)
    kept = ~needed
    return Leaves(
        leaves.base,
        np.concatenate([leaves.depth[kept], new.depth]),
        np.concatenate([leaves.index[kept], new.index]),
        leaves.cover[kept].above(new.cover),
        np.ones(int(kept.sum()) + len(depth), dtype=bool),
        leaves.core,
    )


def _core(reduced: Reduced, base: Base, s_bar: Interval) -> Interval | None:
    """The largest box s̄ ± share of the sides on which ∇²w ≻ 0 is proved."""
    d = len(base.lo)
    if d == 0:  # V_ee ≻ 0 says it all
        return base.box if reduced.convex_on(base.box[None]) else None
    for share in _CORE_SHARES:
        half = share * base.side / 2
        box = Interval(s_bar.mid - half, s_bar.mid + half)
        box = Interval(np.maximum(box.lo, base.lo), np.minimum(box.hi, base.box.hi))
        holds = bool(((box.lo < s_bar.lo) & (s_bar.hi < box.hi)).all())
        if holds and reduced.convex_on(subdivide(box, _CORE[d])):
            return box
    return None
