"""Axes of a state or an input: names, units, limits, and what is no motion."""

from __future__ import annotations

from matplotlib.axes import Axes

from necc_casadi.designs.design import Design
from necc_casadi.report.style import UNSETTLED
from necc_casadi.report.ticks import (
    no_finer,
)

__all__ = ["ROUNDING", "STILL", "coarse_enough", "draw_limits", "named_input", "named_state"]


#: A state or input that moves less than this share of its size does not: what is left is the
#: integrator's error. Then so much of its size is shown.
STILL, _STILL_SHOWN = 1e-6, 0.1


#: V − V(z̄) below this, in natural units, is rounding.
ROUNDING = 1e-14


def named_state(design: Design, index: int) -> tuple[str, str]:
    """Name and unit of a state."""
    name = design.loop.states[index]
    return name, design.loop.plant.units.get(name, "")


def coarse_enough(axis: Axes, middle: float, size: float) -> float:
    """Show a part of a quantity's size where it does not move; what is no motion."""
    no_finer(axis, STILL * size, middle, _STILL_SHOWN * size)
    return STILL * size


def named_input(design: Design, index: int) -> tuple[str, str]:
    """Name and unit of an input."""
    name = design.loop.plant.input_names[index]
    return name, design.loop.plant.units.get(name, "")


def draw_limits(axis: Axes, design: Design, index: int) -> None:
    """The limits of an input, where they are near what is shown."""
    limits = design.loop.plant.u_limits
    if limits is None:
        return
    low, high = axis.get_ylim()
    for limit in limits[index]:
        if low - (high - low) <= limit <= high + (high - low):
            axis.axhline(limit, ls=":", lw=1, color=UNSETTLED)
