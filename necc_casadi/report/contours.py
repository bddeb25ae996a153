"""Contours of V − V(z̄): levels that tell, what a pole leaves of V, numbers where there is room."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes

from necc_casadi.arrays import Vector
from necc_casadi.report.ticks import power_of, rounded

__all__ = ["contour_levels", "number_contours", "without_poles"]


_INK = "#1c2733"


#: Multiples of the median of |V − V(z̄)| beyond which a pole of the model is at work.
_POLE = 50.0


#: Numbers on contours at most; how far from the border, from one another and from the next
#: contours, as shares of a side; points of a contour that are looked at.
_MOST, _INSIDE, _BETWEEN, _BESIDE, _POINTS = 5, 0.08, 0.16, 0.035, 60


def contour_levels(values: Vector) -> Vector:
    """Levels that are dense near the minimum; V may be undefined in places."""
    defined = without_poles(values)
    defined = defined[np.isfinite(defined)]
    top = float(np.quantile(defined, 0.98)) if defined.size else 0.0
    floor = float(np.min(defined, initial=0.0))
    height = top - floor if top > floor else 1.0  # where V is flat nothing is drawn
    return floor + height * np.linspace(0.03, 1.0, 13) ** 2


def without_poles(values: Vector) -> Vector:
    """V − V(z̄) with nan where a pole takes it far beyond what it is elsewhere."""
    finite = np.isfinite(values)
    usual = float(np.median(np.abs(values[finite]))) if finite.any() else 0.0
    shown = finite & (np.abs(values) <= _POLE * usual)
    return np.where(shown, values, np.nan)


def number_contours(axis: Axes, lines: Any, marks: Vector) -> int:
    """Write levels on some contours, within the axes and beside one another; their power of ten.

    Parameters
    ----------
    axis
        Where `lines`, a contour set, are drawn, with its limits.
    lines
        The contours.
    marks
        Places (k, 2) that stay free.
    """
    power = power_of(float(np.abs(lines.levels).max()))
    lo, hi = np.transpose([axis.get_xlim(), axis.get_ylim()])
    taken = list((marks - lo) / (hi - lo))
    places: list[Vector] = []
    paths = [
        (np.concatenate([*curves, np.empty((0, 2))]) - lo) / (hi - lo) for curves in lines.allsegs
    ]
    for k in range(len(paths) - 1, -1, -1):
        at = paths[k][:: 1 + len(paths[k]) // _POINTS]
        if not len(at) or len(places) == _MOST:
            continue
        beside = np.concatenate([*paths[max(0, k - 1) : k], *paths[k + 1 : k + 2]])
        free = (np.minimum(at, 1 - at).min(axis=1) > _INSIDE) & (_nearest(at, beside) > _BESIDE)
        room = np.where(free, _nearest(at, np.array(taken)), 0.0)
        best = int(np.argmax(room))
        if room[best] > _BETWEEN:
            taken.append(at[best])
            places.append(lo + at[best] * (hi - lo))
    if places:
        texts = axis.clabel(
            lines,
            manual=places,
            fontsize=7,
            colors=_INK,
            fmt=lambda v: rounded(v / 10.0**power, 2),
        )
        for text in texts:
            text.set_bbox({"facecolor": "white", "edgecolor": "none", "pad": 0.5})
    return power


def _nearest(points: Vector, others: Vector) -> Vector:
    """Distance of each of the points (k, 2) from the nearest of the others."""
    if not len(others):
        return np.full(len(points), np.inf)
    return np.asarray(np.linalg.norm(points[:, None] - others[None], axis=2).min(axis=1), float)
