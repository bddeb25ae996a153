"""What is claimed of a family for all states, as data: every V_ϑ convex, and where it rests."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from necc_casadi.certificate.claims.family import over_ranges, taken, within
from necc_casadi.certificate.claims.fields import Entries
from necc_casadi.certificate.claims.regions import Bends, Rows, Side

__all__ = ["EverywhereClaim", "Gathers", "everywhere"]


#: Where all solutions of a member go: to its minimum, or they stay bounded.
Gathers = Literal["converges", "stable"]


@dataclass(frozen=True)
class EverywhereClaim(Entries):
    """∂²V_ϑ/∂y² ⪰ F ≻ 0 for every y and ϑ, the other states being momenta at rest."""

    family: str  # SHA-256 of family.json
    active: tuple[int, ...]  # y, indices in z
    floor: Rows  # F
    bends: Bends  # what F rests on
    error: Mapping[str, float]  # of each plant state against its set-point, at most, model's units
    follows: Gathers


def everywhere(
    ranges: Mapping[str, Side],
    error: Mapping[str, float],
    units: Mapping[str, float],
    measured: bool,
    follows: Gathers,
) -> str:
    """Of the whole family; `units` are natural ones of states, `measured`: y is no model's."""
    rests = within({name: (-most, most) for name, most in error.items()}, units)
    drawn = {
        "converges": "it is globally asymptotically stable: every solution converges to it",
        "stable": "it is stable, and every solution is bounded",
    }[follows]
    return (
        f"for every {over_ranges(ranges)}: V never increases along the continuous-time, "
        f"unsaturated loop{taken(measured)}, is radially unbounded and has one critical point"
        f"{rests}; {drawn}"
    )
