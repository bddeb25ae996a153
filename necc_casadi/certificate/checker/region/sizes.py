"""Sizes of a region: nothing is claimed to be larger than what is proved again."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from flint import arb

from necc_casadi.certificate.checker.model import StoredDesign

__all__ = ["ball_volume", "sides_of", "sizes_hold"]


def sizes_hold(proved: Mapping[str, arb], claimed: Mapping[str, float], share: float) -> bool:
    """Whether every size that is claimed is known and at most the proved bound."""
    return share == claimed["domain_share"] and all(
        name in proved and bool(proved[name] >= size) for name, size in claimed.items()
    )


def sides_of(model: StoredDesign, states: Sequence[int]) -> arb:
    """Product of the sides of the domain over some states."""
    bounds, result = model.bounds, arb(1)
    for i in states:
        result = result * (bounds[i][1] - bounds[i][0])
    return result


def ball_volume(d: int) -> arb:
    """Volume of the unit ball."""
    return arb.pi() ** (arb(d) / 2) / (arb(d) / 2 + 1).gamma()
