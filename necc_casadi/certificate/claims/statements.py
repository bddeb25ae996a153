"""The words of a certificate: each held claim as a function of the data that is proved.

Maker and checker both word a claim with these, each from what it proved itself; a statement in
certificate.json that reads otherwise is not what was proved. Numbers are shown rounded to the
safe side.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from decimal import ROUND_CEILING, ROUND_FLOOR, Decimal

from necc_casadi.certificate.claims.regions import Follows, Obstacle, ObstacleKind

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


DAMPING = "D ≻ 0 and Dc ≻ 0, in exact arithmetic on the stored numbers"


DECREASE = (
    "V never increases along the continuous-time, unsaturated loop, wherever the model is "
    "defined and for every D, Dc ≻ 0"
)


_BOUNDED = (
    "V is radially unbounded and z̄ its only critical point: every solution is bounded, and V never "
    "rises along it"
)


#: What follows for solutions from anywhere.
GLOBAL: dict[Follows, str] = {
    "converges": "z̄ is globally asymptotically stable: every solution converges to it",
    "invariant": f"{_BOUNDED}; z̄ is locally asymptotically stable",
    "stable": f"{_BOUNDED}; z̄ is stable",
}


#: What follows for solutions from a region.
_FOLLOWS: dict[Follows, str] = {
    "converges": "; every solution from Ω converges to z̄",
    "invariant": "; Ω is invariant, and z̄ locally asymptotically stable",
    "stable": "; Ω is invariant, and z̄ stable",
}


#: What a region ends at.
_OBSTACLES: dict[ObstacleKind, str] = {
    "critical_point": "another critical point of V",
    "singularity": "a pole of the model",
    "domain": "a bound that the model names",
    "input_limits": "the input limits",
    "arithmetic": "the arithmetic of the proof, below what was met",
}


#: How a claim begins that is made beside others, but not held.
UNPROVED = {
    "region": "no region",
    "input_limits": "no neighbourhood of z̄ is proved to keep u within ",
    "global": "no global claim: ",
}


#: Coordinates of a place that are told at most.
_TOLD = 6


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


def region(height: float, obstacle: Obstacle, follows: Follows) -> str:
    """Of the component of {V ≤ V(z̄) + h}, and what follows for solutions from it."""
    return (
        f"the component Ω of {{V − V(z̄) ≤ {_down(height, 6)}}} around z̄ is compact, and z̄ the only "
        f"critical point of V in it; limited by {limited_by(obstacle)}{_FOLLOWS[follows]}"
    )


def limited_by(obstacle: Obstacle) -> str:
    """What a region stays just below."""
    told = {name: value for name, value in obstacle.at.items() if value}
    parts = [f"{name} = {value:.4g}" for name, value in list(told.items())[:_TOLD]]
    place = f" at {', '.join(parts)}{', …' if len(told) > _TOLD else ''}" if parts else ""
    return (
        f"{_OBSTACLES[obstacle.kind]}{place}, {obstacle.level_above_minimum:.4g} above the minimum"
    )


def input_limits(limits: Sequence[Sequence[float]], height: float, whole: bool) -> str:
    """Of the height above V(z̄) up to which u stays within its limits, on the whole Ω or not."""
    where = "all of Ω" if whole else f"{{V − V(z̄) ≤ {_down(height, 6)}}} in Ω"
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
