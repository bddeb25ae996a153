"""Figures: V around the target, the proved region, closed-loop responses, designs against a."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.path import Path as Curve

from necc_casadi.arrays import Vector
from necc_casadi.certificate.claims.regions import Obstacle, Side
from necc_casadi.designs.design import Design
from necc_casadi.report.contours import contour_levels, number_contours, without_poles
from necc_casadi.report.slices import Window, domain_window, shadow, slice_boundary, slice_values
from necc_casadi.report.style import Drawing
from necc_casadi.report.sweep_point import SweepPoint
from necc_casadi.report.ticks import (
    engineering,
    finished,
    logarithmic,
    no_finer,
    panels,
    scaled_label,
)
from necc_casadi.report.time_axis import until_rest
from necc_casadi.simulation.responses import Trajectory

__all__ = [
    "coarse_enough",
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

#: Room around the reach of Ω, as a share of it; and widths of the domain that are shown beside it
#: where Ω goes on.
_BESIDE, _FAR = 0.15, 1.0


#: A state or input that moves less than this share of its size does not: what is left is the
#: integrator's error. Then so much of its size is shown.
_STILL, _STILL_SHOWN = 1e-6, 0.1


#: Room after the slowest response has settled, as a share of that time.
_AFTER = 0.25


#: An obstacle lies over Ω's shadow, not beside it, where it is nearer to z̄ than this share of it.
_WITHIN = 0.95


#: Height of a line of a title, in inches.
_LINE = 0.17


#: A state that travels less than this, in sizes, is at rest.
_STILL = 1e-6


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
    shown = without_poles(values)
    surface.plot_surface(
        A, B, shown, cmap="viridis", linewidth=0, alpha=0.9, rcount=40, ccount=40, rasterized=True
    )
    finished(
        surface,
        [("x", *named_state(design, i)), ("y", *named_state(design, j)), ("z", "V − V(z̄)", "")],
    )
    surface.yaxis.labelpad = surface.zaxis.labelpad = 8
    surface.view_init(elev=28, azim=-60)

    flat = figure.add_axes((0.58, 0.21, 0.40, 0.65))
    draw_contours(flat, design)
    figure.legend(*flat.get_legend_handles_labels(), loc="lower right", ncols=2, fontsize=8)
    return figure


def draw_contours(axis: Axes, design: Design) -> None:
    """Contours of V − V(z̄) over two coordinates through ξ*, with both minima."""
    window = domain_window(design)
    A, B, values = slice_values(design, window)
    lines = axis.contour(A, B, without_poles(values), levels=contour_levels(values), cmap="viridis")
    _mark_minima(design, axis, *window.pair)
    axis.set_xlim(window.lo[0], window.hi[0])
    axis.set_ylim(window.lo[1], window.hi[1])
    marks = np.array([design.z_star, design.z_bar])[:, window.pair]
    power = number_contours(axis, lines, marks)
    axis.set_title(scaled_label("contours of V − V(z̄)", "", power), fontsize=10)


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
    domain = domain_window(design)
    if sides is None:
        edge = shadow(design, level, domain)
        return domain.around(edge), edge
    lo, hi = np.array(sides).T
    edge = shadow(design, level, Window(domain.pair, lo, hi))  # Ω is proved to stay in these
    room, beside = _BESIDE * (hi - lo), _FAR * (domain.hi - domain.lo)
    whole = Window(domain.pair, lo - room, hi + room).around(edge)
    return whole.within(domain.lo - beside, domain.hi + beside), edge


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
    obstacle: Obstacle | None = None,
) -> Figure:
    """The proved region over V's contours: its slice at z*, its shadow, responses from the slice.

    Responses leave the slice because ξ moves, but not the shadow.
    """
    domain = domain_window(design)
    window, edge = _window(design, level, _telling_sides(design, reach))
    low, high = edge.min(axis=0), edge.max(axis=0)
    goes_on = (low < window.lo).any() or (high > window.hi).any()
    figure = panels(1, 1, (5.45, 4.1), legend=0.85, above=_LINE if goes_on else 0.0)
    axis = figure.add_subplot()
    draw_region(axis, design, level, responses, reach, obstacle)
    figure.legend(loc="lower center", ncols=2, fontsize=8)
    title = f"{design.loop.plant.name}: proved region Ω"
    title += f"\nΩ: {_extent(design, low, high)}" if goes_on else ""
    shown = _extent(design, domain.lo, domain.hi)  # Ω may be a small part
    axis.set_title(f"{title}\ndomain: {shown}", fontsize=8 if goes_on else 9)
    return figure


def draw_region(
    axis: Axes,
    design: Design,
    level: float,
    responses: Sequence[Trajectory] = (),
    reach: Reach | None = None,
    obstacle: Obstacle | None = None,
) -> None:
    """The proved region over V's contours on any axes; see :func:`region_figure`."""
    window, edge = _window(design, level, _telling_sides(design, reach))
    i, j = window.pair
    A, B, values = slice_values(design, window)
    shown, levels = without_poles(values), contour_levels(values)
    axis.contour(A, B, shown, levels=levels, cmap="viridis", linewidths=0.7, alpha=0.6)
    axis.fill(*edge.T, color=_MINIMUM, alpha=0.10, label="Ω seen over all other states (computed)")
    axis.plot(*np.vstack([edge, edge[:1]]).T, "--", color=_MINIMUM, lw=1)
    curve = slice_boundary(design, level, window)
    if curve is not None:
        axis.fill(*curve.T, color=_MINIMUM, alpha=0.15)
        top = level - design.V(design.z_bar)
        proved = f"proved: V − V(z̄) ≤ {engineering(top)}, other states at z*"
        outline = np.where(window.on_border(curve)[:, None], np.nan, curve)  # there Ω goes on
        axis.plot(*outline.T, color=_MINIMUM, lw=2, label=proved)
    began = "that boundary" if curve is None or not window.on_border(curve).any() else "its edge"
    for index, response in enumerate(responses):
        label = f"simulated from {began}{_leaving(responses)}" if index == 0 else None
        axis.plot(*response.z[:, [i, j]].T, lw=0.8, color=_INK, alpha=0.8, label=label)
        axis.plot(*response.z[0, [i, j]], ".", color=_INK)
    _mark_obstacle(axis, design, obstacle, window, edge)
    _mark_minima(design, axis, i, j)
    axis.set_xlim(window.lo[0], window.hi[0])
    axis.set_ylim(window.lo[1], window.hi[1])
    finished(axis, [("x", *named_state(design, i)), ("y", *named_state(design, j))])


def _mark_obstacle(
    axis: Axes, design: Design, obstacle: Obstacle | None, window: Window, edge: Vector
) -> None:
    """What ends Ω, where it is in sight and beside the shadow: another state's bound is not."""
    if obstacle is None or not obstacle.at:
        return
    place = np.array([obstacle.at[design.loop.states[k]] for k in window.pair])
    middle = design.z_bar[list(window.pair)]
    within = Curve(middle + _WITHIN * (edge - middle)).contains_point((place[0], place[1]))
    if not within and (place >= window.lo).all() and (place <= window.hi).all():
        kind = obstacle.kind.replace("_", " ")
        axis.plot(*place, "s", ms=6, color=_TARGET, label=f"ends Ω: {kind}")


def _leaving(responses: Sequence[Trajectory]) -> str:
    """Why responses leave the slice, or Ω itself."""
    left = sum(bool(np.any(r.V[0] + _ROUNDING * abs(r.V[0]) < r.V)) for r in responses)
    if left and any(r.saturated for r in responses):
        return f":\nu at a limit, V rises in {left}; Ω is proved for u without limits"
    return ":\nthey leave the slice as ξ moves, never Ω"


def _extent(design: Design, low: Vector, high: Vector) -> str:
    """A rectangle in words, for the two states that are shown."""
    texts = []
    for k, lo, hi in zip(domain_window(design).pair, low, high, strict=True):
        name, unit = named_state(design, k)
        texts.append(f"{name} from {engineering(lo, unit)} to {engineering(hi, unit)}")
    return ", ".join(texts)


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
                (True, _INK, "settles within 2 %"),
                (False, _UNSETTLED, "does not settle in this time"),
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
        color = _INK if response.converged else _UNSETTLED
        axis.plot(t, values, lw=0.9, color=color, alpha=0.7)
    common = _settled(trajectories)
    if name in states:
        k = states.index(name)
        axis.axhline(design.z_star[k], ls="--", lw=1, color=_TARGET)
        least = coarse_enough(axis, design.z_star[k], design.sizes.state[k])
        finished(axis, [("y", *named_state(design, k))])
    elif name in inputs:
        k = inputs.index(name)
        steady = design.lyapunov.control_law(design.z_bar[:n], design.z_bar[n:])[0]
        axis.axhline(steady[k], ls="--", lw=1, color=_TARGET)
        least = coarse_enough(axis, steady[k], design.sizes.input[k])
        draw_limits(axis, design, k)
        finished(axis, [("y", *named_input(design, k))])
    else:
        least = np.inf
        _decay_axis(axis, [values[t <= common] for t, values in curves])
    axis.set_xlim(0, until_rest(curves, common, least))
    axis.grid(alpha=0.25)


def coarse_enough(axis: Axes, middle: float, size: float) -> float:
    """Show a part of a quantity's size where it does not move; what is no motion."""
    no_finer(axis, _STILL * size, middle, _STILL_SHOWN * size)
    return _STILL * size


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
    telling = [k for k in np.argsort(-travel).tolist() if k < n or travel[k] > _STILL]
    return sorted(telling[:_MOST_PANELS])


def _over_time(design: Design, response: Trajectory, name: str) -> Vector:
    states, inputs = design.loop.states, design.loop.plant.input_names
    if name in states:
        return response.z[:, states.index(name)]
    if name in inputs:
        return response.u[:, inputs.index(name)]
    return np.maximum(response.V - response.V_bar, _ROUNDING * design.sizes.energy)


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
            axis.axhline(limit, ls=":", lw=1, color=_UNSETTLED)


def _decay_axis(axis: Axes, shown: Sequence[Vector]) -> None:
    axis.set_yscale("log")
    if shown:
        axis.set_ylim(bottom=0.5 * min(float(values.min()) for values in shown))
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
