"""The largest component by partial minimisation: its obstacle first, then the proof below it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import islice

import numpy as np

from necc_casadi.arrays import Vector
from necc_casadi.certificate.claims.regions import CellBox, Region, Side, numbers, packed, rows
from necc_casadi.certificate.prover.arithmetic.intervals import Interval
from necc_casadi.certificate.prover.arithmetic.potential import Potential
from necc_casadi.certificate.prover.region.bounds import Bounds, bounds_of
from necc_casadi.certificate.prover.region.leaves import Base, Leaves, prove_component
from necc_casadi.certificate.prover.region.obstacle import (
    NEAR_ENOUGH,
    Obstacle,
    Search,
    judged,
    search,
)
from necc_casadi.certificate.prover.region.reduced import Reduced
from necc_casadi.certificate.prover.region.split import Splits
from necc_casadi.certificate.prover.region.tube import bent_split, convex_over, tube_around

__all__ = ["Component", "Components", "sides"]

#: Shares of the obstacle's height that are tried, the first by the number of kept states, and ways
#: to split that are tried: cells that tell w from a pass grow in number with both.
_FIRST_SHARE = {0: 0.999, 1: 0.995, 2: 0.99, 3: 0.98}
_SHARES = (0.97, 0.95, 0.9, 0.8, 0.5, 0.2, 0.05)
_TUBE_SHARES = (0.95, 0.8, 0.5)
_SPLITS = 3
#: Shares that are tried before the least one, without which none of the others is.
_HOPEFUL = 2
#: How often the box of the search may grow, and by which share of its sides.
_GROWTHS, _WIDER = 8, 0.5
#: How often the domain is doubled where nothing ends the component, and V has no form by which the
#: whole space could be proved.
_DOUBLINGS = 4
#: A split, the box of the proof, the search and its level → the split with a floor that fits.
_Fit = Callable[[Bounds, Base, Search, float], Bounds | None]
#: The part of the way to the obstacle in which the component must stay off the box's border.
_INNER = 0.999
#: What a tube holds, as a multiple of the level.
_NEXT = 1.05


@dataclass(frozen=True, eq=False)
class Component:
    """A component of {V ≤ c} that holds one critical point of V, z̄; natural units."""

    bounds: Bounds
    leaves: Leaves
    level: float  # c
    obstacle: Obstacle
    ranges: Interval  # (N,), of every state on it

    @property
    def reduced(self) -> Reduced:
        """V with the states that are not kept minimised out."""
        return self.bounds.reduced

    def fibres(self, level: float) -> Interval:
        """Boxes (B, d) of the active states that hold the component at a lower level."""
        return self.bounds.fibres(self.leaves, level)[1]

    @property
    def region(self) -> Region:
        """The component as data."""
        leaves, reduced = self.leaves, self.reduced
        base, marked = leaves.base, np.flatnonzero(leaves.marked)
        return Region(
            level=self.level,
            active=reduced.potential.active,
            kept=reduced.kept,
            floor=rows(reduced.floor),
            bends=(None, None) if reduced.tube is not None else self.bounds.splits.bends,
            tube=() if reduced.tube is None else sides(reduced.tube),
            box=CellBox(numbers(base.lo), numbers(base.side), base.parts),
            core=sides(leaves.core),
            cells=packed((int(leaves.depth[k]), tuple(map(int, leaves.index[k]))) for k in marked),
        )


def sides(box: Interval) -> tuple[Side, ...]:
    """A box (d,) as data."""
    return tuple((float(a), float(b)) for a, b in zip(box.lo, box.hi, strict=True))


@dataclass(frozen=True, eq=False)
class Components:
    """Components of {V ≤ c} around z̄, at the level of an obstacle or at a given one."""

    potential: Potential
    z_bar: Interval  # (d,), holds z̄ in the active states

    @cached_property
    def bounds(self) -> Interval:
        """The bounds that the model names, (N,)."""
        return bounds_of(self.potential.design)

    @cached_property
    def bottom(self) -> float:
        """An upper bound of V(z̄)."""
        return float(self.potential.jet(self.z_bar[None, :]).value.hi[0])

    @cached_property
    def _splits(self) -> Splits:
        return Splits(self.potential)

    @cached_property
    def _around(self) -> Interval:
        """Where the search begins; it grows until something ends the component."""
        active = list(self.potential.active)
        domain = self.potential.design.domain.of(active)
        lo = np.maximum(np.minimum(domain.lo, self.z_bar.lo), self.bounds.lo[active])
        hi = np.minimum(np.maximum(domain.hi, self.z_bar.hi), self.bounds.hi[active])
        return Interval(lo, hi)

    @cached_property
    def candidates(self) -> list[Bounds]:
        """Ways to split the states, the fewest kept first."""
        found = islice(self._splits.candidates(self._around), _SPLITS)
        return [self._bounded(reduced) for reduced in found]

    def largest(self) -> Component | None:
        """The component just below its obstacle; None where none is proved."""
        active = list(self.potential.active)
        least, most = self.bounds.lo[active], self.bounds.hi[active]
        if not ((least < self.z_bar.lo) & (self.z_bar.hi < most)).all():
            return None
        found = map(self._below_obstacle, self.candidates)
        best = next((component for component in found if component is not None), None)
        if best is not None and best.obstacle.kind != "arithmetic":
            return best
        split = bent_split(self._splits, self._around)
        tubed = None if split is None else self._below_obstacle(self._bounded(split), _tubed)
        return max((c for c in (best, tubed) if c is not None), key=_level, default=None)

    def _bounded(self, reduced: Reduced) -> Bounds:
        return Bounds(reduced, self._splits, self.bounds)

    def _below_obstacle(self, bounds: Bounds, fit: _Fit | None = None) -> Component | None:
        found, obstacle = self._explored(bounds, np.inf)
        if obstacle is None:
            return self._grown(bounds) if fit is None else None
        height = obstacle.level - self.bottom
        if not height > 0:
            return None
        obstacle = judged(self.potential, obstacle)
        first = _FIRST_SHARE[len(bounds.reduced.kept)]
        shares = (first, *(_SHARES if fit is None else _TUBE_SHARES))

        def below(share: float) -> Component | None:
            # a tube is convex the better the less it has to hold
            inner = _INNER if fit is None else min(_INNER, _NEXT * share)
            room = self.bottom + max(share, inner) * height
            named = obstacle if share >= NEAR_ENOUGH else replace(obstacle, kind="arithmetic")
            level = self.bottom + share * height
            return self._at(bounds, found, level, room, named, fit)

        found_below = map(below, shares[:_HOPEFUL])
        component = next((c for c in found_below if c is not None), None)
        if component is not None:
            return component
        least = below(shares[-1])
        if least is None:
            return None
        found_below = map(below, shares[_HOPEFUL:-1])
        return next((c for c in found_below if c is not None), least)

    def _grown(self, bounds: Bounds) -> Component | None:
        """Where nothing ends it: the component inside the largest box in which one is proved."""
        kept = list(bounds.reduced.kept)
        box, s_bar = self._around[kept], self.z_bar[kept].mid
        best: Component | None = None
        for doubling in range(_DOUBLINGS):
            lo, hi = (s_bar + 2.0**doubling * (end - s_bar) for end in (box.lo, box.hi))
            found = search(bounds.reduced.landscape, lo, hi, s_bar, bounds.defined)
            edge = _edge(found)
            level = self.bottom + _FIRST_SHARE[len(kept)] * (edge.level - self.bottom)
            component = self._at(bounds, found, level, edge.level, edge)
            if component is None:
                break
            best = component
        return best

    def at(self, level: float, obstacle: Obstacle) -> Component | None:
        """The component at a level below which no obstacle is met."""
        for bounds in self.candidates:
            found, _ = self._explored(bounds, level)
            component = self._at(bounds, found, level, level, obstacle)
            if component is not None:
                return component
        return None

    def _at(
        self,
        bounds: Bounds,
        found: Search,
        level: float,
        room: float,
        obstacle: Obstacle,
        fit: _Fit | None = None,
    ) -> Component | None:
        kept = list(bounds.reduced.kept)
        if not (found.levels <= room).any():
            return None
        base = _base(bounds, *found.around(room))
        fitting = (fit or _refloored)(bounds, base, found, room)
        if fitting is None:
            return None
        leaves = prove_component(
            fitting.reduced, base, self.z_bar[kept], level, self.bottom, fitting.defined_on
        )
        if leaves is None or not fitting.kept(leaves, level):
            return None
        ranges = fitting.ranges(leaves, level)
        return None if ranges is None else Component(fitting, leaves, level, obstacle, ranges)

    def _explored(self, bounds: Bounds, ceiling: float) -> tuple[Search, Obstacle | None]:
        """What ends the component of s̄ below a level, in floats; the box grows until it fits."""
        active, reduced = self.potential.active, bounds.reduced
        kept = [active[i] for i in reduced.kept]
        s_bar = self.z_bar[list(reduced.kept)].mid
        least, most = self.bounds.lo[kept], self.bounds.hi[kept]
        box = self._around[list(reduced.kept)]
        lo, hi = box.lo, box.hi
        for _ in range(_GROWTHS):
            found = search(reduced.landscape, lo, hi, s_bar, bounds.defined)
            met = [o for o in (found.first(s_bar), bounds.lowest(found)) if o is not None]
            obstacle = min(met, key=lambda o: o.level, default=None)
            level = ceiling
            if obstacle is not None:
                level = min(ceiling, self.bottom + _INNER * (obstacle.level - self.bottom))
            low, high = found.open_sides(level)
            low, high = low & (lo > least), high & (hi < most)
            if not low.any() and not high.any():
                return found, obstacle
            width = hi - lo
            lo = np.maximum(lo - _WIDER * width * low, least)
            hi = np.minimum(hi + _WIDER * width * high, most)
        return found, obstacle


def _edge(found: Search) -> Obstacle:
    """Where the flood leaves the largest box that was searched: no real obstacle was met."""
    tiny = 1e-9 * (found.hi - found.lo)
    border = ((found.nodes <= found.lo + tiny) | (found.nodes >= found.hi - tiny)).any(1)
    return found.node("arithmetic", int(np.argmin(np.where(border, found.levels, np.inf))))


def _base(bounds: Bounds, lo: Vector, hi: Vector) -> Base:
    """The box of the proof, inside the user's bounds."""
    active = bounds.reduced.potential.active
    kept = [active[i] for i in bounds.reduced.kept]
    lo = np.maximum(lo, bounds.bounds.lo[kept])
    hi = np.minimum(hi, bounds.bounds.hi[kept])
    side = hi - lo
    side = np.where(lo + side > hi, np.nextafter(side, 0.0), side)
    return Base.of(lo, side)


def _level(component: Component) -> float:
    return component.level


def _refloored(bounds: Bounds, base: Base, found: Search, level: float) -> Bounds | None:
    """The same split with a floor that holds for s in the box of the proof."""
    reduced = bounds.reduced
    d = len(reduced.kept) + len(reduced.gone)
    lo, hi = np.full(d, -np.inf), np.full(d, np.inf)
    lo[list(reduced.kept)], hi[list(reduced.kept)] = base.lo, base.box.hi
    fitting = bounds.splits.split(reduced.kept, Interval(lo, hi))
    return None if fitting is None else Bounds(fitting, bounds.splits, bounds.bounds)


def _tubed(bounds: Bounds, base: Base, found: Search, level: float) -> Bounds | None:
    """The same split with a tube that is to hold the component, and a floor that holds there."""
    reduced, active = bounds.reduced, list(bounds.reduced.potential.active)
    tube = tube_around(reduced, found, level)
    if tube is None:
        return None
    gone = [active[i] for i in reduced.gone]
    lo = np.maximum(tube.lo, bounds.bounds.lo[gone])
    tube = Interval(lo, np.minimum(tube.hi, bounds.bounds.hi[gone]))
    y_bar = reduced.potential.design.z_star[active]
    floor = convex_over(reduced, base.box, tube, y_bar)
    if floor is None:
        return None
    own = Interval(bounds.bounds.lo.copy(), bounds.bounds.hi.copy())
    own.lo[gone], own.hi[gone] = tube.lo, tube.hi
    return Bounds(replace(reduced, floor=floor, tube=tube), bounds.splits, own)
