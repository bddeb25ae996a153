"""Sizes of a region: nothing is claimed to be larger than what is proved again."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from flint import arb

from necc_casadi.certificate.checker.model import StoredDesign

__all__ = ["ball_volume", "sides_of", "sizes_hold"]


def sizes_hold(proved: Mapping[str, arb], data: Mapping[str, Any], share: float) -> bool:
    """Whether every number claimed has a name that is known and is at most the proved bound."""
    return share == data["domain_share"] and all(
        key in proved and bool(proved[key] >= float(value))
        for key, value in data.items()
        if key != "limit"
    )


def sides_of(model: StoredDesign, states: Sequence[int]) -> arb:
    """Product of the sides of the domain over some states."""
    bounds, result = model.bounds(), arb(1)
    for i in states:
        result = result * (bounds[i][1] - bounds[i][0])
    return result


def ball_volume(d: int) -> arb:
    """Volume of the unit ball."""
    return arb.pi() ** (arb(d) / 2) / (arb(d) / 2 + 1).gamma()
