"""Closed-loop responses over time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from necc_casadi.arrays import Vector
from necc_casadi.designs.design import Design
from necc_casadi.report.named_axes import (
    ROUNDING,
    STILL,
    coarse_enough,
    draw_limits,
    named_input,
    named_state,
)
from necc_casadi.report.style import INK, TARGET, UNSETTLED
from necc_casadi.report.ticks import (
    finished,
    logarithmic,
    panels,
)
from necc_casadi.report.time_axis import until_rest
from necc_casadi.simulation.responses import Trajectory

__all__ = ["draw_over_time", "responses_figure", "shown_over_time"]


_MOST_PANELS = 10


#: Room after the slowest response has settled, as a share of that time.
_AFTER = 0.25


def responses_figure(design: Design, trajectories: Sequence[Trajectory]) -> Figure:
    """Every state and input over time, targets dashed, and V along the responses."""
    names = shown_over_time(design, trajectories)
    count = len(names)
    unsettled = any(not response.converged for response in trajectories)
    columns = min((3, 4), key=lambda number: -count % number)  # the fewest gaps
    rows = -(-count // columns)
    figure = panels(rows, columns, (2.8, 1.75), legend=0.3 if unsettled else 0.0)
    total = len(design.loop.states)
    shown = sum(name in design.loop.states for name in names)
    left_out = f" ({shown} of {total} states)" if shown < total else ""
    figure.suptitle(f"{design.loop.plant.name}: closed-loop responses, targets dashed{left_out}")
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for name, axis in zip(names, axes, strict=False):
        draw_over_time(axis, design, trajectories, name)
        finished(axis, [("x", "time", "s")])
    if unsettled:
        outcomes = {response.converged for response in trajectories}
        lines = [
            Line2D([], [], color=color, label=label)
            for settled, color, label in (
                (True, INK, "settles within 2 %"),
                (False, UNSETTLED, "does not settle in this time"),
            )
            if settled in outcomes
        ]
        figure.legend(handles=lines, loc="lower center", ncols=2, fontsize=8)
    for axis in axes[count:]:
        axis.remove()
    return figure


def shown_over_time(design: Design, trajectories: Sequence[Trajectory]) -> list[str]:
    """What a figure of responses has panels for: states, inputs and V, by name."""
    states = [design.loop.states[k] for k in _telling_states(design, trajectories)]
    return [*states, *design.loop.plant.input_names[:_MOST_PANELS], "V"]


def draw_over_time(
    axis: Axes, design: Design, trajectories: Sequence[Trajectory], name: str
) -> None:
    """A state, an input, or V − V(z̄) as ``V``, along responses on any axes."""
    states, inputs = design.loop.states, design.loop.plant.input_names
    n = design.loop.plant.n
    curves = [(response.t, _over_time(design, response, name)) for response in trajectories]
    for response, (t, values) in zip(trajectories, curves, strict=True):
        color = INK if response.converged else UNSETTLED
        axis.plot(t, values, lw=0.9, color=color, alpha=0.7)
    common = _settled(trajectories)
    if name in states:
        k = states.index(name)
        axis.axhline(design.z_star[k], ls="--", lw=1, color=TARGET)
        least = coarse_enough(axis, design.z_star[k], design.sizes.state[k])
        finished(axis, [("y", *named_state(design, k))])
    elif name in inputs:
        k = inputs.index(name)
        steady = design.lyapunov.control_law(design.z_bar[:n], design.z_bar[n:])[0]
        axis.axhline(steady[k], ls="--", lw=1, color=TARGET)
        least = coarse_enough(axis, steady[k], design.sizes.input[k])
        draw_limits(axis, design, k)
        finished(axis, [("y", *named_input(design, k))])
    else:
        least = np.inf
        _decay_axis(axis, [values[t <= common] for t, values in curves])
    axis.set_xlim(0, until_rest(curves, common, least))
    axis.grid(alpha=0.25)


def _settled(trajectories: Sequence[Trajectory]) -> float:
    """When the slowest has settled, with some room; all that was simulated where one does not."""
    end = max((float(response.t[-1]) for response in trajectories), default=1.0)
    slowest = max((response.settling_time for response in trajectories), default=end)
    return min(end, (1 + _AFTER) * slowest) or end


def _telling_states(design: Design, trajectories: Sequence[Trajectory]) -> list[int]:
    """All states where they fit, else those that travel farthest, in order.

    A controller's state that never moves, as where damping alone holds the target, tells nothing.
    """
    total, n = len(design.loop.states), design.loop.plant.n
    if not trajectories:
        return list(range(min(total, _MOST_PANELS)))
    travel = np.max([np.ptp(r.z / design.sizes.state, axis=0) for r in trajectories], axis=0)
    telling = [k for k in np.argsort(-travel).tolist() if k < n or travel[k] > STILL]
    return sorted(telling[:_MOST_PANELS])


def _over_time(design: Design, response: Trajectory, name: str) -> Vector:
    states, inputs = design.loop.states, design.loop.plant.input_names
    if name in states:
        return response.z[:, states.index(name)]
    if name in inputs:
        return response.u[:, inputs.index(name)]
    return np.maximum(response.V - response.V_bar, ROUNDING * design.sizes.energy)


def _decay_axis(axis: Axes, shown: Sequence[Vector]) -> None:
    axis.set_yscale("log")
    if shown:
        axis.set_ylim(bottom=0.5 * min(float(values.min()) for values in shown))
    logarithmic(axis, "y")
    axis.set_ylabel("V − V(z̄)")
