"""The region certificate: the component Ω of {V ≤ c} around z̄, just below a real obstacle.

V̇ ≤ 0 makes such a compact component invariant, and LaSalle's principle says where its solutions
go. Where nothing ends it, its level is the one at which the input limits bind.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from necc_casadi.certificate.prover.arithmetic.intervals import Interval
from necc_casadi.certificate.prover.arithmetic.potential import Potential
from necc_casadi.certificate.prover.input_limits import input_level
from necc_casadi.certificate.prover.region.obstacle import Obstacle
from necc_casadi.certificate.prover.region.partial import Component, Components

__all__ = ["RegionProof", "prove_region", "prove_region_within_limits"]

#: Heights above V(z̄) at which input limits are tried: shares of the whole, smallest first; where
#: nothing ends the region, multiples of the natural unit of energy.
_SHARES = tuple(2.0**-k for k in range(12, -1, -1))
_HEIGHTS = tuple(2.0**k for k in range(-12, 21))
#: Halvings between the last height at which u keeps its limits and the first at which it does not.
_HALVINGS = 3
#: Shares of a height, and of the range of a state that is minimised out, that are given away.
_EASED, _ROOM = 1e-6, 0.01


@dataclass(frozen=True, eq=False)
class RegionProof:
    """A component and what is known of it; natural units."""

    component: Component
    bottom: float  # an upper bound of V(z̄)

    def height(self, level: float) -> float:
        """Less than a level above V(z̄), by what other arithmetic may need."""
        return (1 - _EASED) * (level - self.bottom)

    @cached_property
    def reach(self) -> Interval:
        """A box (N,) of all states that holds the component, with room for other arithmetic."""
        component = self.component
        found, s = component.ranges, np.zeros(len(component.ranges.lo), dtype=bool)
        s[[component.reduced.potential.active[i] for i in component.reduced.kept]] = True
        room = np.where(s, 0.0, _ROOM * (found.hi - found.lo))
        bounds = component.bounds.bounds
        return Interval(
            np.maximum(found.lo - room, bounds.lo), np.minimum(found.hi + room, bounds.hi)
        )

    @cached_property
    def level_u(self) -> float | None:
        """The largest level that was found at which u keeps its limits; None: none was."""
        height = self.component.level - self.bottom
        best: float | None = None
        low, high = 0.0, height
        for share in _SHARES:
            found = self._kept(self.bottom + share * height)
            if found is not None and (best is None or found > best):
                best = found
            if found is None or found < self.bottom + share * height:
                high = share * height
                break
            low = share * height
        for _ in range(_HALVINGS if low < height else 0):
            middle = (low + high) / 2
            found = self._kept(self.bottom + middle)
            if found is not None and (best is None or found > best):
                best = found
            whole = found is not None and found >= self.bottom + middle
            low, high = (middle, high) if whole else (low, middle)
        return best

    def _kept(self, level: float) -> float | None:
        """The largest level up to this one at which u keeps its limits, by boxes for this one."""
        level = min(level, self.component.level)
        reduced = self.component.reduced
        return input_level(reduced.potential, self.component.fibres(level), level, self.bottom)


def prove_region(potential: Potential, z_bar: Interval) -> RegionProof | None:
    """The component just below what ends it; None where none is proved."""
    components = Components(potential, z_bar)
    component = components.largest()
    return None if component is None else RegionProof(component, components.bottom)


def prove_region_within_limits(potential: Potential, z_bar: Interval) -> RegionProof | None:
    """The component at whose level the input limits bind, where nothing else ends it."""
    components = Components(potential, z_bar)
    best: RegionProof | None = None
    for height in _HEIGHTS:
        at = _bound_by_inputs(components.bottom + height)
        component = components.at(at.level, at)
        if component is None:
            break
        proof = RegionProof(component, components.bottom)
        level = proof.level_u
        if level is None:
            break
        if level < component.level:
            ended = components.at(level, _bound_by_inputs(level))
            return best if ended is None else RegionProof(ended, components.bottom)
        best = proof
    return best


def _bound_by_inputs(level: float) -> Obstacle:
    return Obstacle("input_limits", level, np.zeros(0))
