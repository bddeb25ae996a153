"""Whether a region or a claim of the whole space has the form it must have, before any proof."""

from __future__ import annotations

import math

from necc_casadi.certificate.claims.regions import MOST_KEPT, GlobalClaim, Region

__all__ = ["check_region_shape", "check_split_shape"]

#: First cells a side, at most.
_MOST_PARTS = 128


def check_split_shape(claim: Region | GlobalClaim, count: int) -> None:
    """The states, the floor and the core of a loop with so many states.

    Raises
    ------
    ValueError
        When one of them is not of its form.
    """
    active, kept, floor = claim.active, claim.kept, claim.floor
    gone = len(active) - len(kept)
    numbers = [v for row in (*floor, *claim.core) for v in row]
    sound = (
        list(active) == sorted(set(active))
        and all(0 <= i < count for i in active)
        and list(kept) == sorted(set(kept))
        and all(0 <= i < len(active) for i in kept)
        and len(kept) <= MOST_KEPT
        and len(floor) == gone
        and all(len(row) == gone for row in floor)
        and all(floor[i][j] == floor[j][i] for i in range(gone) for j in range(i))
        and len(claim.core) == len(kept)
        and all(map(math.isfinite, numbers))
    )
    if not sound:
        raise ValueError("the states, the floor or the core of the region are of no use")


def check_region_shape(region: Region, count: int) -> None:
    """A region of a loop with so many states.

    Raises
    ------
    ValueError
        When one of its parts is not of its form.
    """
    check_split_shape(region, count)
    box = region.box
    sound = (
        len(box.lo) == len(box.side) == len(region.kept)
        and all(map(math.isfinite, (*box.lo, *box.side, region.level)))
        and all(v > 0 for v in box.side)
        and 0 < box.parts <= _MOST_PARTS
        and box.parts & (box.parts - 1) == 0
        and len(region.tube) in (0, len(region.floor))
        and (not region.tube or region.bends == (None, None))
        and all(-math.inf < lo < hi < math.inf for lo, hi in region.tube)
    )
    if not sound:
        raise ValueError("the box of the region's cells is none")
