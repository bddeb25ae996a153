"""What is claimed of a family, as data: boxes of parameters ϑ, and where V_ϑ has its minimum."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from decimal import ROUND_CEILING, ROUND_FLOOR, Context, Decimal
from typing import Any

from necc_casadi.certificate.claims.fields import Entries
from necc_casadi.certificate.claims.regions import Side

__all__ = [
    "FAMILY_FILE",
    "FamilyBox",
    "FamilyClaim",
    "off_target",
    "outward",
    "over_ranges",
    "proved_share",
    "statement",
    "taken",
    "within",
]


FAMILY_FILE = "family.json"


@dataclass(frozen=True)
class FamilyBox:
    """For every ϑ of a box: V_ϑ has one critical point in `around`, and it lies in `minimum`."""

    theta: tuple[Side, ...]  # in the units of the model
    around: tuple[Side, ...]  # (N,) in natural units
    minimum: tuple[Side, ...]  # (N,)


@dataclass(frozen=True)
class FamilyClaim(Entries):
    """All of them; together the boxes, with those that are left out, cover the ranges."""

    family: str  # SHA-256 of family.json
    boxes: tuple[FamilyBox, ...]
    left: tuple[tuple[Side, ...], ...]  # of ϑ, of which no minimum is claimed
    error: Mapping[str, Side]  # of each plant state against its set-point, units of the model


def statement(
    ranges: Mapping[str, Side],
    claim: FamilyClaim,
    units: Mapping[str, float],
    measured: bool,
) -> str:
    """Of the whole family; `units` are natural ones of states, `measured`: y is no model's."""
    rests = within(claim.error, units)
    return (
        f"for every {over_ranges(ranges)}: V never increases along the continuous-time, "
        f"unsaturated loop{taken(measured)}, and{_but_for(list(ranges), claim)} has a strict "
        f"minimum{rests}, a stable equilibrium"
    )


def _but_for(names: Sequence[str], claim: FamilyClaim) -> str:
    """Boxes of parameters that are left out, in words."""
    if not claim.left:
        return ""
    shown = "; ".join(
        ", ".join(f"{n} in [{_outward(*side)}]" for n, side in zip(names, box, strict=True))
        for box in claim.left[:_SHOWN]
    )
    more = f"; and {len(claim.left) - _SHOWN} more boxes" if len(claim.left) > _SHOWN else ""
    return f", except for {shown}{more},"


def proved_share(data: Mapping[str, Any]) -> float:
    """How much of the ranges the boxes of a claim's `data` are, by volume."""
    proved, left = (
        sum(math.prod(hi - lo or 1.0 for lo, hi in box) for box in boxes)
        for boxes in ((box["theta"] for box in data["boxes"]), data["left"])
    )
    return proved / (proved + left)


def over_ranges(ranges: Mapping[str, Side]) -> str:
    """What a family is claimed for."""
    return ", ".join(f"{name} in [{_inward(*side)}]" for name, side in ranges.items())


def taken(measured: bool) -> str:
    """What the controller has to be fed, where parameters are unknown."""
    return ", with y measured and not computed from the model" if measured else ""


def within(error: Mapping[str, Side], units: Mapping[str, float]) -> str:
    """Where the minimum is, against the set-point."""
    moving = off_target(error, units)
    if not moving:
        return ", the set-point itself but for rounding"
    sides = ((name, *outward(error[name])) for name in moving)
    shown = ", ".join(f"{name} [{lo}, {hi}]" for name, lo, hi in sides)
    return f", whose error against the set-point is within {shown}"


def off_target(error: Mapping[str, Side], units: Mapping[str, float]) -> list[str]:
    """The states whose error is more than that of the arithmetic."""
    return [name for name, (lo, hi) in error.items() if max(-lo, hi) > _ROUNDING * units[name]]


def _inward(lo: float, hi: float) -> str:
    """Both ends in six digits, rounded into the range: no more is proved."""
    least = Context(prec=6, rounding=ROUND_CEILING).create_decimal(f"{lo:.15g}")
    most = Context(prec=6, rounding=ROUND_FLOOR).create_decimal(f"{hi:.15g}")
    if least > most:  # narrower than the digits
        return f"{lo:.15g}, {hi:.15g}"
    return f"{float(least):.6g}, {float(most):.6g}"


def _outward(lo: float, hi: float) -> str:
    """Both ends in six digits, rounded away from each other."""
    least = Context(prec=6, rounding=ROUND_FLOOR).create_decimal(f"{lo:.15g}")
    most = Context(prec=6, rounding=ROUND_CEILING).create_decimal(f"{hi:.15g}")
    return f"{float(least):.6g}, {float(most):.6g}"


def outward(side: Side) -> tuple[str, str]:
    """Both ends in four digits, rounded to the safe side."""
    lo, hi = (Decimal(v) for v in side)
    return (
        f"{float(Context(prec=4, rounding=ROUND_FLOOR).plus(lo)):.4g}",
        f"{float(Context(prec=4, rounding=ROUND_CEILING).plus(hi)):.4g}",
    )


#: Boxes that are left out and told.
_SHOWN = 3


#: Errors below this, in natural units, are those of the arithmetic.
_ROUNDING = 2.0**-30
