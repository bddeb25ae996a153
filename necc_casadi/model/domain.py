"""The box of states in which a design is looked at: the model's domain around a target."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import sympy as sp

from necc_casadi.arrays import Vector
from necc_casadi.model.closed_loop import ClosedLoop
from necc_casadi.model.sizes import REACH, natural_sizes

__all__ = ["Domain", "domain_of", "exact_bounds"]


@dataclass(frozen=True, eq=False)
class Domain:
    """A box of states."""

    lo: Vector  # (N,)
    hi: Vector  # (N,)

    def of(self, states: Sequence[int]) -> Domain:
        """The box of some of the states."""
        chosen = list(states)
        return Domain(self.lo[chosen], self.hi[chosen])


def domain_of(loop: ClosedLoop, z_star: Vector, size: Vector) -> Domain:
    """The box of all states (N,): the model's bounds; where it names none, z* ± 2 sizes."""
    lo, hi = z_star - REACH * size, z_star + REACH * size
    for index, name in enumerate(loop.states):
        if name in loop.plant.domain:
            lo[index], hi[index] = (float(bound) for bound in loop.plant.domain[name])
    return Domain(lo, hi)


def exact_bounds(
    loop: ClosedLoop, target: Mapping[sp.Symbol, sp.Expr]
) -> dict[sp.Symbol, tuple[sp.Expr, sp.Expr]]:
    """The same box in exact numbers; a state without a target of its own is taken around 0."""
    box = {}
    sizes = natural_sizes(loop, (), target)
    for symbol, size in zip(loop.z, sizes.units.state, strict=True):
        middle, half = (
            target.get(symbol, sp.Integer(0)),
            REACH * sp.Rational(*float(size).as_integer_ratio()),
        )
        around = (middle - half, middle + half)
        box[symbol] = loop.plant.domain.get(str(symbol), around)
    return box
