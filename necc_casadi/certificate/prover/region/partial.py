"""The largest region by partial minimisation: the obstacle first, then the proof just below it."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import islice

import numpy as np

from necc_casadi.arrays import Vector
from necc_casadi.certificate.prover.arithmetic.intervals import Interval
from necc_casadi.certificate.prover.arithmetic.potential import Potential
from necc_casadi.certificate.prover.region.bounds import Bounds, bounds_of
from necc_casadi.certificate.prover.region.critical_box import critical_box
from necc_casadi.certificate.prover.region.leaves import (
    Base,
    Leaves,
    prove_component,
    prove_unique,
)
from necc_casadi.certificate.prover.region.obstacle import Obstacle, Search, search
from necc_casadi.certificate.prover.region.reduced import Reduced
from necc_casadi.certificate.prover.region.split import Splits

__all__ = ["PartialProof", "prove_partial"]

#: Shares of the obstacle's height that are tried, the first by the number of kept states, and ways
#: to split that are tried: cells that tell w from a pass grow in number with both.
_FIRST_SHARE = {1: 0.995, 2: 0.99, 3: 0.98}
_SHARES = (0.97, 0.95, 0.9, 0.8, 0.5)
_SPLITS = 3
#: Cells per axis at first, by the number of kept states.
_FIRST = {1: 32, 2: 16, 3: 8}
#: Half-width of the first search, in natural sizes; how often it may grow, and by which share.
_REACH, _GROWTHS, _WIDER = 2.0, 8, 0.5
#: The part of the way to the obstacle in which the component must stay off the box's border.
_INNER = 0.999
#: Room around a critical box, as a share of its sides: its border must be free as well.
_ROOM = 0.02


@dataclass(frozen=True, eq=False)
class PartialProof:
    """A component of {V ≤ c}, or the whole space, that holds one critical point of V."""

    reduced: Reduced
    leaves: Leaves | None  # None: V is strongly convex in all active states, nothing is kept
    level: float  # c; +∞ for the whole space
    obstacle: Obstacle | None  # what ends the component; None for the whole space

    @property
    def is_whole(self) -> bool:
        """Whether the whole space is meant."""
        return self.obstacle is None


def prove_partial(potential: Potential, z_bar: Interval) -> PartialProof | None:
    """The best proof over the ways to split the active states; `z_bar` (d,) holds z̄ in them."""
    design, active = potential.design, list(potential.active)
    bounds = bounds_of(design)
    box = critical_box(potential)
    if np.isfinite(bounds.lo).any() or np.isfinite(bounds.hi).any():
        box = None  # the user's bounds end the claim before the whole space does
    splits = Splits(potential)
    z_star = design.z_star[active]
    around = Interval(
        np.maximum(z_star - _REACH, bounds.lo[active]),
        np.minimum(z_star + _REACH, bounds.hi[active]),
    )
    bottom = float(potential.jet(z_bar[None, :]).value.hi[0])
    for reduced in islice(splits.candidates(around if box is None else box), _SPLITS):
        proof = _proved(Bounds(reduced, splits, bounds), box, z_bar, bottom)
        if proof is not None:
            return proof
    return None


def _proved(
    bounds: Bounds, box: Interval | None, z_bar: Interval, bottom: float
) -> PartialProof | None:
    reduced = bounds.reduced
    kept = list(reduced.kept)
    if not kept:
        whole = bool(
            not np.isfinite(bounds.bounds.lo).any() and not np.isfinite(bounds.bounds.hi).any()
        )
        return PartialProof(reduced, None, np.inf, None) if whole else None
    s_bar = z_bar[kept]
    start = None if box is None else box[kept]
    found, obstacle = _explored(bounds, start, s_bar.mid, bottom)
    if obstacle is None:
        return None if start is None else _unique(reduced, start, s_bar)
    for share in (_FIRST_SHARE[len(kept)], *_SHARES):
        level = bottom + share * (obstacle.level - bottom)
        lo, hi = found.around(bottom + max(share, _INNER) * (obstacle.level - bottom))
        base = _base(bounds, lo, hi)
        fitting = _refloored(bounds, base)
        if fitting is None:
            return None
        leaves = prove_component(fitting.reduced, base, s_bar, level, bottom)
        if leaves is not None and fitting.kept(leaves, level):
            return PartialProof(fitting.reduced, leaves, level, obstacle)
    return None


def _unique(reduced: Reduced, box: Interval, s_bar: Interval) -> PartialProof | None:
    """The whole space, where w has one critical point in a box that holds all of them."""
    room = _ROOM * (box.hi - box.lo)
    base = Base(box.lo - room, box.hi - box.lo + 2 * room, _FIRST[len(room)])
    leaves = prove_unique(reduced, base, s_bar)
    return None if leaves is None else PartialProof(reduced, leaves, np.inf, None)


def _explored(
    bounds: Bounds, start: Interval | None, s_bar: Vector, bottom: float
) -> tuple[Search, Obstacle | None]:
    """What ends the component of s̄, in floats; the box grows until something does."""
    active = bounds.reduced.potential.active
    kept = [active[i] for i in bounds.reduced.kept]
    least, most = bounds.bounds.lo[kept], bounds.bounds.hi[kept]
    lo, hi = (s_bar - _REACH, s_bar + _REACH) if start is None else (start.lo, start.hi)
    lo, hi = np.maximum(lo, least), np.minimum(hi, most)
    for _ in range(_GROWTHS):
        found = search(bounds.reduced.landscape, lo, hi, s_bar)
        met = [o for o in (found.first(s_bar), bounds.lowest(found)) if o is not None]
        obstacle = min(met, key=lambda o: o.level, default=None)
        if obstacle is None and start is not None:
            return found, None
        level = np.inf if obstacle is None else bottom + _INNER * (obstacle.level - bottom)
        low, high = found.open_sides(level)
        low, high = low & (lo > least), high & (hi < most)
        if obstacle is not None and not low.any() and not high.any():
            return found, obstacle
        width = hi - lo
        lo = np.maximum(lo - _WIDER * width * low, least)
        hi = np.minimum(hi + _WIDER * width * high, most)
    return found, _edge(found) if obstacle is None else obstacle


def _edge(found: Search) -> Obstacle:
    """Where the flood leaves the largest box that was searched: no real obstacle was met."""
    tiny = 1e-9 * (found.hi - found.lo)
    border = ((found.nodes <= found.lo + tiny) | (found.nodes >= found.hi - tiny)).any(1)
    at = int(np.argmin(np.where(border, found.levels, np.inf)))
    level = float(found.levels[at])
    return Obstacle("arithmetic", level, found.nodes[at], found.minima.e[at])


def _base(bounds: Bounds, lo: Vector, hi: Vector) -> Base:
    """The box of the proof, inside the user's bounds."""
    active = bounds.reduced.potential.active
    kept = [active[i] for i in bounds.reduced.kept]
    lo = np.maximum(lo, bounds.bounds.lo[kept])
    hi = np.minimum(hi, bounds.bounds.hi[kept])
    side = hi - lo
    side = np.where(lo + side > hi, np.nextafter(side, 0.0), side)
    return Base(lo, side, _FIRST[len(lo)])


def _refloored(bounds: Bounds, base: Base) -> Bounds | None:
    """The same split with a floor that holds for s in the box of the proof."""
    reduced = bounds.reduced
    d = len(reduced.kept) + len(reduced.gone)
    lo, hi = np.full(d, -np.inf), np.full(d, np.inf)
    lo[list(reduced.kept)], hi[list(reduced.kept)] = base.lo, base.box.hi
    fitting = bounds.splits.split(reduced.kept, Interval(lo, hi))
    return None if fitting is None else Bounds(fitting, bounds.splits, bounds.bounds)
