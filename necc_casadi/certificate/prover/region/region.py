"""The region certificate: the component Ω of {V ≤ c} around z̄, just below a real obstacle.

V̇ ≤ 0 makes such a compact component invariant, and LaSalle's principle says where its solutions
go. Where nothing ends it, its level is the one at which the input limits bind.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property

import numpy as np
import sympy as sp

from necc_casadi.certificate.claims.regions import Region
from necc_casadi.certificate.prover.arithmetic.intervals import Interval
from necc_casadi.certificate.prover.arithmetic.potential import Potential
from necc_casadi.certificate.prover.input_limits import (
    highest_at_rest,
    holding_level,
    holds_everywhere,
    input_level,
    without_damping,
)
from necc_casadi.certificate.prover.invariant_sets import OverBox
from necc_casadi.certificate.prover.region.bounds import bounds_of
from necc_casadi.certificate.prover.region.curved_search import prove_curved
from necc_casadi.certificate.prover.region.obstacle import Obstacle
from necc_casadi.certificate.prover.region.partial import Component, Components
from necc_casadi.certificate.prover.region.proof import RegionProof

__all__ = ["prove_region", "prove_region_within_limits"]

#: Heights above V(z̄) at which input limits are tried: shares of the whole, the largest first; where
#: nothing ends the region, multiples of the natural unit of energy.
_SHARES = tuple(8.0**-k for k in range(6))
_HEIGHTS = tuple(2.0**k for k in range(-12, 21))
#: Tries at levels that are nearer, until the level that failed is no higher than this multiple.
_NEARER, _NEAR = 7, 1.03
#: Halvings between the last height at which u keeps its limits and the first at which it does not.
_HALVINGS = 3
#: The share of the range of a state that is minimised out that is given away.
_ROOM = 0.01


class ComponentProof(RegionProof):
    """A component of which some states are minimised out."""

    def __init__(self, component: Component, bottom: float) -> None:
        self.component, self._bottom = component, bottom

    @cached_property
    def region(self) -> Region:
        """Ω as data."""
        return self.component.region

    @property
    def obstacle(self) -> Obstacle:
        """What Ω stays just below."""
        return self.component.obstacle

    @property
    def bottom(self) -> float:
        """An upper bound of V(z̄)."""
        return self._bottom

    @cached_property
    def place(self) -> OverBox:
        """A box (N,) of all states that holds Ω, with room for other arithmetic."""
        component = self.component
        loop = component.reduced.potential.design.loop
        found, s = component.ranges, np.zeros(len(component.ranges.lo), dtype=bool)
        bounds = bounds_of(component.reduced.potential.design, outwards=True)
        s[[component.reduced.potential.active[i] for i in component.reduced.kept]] = True
        room = np.where(s, 0.0, _ROOM * (found.hi - found.lo))
        lo, hi = np.maximum(found.lo - room, bounds.lo), np.minimum(found.hi + room, bounds.hi)
        return OverBox(loop.z, Interval(lo, hi))

    @cached_property
    def level_u(self) -> float | None:
        """The largest level that was found at which u keeps its limits; None: none was."""
        return self._largest(self.kept_below, self.component.reduced.potential)

    @cached_property
    def level_clipped(self) -> float | None:
        """The largest level that was found at which clipping does no harm; None: none was."""
        potential = without_damping(self.component.reduced.potential)
        return self._largest(self.held_below, potential)

    def _largest(
        self, below: Callable[[float], float | None], potential: Potential
    ) -> float | None:
        """The largest level that is found by boxes for a few levels, from the highest one down."""
        best: float | None = None
        height = self.component.level - self.bottom
        most = (highest_at_rest(potential) - self.bottom) / height
        high = min(1.0, most) if most > 0 else 1.0
        for share in (high * share for share in _SHARES):
            found = below(self._level(share))
            best = _larger(best, found)
            if found is not None:
                break
            high = share
        for _ in range(_NEARER):
            if best is None:
                break
            # boxes for a level that is nearer are tighter
            low = (best - self.bottom) / height
            if high <= _NEAR * low:
                break
            middle = float(np.sqrt(low * high))
            found = below(self._level(middle))
            best = _larger(best, found)
            if found is None or found < self._level(middle):
                high = middle
        return best

    def _level(self, share: float) -> float:
        """The level at a share of the component's height."""
        level = self.component.level
        return level if share == 1 else self.bottom + share * (level - self.bottom)

    def kept_below(self, level: float) -> float | None:
        """The largest level up to this one at which u keeps its limits, by boxes for this one."""
        potential = self.component.reduced.potential
        return input_level(potential, self.component.fibres(level), level, self.bottom)

    def held_below(self, level: float) -> float | None:
        """The largest level up to this one at which clipping does no harm."""
        potential = self.component.reduced.potential
        return holding_level(potential, self.component.fibres(level), level, self.bottom)


def prove_region(potential: Potential, minimum: Interval) -> RegionProof | None:
    """The component just below what ends it; None where none is proved.

    `potential` has the momenta at rest; `minimum` (N,) holds z̄.
    """
    curved = prove_curved(potential, minimum) if _is_curved(potential) else None
    if curved is not None:
        return curved
    components = Components(potential, minimum[list(potential.active)])
    component = components.largest()
    return None if component is None else ComponentProof(component, components.bottom)


def _is_curved(potential: Potential) -> bool:
    """Whether a Casimir is no linear function of the states."""
    loop, functions = potential.design.loop, potential.design.casimirs.functions
    return any(sp.diff(c, s).free_symbols for c in functions for s in loop.z)


def prove_region_within_limits(potential: Potential, minimum: Interval) -> RegionProof | None:
    """The component at whose level the input limits bind, where nothing else ends it.

    That is where limits may do harm or, where they do none, where they begin to be met.
    """
    components = Components(potential, minimum[list(potential.active)])
    design = potential.design
    clipped = not holds_everywhere(design)
    level = _level_of_limits(components, clipped)
    proof = None if level is None else _at(components, level)
    for _ in range(_HALVINGS):
        bound = None if proof is None else (proof.level_clipped if clipped else proof.level_u)
        if proof is None or bound in (None, proof.component.level):
            return proof
        proof = _at(components, bound or components.bottom)
    return None


def _level_of_limits(components: Components, clipped: bool) -> float | None:
    """The largest level that was found at which the limits are kept; None: none was."""
    best: float | None = None
    for height in _HEIGHTS:
        level = components.bottom + height
        proof = _at(components, level)
        kept = None
        if proof is not None:
            kept = proof.held_below(level) if clipped else proof.kept_below(level)
        best = _larger(best, kept)
        if kept is None or kept < level:
            break
    return best


def _at(components: Components, level: float) -> ComponentProof | None:
    """The component at a level that only the inputs end."""
    component = components.at(level, Obstacle("input_limits", level, np.zeros(0)))
    return None if component is None else ComponentProof(component, components.bottom)


def _larger(a: float | None, b: float | None) -> float | None:
    """The larger of two levels, either of which may not have been found."""
    return max((v for v in (a, b) if v is not None), default=None)
