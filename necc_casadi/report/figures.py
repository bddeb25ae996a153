"""Figures: V around the target, the proved region, closed-loop responses, designs against a."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from necc_casadi.arrays import Vector
from necc_casadi.certificate.claims.regions import Side
from necc_casadi.designs.design import Design
from necc_casadi.model.sizes import input_names
from necc_casadi.report.slices import Window, domain_window, shadow, slice_boundary, slice_values
from necc_casadi.report.style import Drawing
from necc_casadi.report.sweep_point import SweepPoint
from necc_casadi.report.ticks import (
    engineering,
    finished,
    logarithmic,
    panels,
    power_of,
    rounded,
    scaled_label,
)
from necc_casadi.simulation.responses import Trajectory

__all__ = [
    "draw_contours",
    "draw_distances",
    "draw_limits",
    "draw_over_time",
    "draw_region",
    "draw_shares",
    "lyapunov_figure",
    "named_input",
    "named_state",
    "region_boundary",
    "region_figure",
    "responses_figure",
    "shown_over_time",
    "sweep_figure",
]


_INK, _TARGET, _MINIMUM, _UNSETTLED = "#1f4e79", "#d9730d", "#2e7d32", "#a8324a"


_MOST_PANELS = 10


#: Least and greatest value of each state on Ω; None: every value.
Reach = Mapping[str, Side | None]

#: Multiples of the median of |V − V(z̄)| beyond which a pole of the model is at work.
_POLE = 50.0


#: Room around the reach of Ω, as a share of it.
_BESIDE = 0.15


#: V − V(z̄) below this, in natural units, is rounding.
_ROUNDING = 1e-14


#: Where no proved share exceeds this, shares are drawn on a logarithmic axis.
_SMALL_SHARE = 0.02


def named_state(design: Design, index: int) -> tuple[str, str]:
    """Name and unit of a state."""
    name = design.loop.states[index]
    return name, design.loop.plant.units.get(name, "")


def lyapunov_figure(design: Design) -> Figure:
    """V over two coordinates through ξ*, as a surface and as contours, with both minima marked."""
    window = domain_window(design)
    i, j = window.pair
    A, B, values = slice_values(design, window)

    figure = Drawing(figsize=(10, 4.4))
    figure.suptitle(f"{design.loop.plant.name}: Lyapunov function at ξ = ξ*")
    surface = figure.add_subplot(1, 2, 1, projection="3d")
    surface.set_position((0.0, 0.03, 0.46, 0.9))
    shown = _without_poles(values)
    surface.plot_surface(
        A, B, shown, cmap="viridis", linewidth=0, alpha=0.9, rcount=40, ccount=40, rasterized=True
    )
    finished(
        surface,
        [("x", *named_state(design, i)), ("y", *named_state(design, j)), ("z", "V − V(z̄)", "")],
    )
    surface.yaxis.labelpad = surface.zaxis.labelpad = 8
    surface.view_init(elev=28, azim=-60)

    flat = figure.add_axes((0.56, 0.21, 0.42, 0.65))
    draw_contours(flat, design)
    figure.legend(*flat.get_legend_handles_labels(), loc="lower right", ncols=2, fontsize=8)
    return figure


def draw_contours(axis: Axes, design: Design) -> None:
    """Contours of V − V(z̄) over two coordinates through ξ*, with both minima."""
    window = domain_window(design)
    A, B, values = slice_values(design, window)
    shown = _without_poles(values)
    levels = _levels(values)
    lines = axis.contour(A, B, shown, levels=levels, cmap="viridis")
    power = power_of(float(levels[-1]))
    if np.isfinite(shown).all():  # beside a pole, numbers would stand on one another
        closed = [  # others end at the border, where numbers would be cut off
            level
            for level, curves in zip(levels.tolist(), lines.allsegs, strict=True)
            if curves and all(len(c) > 2 and np.array_equal(c[0], c[-1]) for c in curves)
        ]
        labels = axis.clabel(
            lines,
            levels=closed[-1:1:-2][::-1],
            fontsize=7,
            fmt=lambda v: rounded(v / 10.0**power, 2),
        )
        for label in labels:
            label.set_bbox({"facecolor": "white", "edgecolor": "none", "pad": 0.5})
    axis.set_title(scaled_label("contours of V − V(z̄)", "", power), fontsize=10)
    _mark_minima(design, axis, *window.pair)


def _mark_minima(design: Design, axis: Axes, i: int, j: int) -> None:
    """Target and minimum of V, axis labels."""
    star, bar = design.z_star, design.z_bar
    axis.plot(star[i], star[j], "o", ms=11, mfc="none", mew=2, color=_TARGET, label="target z*")
    axis.plot(bar[i], bar[j], "+", ms=11, mew=2, color=_MINIMUM, label="minimum z̄ of V")
    finished(axis, [("x", *named_state(design, i)), ("y", *named_state(design, j))])


def region_boundary(
    design: Design, level: float, reach: Reach | None = None, count: int = 12
) -> list[Vector]:
    """Plant states on the boundary of {V ≤ level} in the plane that the figures show, ξ = ξ*.

    `reach` is how far Ω goes; without it the domain is looked at.
    """
    window = _window(design, level, _telling_sides(design, reach))[0]
    path = slice_boundary(design, level, window)
    if path is None:
        return []
    states = np.repeat(design.z_star[None, :], count, axis=0)
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*(np.diff(path, axis=0) / np.ptp(path, 0)).T))])
    at = np.linspace(0, way[-1], count, endpoint=False)
    states[:, list(window.pair)] = np.stack([np.interp(at, way, side) for side in path.T], -1)
    return list(states[:, : design.loop.plant.n])


@lru_cache(maxsize=4)
def _window(design: Design, level: float, sides: tuple[Side, Side] | None) -> tuple[Window, Vector]:
    """A window around Ω, and Ω's shadow in it."""
    window = domain_window(design)
    if sides is None:
        edge = shadow(design, level, window)
        return window.around(edge), edge
    lo, hi = np.array(sides).T
    edge = shadow(design, level, Window(window.pair, lo, hi))  # Ω is proved to stay in these
    room = _BESIDE * (hi - lo)
    return Window(window.pair, lo - room, hi + room).around(edge), edge


def _telling_sides(design: Design, reach: Reach | None) -> tuple[Side, Side] | None:
    """The reach of the two states that are shown; None where one may take every value."""
    if reach is None:
        return None
    i, j = domain_window(design).pair
    first, second = reach[design.loop.states[i]], reach[design.loop.states[j]]
    return None if first is None or second is None else (first, second)


def region_figure(
    design: Design,
    level: float,
    responses: Sequence[Trajectory],
    reach: Reach | None = None,
) -> Figure:
    """The proved region over V's contours: its slice at z*, its shadow, responses from the slice.

    Responses leave the slice because ξ moves, but not the shadow.
    """
    figure = panels(1, 1, (5.45, 4.1), legend=0.85)
    axis = figure.add_subplot()
    draw_region(axis, design, level, responses, reach)
    figure.legend(loc="lower center", ncols=2, fontsize=8)
    title = f"{design.loop.plant.name}: proved region Ω"
    axis.set_title(f"{title}\ndomain: {_extent(design)}", fontsize=9)  # Ω may be a small part
    return figure


def draw_region(
    axis: Axes,
    design: Design,
    level: float,
    responses: Sequence[Trajectory] = (),
    reach: Reach | None = None,
) -> None:
    """The proved region over V's contours on any axes; see :func:`region_figure`."""
    window, edge = _window(design, level, _telling_sides(design, reach))
    i, j = window.pair
    A, B, values = slice_values(design, window)
    shown, levels = _without_poles(values), _levels(values)
    axis.contour(A, B, shown, levels=levels, cmap="viridis", linewidths=0.7, alpha=0.6)
    axis.fill(*edge.T, color=_MINIMUM, alpha=0.10, label="Ω seen over all other states (computed)")
    axis.plot(*np.vstack([edge, edge[:1]]).T, "--", color=_MINIMUM, lw=1)
    curve = slice_boundary(design, level, window)
    if curve is not None:
        axis.fill(*curve.T, color=_MINIMUM, alpha=0.15)
        top = level - design.V(design.z_bar)
        proved = f"proved: V − V(z̄) ≤ {engineering(top)}, other states at z*"
        axis.plot(*curve.T, color=_MINIMUM, lw=2, label=proved)
    for index, response in enumerate(responses):
        label = f"simulated from that boundary{_leaving(responses)}" if index == 0 else None
        axis.plot(*response.z[:, [i, j]].T, lw=0.8, color=_INK, alpha=0.8, label=label)
        axis.plot(*response.z[0, [i, j]], ".", color=_INK)
    _mark_minima(design, axis, i, j)
    axis.set_xlim(window.lo[0], window.hi[0])
    axis.set_ylim(window.lo[1], window.hi[1])
    finished(axis, [("x", *named_state(design, i)), ("y", *named_state(design, j))])


def _leaving(responses: Sequence[Trajectory]) -> str:
    """Why responses leave the slice, or Ω itself."""
    left = sum(bool(np.any(r.V[0] + _ROUNDING * abs(r.V[0]) < r.V)) for r in responses)
    if left and any(r.saturated for r in responses):
        return f":\nu at a limit, V rises in {left}; Ω is proved for u without limits"
    return ":\nthey leave the slice as ξ moves, never Ω"


def _extent(design: Design) -> str:
    """The domain in words, for the two states that are shown."""
    whole, units = domain_window(design), design.loop.plant.units
    texts = []
    for k, lo, hi in zip(whole.pair, whole.lo, whole.hi, strict=True):
        name = design.loop.states[k]
        unit = units.get(name, "")
        texts.append(f"{name} from {engineering(lo, unit)} to {engineering(hi, unit)}")
    return ", ".join(texts)


def _levels(values: Vector) -> Vector:
    """Contour levels that are dense near the minimum; V may be undefined in places."""
    defined = _without_poles(values)
    defined = defined[np.isfinite(defined)]
    top = float(np.quantile(defined, 0.98)) if defined.size else 0.0
    floor = float(np.min(defined, initial=0.0))
    height = top - floor if top > floor else 1.0  # where V is flat nothing is drawn
    return floor + height * np.linspace(0.03, 1.0, 13) ** 2


def _without_poles(values: Vector) -> Vector:
    """V − V(z̄) with nan where a pole takes it far beyond what it is elsewhere."""
    finite = np.isfinite(values)
    usual = float(np.median(np.abs(values[finite]))) if finite.any() else 0.0
    shown = finite & (np.abs(values) <= _POLE * usual)
    return np.where(shown, values, np.nan)


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
    axes = figure.subplots(rows, columns, squeeze=False, sharex=True).ravel()
    for name, axis in zip(names, axes, strict=False):
        draw_over_time(axis, design, trajectories, name)
    if unsettled:
        outcomes = {response.converged for response in trajectories}
        lines = [
            Line2D([], [], color=color, label=label)
            for settled, color, label in (
                (True, _INK, "settles within 2 %"),
                (False, _UNSETTLED, "does not settle in this time"),
            )
            if settled in outcomes
        ]
        figure.legend(handles=lines, loc="lower center", ncols=2, fontsize=8)
    for axis in axes[count:]:
        axis.remove()
    for k in range(max(0, count - columns), count):
        axes[k].tick_params(labelbottom=True)
        finished(axes[k], [("x", "time", "s")])
    return figure


def shown_over_time(design: Design, trajectories: Sequence[Trajectory]) -> list[str]:
    """What a figure of responses has panels for: states, inputs and V, by name."""
    states = [design.loop.states[k] for k in _telling_states(design, trajectories)]
    return [*states, *input_names(design.loop.plant.m)[:_MOST_PANELS], "V"]


def draw_over_time(
    axis: Axes, design: Design, trajectories: Sequence[Trajectory], name: str
) -> None:
    """A state, an input, or V − V(z̄) as ``V``, along responses on any axes."""
    states, inputs = design.loop.states, input_names(design.loop.plant.m)
    n = design.loop.plant.n
    for response in trajectories:
        color = _INK if response.converged else _UNSETTLED
        values = _over_time(design, response, name)
        axis.plot(response.t, values, lw=0.9, color=color, alpha=0.7)
    if name in states:
        k = states.index(name)
        axis.axhline(design.z_star[k], ls="--", lw=1, color=_TARGET)
        finished(axis, [("y", *named_state(design, k))])
    elif name in inputs:
        k = inputs.index(name)
        steady = design.lyapunov.control_law(design.z_bar[:n], design.z_bar[n:])[0]
        axis.axhline(steady[k], ls="--", lw=1, color=_TARGET)
        draw_limits(axis, design, k)
        finished(axis, [("y", *named_input(design, k))])
    else:
        _decay_axis(axis)
    axis.grid(alpha=0.25)


def _telling_states(design: Design, trajectories: Sequence[Trajectory]) -> list[int]:
    """All states where they fit, else those that travel farthest, in order."""
    total = len(design.loop.states)
    if total <= _MOST_PANELS or not trajectories:
        return list(range(min(total, _MOST_PANELS)))
    travel = np.max([np.ptp(r.z / design.sizes.state, axis=0) for r in trajectories], axis=0)
    return sorted(int(k) for k in np.argsort(-travel)[:_MOST_PANELS])


def _over_time(design: Design, response: Trajectory, name: str) -> Vector:
    states, inputs = design.loop.states, input_names(design.loop.plant.m)
    if name in states:
        return response.z[:, states.index(name)]
    if name in inputs:
        return response.u[:, inputs.index(name)]
    return np.maximum(response.V - response.V_bar, _ROUNDING * design.sizes.energy)


def named_input(design: Design, index: int) -> tuple[str, str]:
    """Name and unit of an input."""
    name = input_names(design.loop.plant.m)[index]
    return name, design.loop.plant.units.get(name, "")


def draw_limits(axis: Axes, design: Design, index: int) -> None:
    """The limits of an input, where they are near what is shown."""
    limits = design.loop.plant.u_limits
    if limits is None:
        return
    low, high = axis.get_ylim()
    for limit in limits[index]:
        if low - (high - low) <= limit <= high + (high - low):
            axis.axhline(limit, ls=":", lw=1, color=_UNSETTLED)


def _decay_axis(axis: Axes) -> None:
    axis.set_yscale("log")
    logarithmic(axis, "y")
    axis.set_ylabel("V − V(z̄)")


def sweep_figure(design: Design, points: Sequence[SweepPoint]) -> Figure:
    """Against a: ‖z̄ − z*‖ with its two bounds; below, how much of the domain is proved."""
    figure = Drawing(figsize=(6.4, 7.0), layout="constrained")
    figure.suptitle(f"{design.loop.plant.name}: designs against a", fontsize=11)
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
    draw_distances(upper, design, points)
    draw_shares(lower, points)
    ceiling = design.verdict.a_max
    for axis in (upper, lower):
        axis.grid(alpha=0.25)
        if ceiling is not None and max(p.a for p in points) > ceiling:
            right = axis.get_xlim()[1]
            axis.axvspan(ceiling, right, color=_TARGET, alpha=0.08, lw=0, label="a above a_max")
            axis.set_xlim(right=right)
        axis.legend(fontsize=8)
    lower.set_xlabel("a, curvature asked of ∇²V(z*)")
    return figure


def draw_distances(axis: Axes, design: Design, points: Sequence[SweepPoint]) -> None:
    """Distance and bounds; what is smaller than one rounding of z* lies in a band of its own."""
    rounding = float(np.spacing(np.linalg.norm(design.z_star)))
    series = (
        ("paper's bound ε/(a − ε)", [p.bound_paper for p in points], "s--", _TARGET),
        ("proved bound g/μ", [p.bound_rigorous for p in points], "^-", _MINIMUM),
        ("distance ‖z̄ − z*‖", [p.distance for p in points], "o-", _INK),
    )
    for label, values, style, color in series:
        shown = [np.nan if v is None else max(v, rounding / 4) for v in values]
        axis.plot([p.a for p in points], shown, style, color=color, label=label, ms=5, lw=1.2)
    axis.set_yscale("log")
    if axis.get_ylim()[0] < rounding:
        axis.set_ylim(bottom=rounding / 16)
        axis.axhspan(rounding / 16, rounding, color="0.92", label="0 within one rounding of z*")
    axis.set_ylabel("distance from the target")


def draw_shares(axis: Axes, points: Sequence[SweepPoint]) -> None:
    """Proved beside simulated; a cross on the axis where no region is proved."""
    a = [p.a for p in points]
    series = (
        ("converges in simulation", [p.simulated_share for p in points], "o-", _INK),
        ("in the proved region", [p.domain_share for p in points], "^-", _MINIMUM),
    )
    for label, values, style, color in series:
        shown = [np.nan if v is None else 100 * v for v in values]
        if not np.isnan(shown).all():
            axis.plot(a, shown, style, color=color, label=label, ms=5, lw=1.2)
    proved = [p.domain_share for p in points if p.domain_share]
    if proved and max(proved) < _SMALL_SHARE:  # on a linear axis all of them would look like 0
        axis.set_yscale("log")
        axis.set_ylim(top=200)
    else:
        axis.set_ylim(0, 105)
    missing = [p.a for p in points if p.domain_share is None]
    if missing:
        at_bottom = axis.get_xaxis_transform()
        axis.plot(
            missing, [0.0] * len(missing), "x", color=_TARGET, ms=8, mew=2, transform=at_bottom,
            clip_on=False, label="no region proved",
        )  # fmt: skip
    axis.set_ylabel("share of the domain [%],\nmomenta at rest")
