"""What is claimed of regions of a family's members, as data, and in words."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from decimal import ROUND_FLOOR, Context, Decimal

from necc_casadi.certificate.claims.family import over_ranges, taken
from necc_casadi.certificate.claims.fields import Entries
from necc_casadi.certificate.claims.regions import CellBox, Side

__all__ = ["HeldBox", "MembersClaim", "members"]


@dataclass(frozen=True)
class HeldBox:
    """For every ϑ of a box: what starts with y in z* ± `half` and V ≤ V(z*) + `level` stays."""

    theta: tuple[Side, ...]  # in the units of the model
    half: tuple[float, ...]  # (d,) natural units
    core: float  # V(·, p = 0) is convex within this share of `half`
    level: float  # natural units


@dataclass(frozen=True)
class MembersClaim(Entries):
    """Boxes of ϑ with a region each, and what all of these have in common."""

    family: str  # SHA-256 of family.json
    active: tuple[int, ...]  # y, indices in z
    boxes: tuple[HeldBox, ...]
    left: tuple[tuple[Side, ...], ...]  # of ϑ, of which nothing is claimed
    grid: CellBox  # of y, natural units
    cells: str  # marked cells at rest lie in the region of every member; see `packed`
    share: float  # of the domain that they are, at most
    step: Mapping[str, float]  # set-point → how far it may move at once, units of the model


def members(ranges: Mapping[str, Side], claim: MembersClaim, energy: float, measured: bool) -> str:
    """Of all regions; `energy` is the natural unit, `measured`: y is no model's."""
    levels = [box.level * energy for box in claim.boxes]
    but = f", {len(claim.left)} boxes of them left out," if claim.left else ""
    text = (
        f"for every {over_ranges(ranges)}{but} every solution of the continuous-time, unsaturated "
        f"loop{taken(measured)} that starts in the box of its member with V at most its level, "
        f"{_down(min(levels))} or more, above its value at the set-point stays so and converges "
        f"to its place at rest; {_down(100 * claim.share)} % of the domain, from rest, are such "
        "starts for all of them, by the error against the set-point"
    )
    steps = {name: far for name, far in claim.step.items() if far > 0}
    if not steps:
        return text
    shown = ", ".join(f"{name} by {_down(far)}" for name, far in steps.items())
    return f"{text}; from rest the set-point may move at once, {shown}"


def _down(value: float) -> str:
    """Three digits, rounded to the safe side."""
    return f"{float(Context(prec=3, rounding=ROUND_FLOOR).plus(Decimal(value))):.3g}"
