"""How long a panel over time is: as long as something happens in it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from necc_casadi.arrays import Vector

__all__ = ["until_rest"]


#: At rest within this share of the farthest; room after that; and how much sooner than the other
#: panels one has to be at rest to have a time of its own.
_REST, _ROOM, _SOONER = 0.02, 1.25, 2.0


def until_rest(curves: Sequence[tuple[Vector, Vector]], common: float, least: float = 0.0) -> float:
    """The end of a panel's time axis: `common`, or sooner where all its curves rest long before.

    Parameters
    ----------
    curves
        Times (N,) and values (N,) each.
    common
        What the other panels show.
    least
        A curve that moves less does not.
    """
    away = [np.abs(values - values[-1]) for _, values in curves]
    farthest = max((float(distance.max()) for distance in away), default=0.0)
    if not np.isfinite(farthest):
        return common
    ends = [0.0]
    for (t, _), distance in zip(curves, away, strict=True):
        moving = np.flatnonzero(distance > max(_REST * farthest, least))
        ends += [float(t[moving[-1]])] if moving.size else []
    own = _ROOM * max(ends)
    return own if 0.0 < own < common / _SOONER else common
