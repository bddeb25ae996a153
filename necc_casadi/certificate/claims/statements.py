"""The words of a certificate: each held claim as a function of the data that is proved.

Maker and checker both word a claim with these, each from what it proved itself; a statement in
certificate.json that reads otherwise is not what was proved. Numbers are shown rounded to the
safe side.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from decimal import ROUND_CEILING, ROUND_FLOOR, Decimal

from necc_casadi.certificate.claims.regions import Follows, Kind, LimitedBy, Method, RegionClaim
from necc_casadi.certificate.claims.units import Units

__all__ = [
    "DAMPING",
    "DECREASE",
    "GLOBAL",
    "STRUCTURE",
    "UNPROVED",
    "attraction",
    "casimir",
    "conserved",
    "equilibrium",
    "input_limits",
    "limited_by",
    "only_stable",
    "ranges",
    "region",
    "slope",
]


STRUCTURE = "J = −Jᵀ, R = Rᵀ ⪰ 0, Jc = −Jcᵀ, Rc = Rcᵀ ⪰ 0 hold exactly for all states"


DAMPING = "the symmetric part of the damping is ≻ 0, in exact arithmetic on the stored numbers"


DECREASE = (
    "V never increases along the continuous-time, unsaturated loop, wherever the model is "
    "defined and for every damping with a symmetric part ≻ 0"
)


GLOBAL = "z̄ is globally asymptotically stable: every solution converges to it"


#: What follows for solutions from a region.
_FOLLOWS: dict[Follows, str] = {
    "converges": "; every solution from Ω converges to z̄",
    "invariant": "; Ω is invariant, and z̄ locally asymptotically stable",
    "stable": " and is invariant; z̄ is stable",
}


#: What stops a flood of cells at one of them.
_AT_A_CELL: dict[Kind, str] = {
    "border": "the domain",
    "cells": "the width of the cells",
    "critical": "a possible critical point",
}


#: How a claim begins that is made beside others, but not held.
UNPROVED = {
    "region": "no region",
    "input_limits": "no neighbourhood of z̄ is proved to keep u within ",
    "global": "no global claim: ",
}


#: What limits a region where nothing in its surroundings does.
_METHODS: dict[Method, str] = {
    "grid": "the resolution of the grid",
    "ellipsoid": "the bounds of the curvature of V",
    "chart": "what is proved of motions along the Casimirs",
}


def equilibrium(radius: float, mu: float, bound: float) -> str:
    """Of the ball around z*, ∇²V ⪰ μI on it and the distance of z̄, all in natural units."""
    return (
        f"in natural units V has exactly one critical point z̄ within {radius:.17g} of z*, ∇²V ⪰ "
        f"{_down(mu, 3)} I there, and ‖z̄ − z*‖ ≤ {_up(bound, 3)}"
    )


def casimir(functions: Sequence[str]) -> str:
    """Of closed forms, as design.json writes them."""
    return f"∇Cᵀ(Jcl − Rcl) = 0 holds exactly for C built from {', '.join(functions)}"


def slope(delta: float | None) -> str:
    """Of Φ₁; None for the sum."""
    if delta is None:
        return "Φ = H + Hc + C, so Φ₁ = 1"
    return f"Φ₁ ≥ {_down(delta, 6)} everywhere, by construction of the neural Φ"


def attraction(rate: float) -> str:
    """Of a proved rate of decay of the linearisation."""
    below = f"-{_down(rate, 3)}" if rate > 0 else "0"
    return (
        "z̄ is locally asymptotically stable: every eigenvalue of the linearisation has a real "
        f"part below {below}, by a Lyapunov inequality"
    )


def conserved(function: str) -> str:
    """Of a Casimir that damping cannot move."""
    return f"z̄ is stable, but cannot attract: the damped loop conserves {function}"


def only_stable(witness: str) -> str:
    """Of a stable z̄, with what the verdict in design.json says about the target."""
    return f"z̄ is stable; by the verdict in design.json no design can make it attract: {witness}"


def region(level: float, share: float, limit: str, follows: Follows) -> str:
    """Of the component of {V ≤ c}, and what follows for solutions from it."""
    return (
        f"the component Ω of {{V ≤ {_down(level, 6)}}} around z̄ lies in the domain (at least "
        f"{_down(100 * share, 2)} % of it, momenta at rest; limited by {limit}){_FOLLOWS[follows]}"
    )


def limited_by(
    limit: LimitedBy, states: Sequence[str], region: RegionClaim | None, units: Units
) -> str:
    """What limits a region, or leaves none."""
    if limit.kind == "momentum":
        return f"the domain, in {states[limit.at[0]]}"
    if region is None or limit.kind == "undefined":
        return "the loop, which may have a pole in it"
    if limit.kind not in _AT_A_CELL:
        return _METHODS[region.method]
    place = zip(region.active, units.place(region.active, region.place(limit)), strict=True)
    near = ", ".join(f"{states[i]} = {v:.3g}" for i, v in place)
    return f"{_AT_A_CELL[limit.kind]}, near {near}"


def input_limits(limits: Sequence[Sequence[float]], level_u: float, level: float) -> str:
    """Of the level below which u stays within the model's limits."""
    where = "all of Ω" if level_u == level else f"{{V ≤ {_down(level_u, 6)}}} in Ω"
    return (
        f"u stays within {ranges(limits)} on {where}, which is invariant: saturation never acts "
        "there"
    )


def ranges(limits: Sequence[Sequence[float]]) -> str:
    """The limits of the inputs."""
    return ", ".join(f"[{float(lo):.12g}, {float(hi):.12g}]" for lo, hi in limits)


def _down(value: float, digits: int) -> str:
    return _shown(value, digits, ROUND_FLOOR)


def _up(value: float, digits: int) -> str:
    return _shown(value, digits, ROUND_CEILING)


def _shown(value: float, digits: int, rounding: str) -> str:
    """A number rounded to one side, to significant digits."""
    if value == 0 or not math.isfinite(value):
        return f"{value:g}"
    exact = Decimal(value)
    last = Decimal(1).scaleb(exact.adjusted() - digits + 1)
    return f"{float(exact.quantize(last, rounding=rounding)):.{max(digits, 6)}g}"
