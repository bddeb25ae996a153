"""The box of states in which a design is looked at: the model's domain around a target."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import sympy as sp

from necc_casadi.arrays import Vector
from necc_casadi.model.closed_loop import ClosedLoop

__all__ = ["HALF_WIDTH", "Domain", "domain_of", "exact_bounds"]

#: Half the width of the box where the model names no bounds.
HALF_WIDTH = 2


@dataclass(frozen=True, eq=False)
class Domain:
    """A box of states."""

    lo: Vector  # (N,)
    hi: Vector  # (N,)

    def of(self, states: Sequence[int]) -> Domain:
        """The box of some of the states."""
        chosen = list(states)
        return Domain(self.lo[chosen], self.hi[chosen])


def domain_of(loop: ClosedLoop, z_star: Vector) -> Domain:
    """The box of all states (N,): the model's bounds; where it names none, z* ± 2."""
    lo, hi = z_star - HALF_WIDTH, z_star + HALF_WIDTH
    for index, name in enumerate(loop.states):
        if name in loop.plant.domain:
            lo[index], hi[index] = (float(bound) for bound in loop.plant.domain[name])
    return Domain(lo, hi)


def exact_bounds(
    loop: ClosedLoop, target: Mapping[sp.Symbol, sp.Expr]
) -> dict[sp.Symbol, tuple[sp.Expr, sp.Expr]]:
    """The same box in exact numbers; a state without a target of its own is taken around 0."""
    box = {}
    for symbol in loop.z:
        middle = target.get(symbol, sp.Integer(0))
        around = (middle - HALF_WIDTH, middle + HALF_WIDTH)
        box[symbol] = loop.plant.domain.get(str(symbol), around)
    return box
