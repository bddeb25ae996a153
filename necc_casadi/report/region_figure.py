"""V around the target, and the proved region."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.path import Path as Curve

from necc_casadi.arrays import Vector
from necc_casadi.certificate.claims.regions import Obstacle, Side
from necc_casadi.designs.design import Design
from necc_casadi.report.contours import contour_levels, number_contours, without_poles
from necc_casadi.report.named_axes import (
    ROUNDING,
    named_state,
)
from necc_casadi.report.slices import Window, domain_window, shadow, slice_boundary, slice_values
from necc_casadi.report.style import INK, MINIMUM, TARGET, Drawing
from necc_casadi.report.ticks import (
    engineering,
    finished,
    panels,
    scaled_label,
)
from necc_casadi.simulation.responses import Trajectory

__all__ = ["draw_contours", "draw_region", "lyapunov_figure", "region_boundary", "region_figure"]


#: Least and greatest value of each state on Ω; None: every value.
Reach = Mapping[str, Side | None]

#: Room around the reach of Ω, as a share of it; and widths of the domain that are shown beside it
#: where Ω goes on.
_BESIDE, _FAR = 0.15, 1.0


#: An obstacle lies over Ω's shadow, not beside it, where it is nearer to z̄ than this share of it.
_WITHIN = 0.95


#: Height of a line of a title, in inches.
_LINE = 0.17


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
    axis.plot(star[i], star[j], "o", ms=11, mfc="none", mew=2, color=TARGET, label="target z*")
    axis.plot(bar[i], bar[j], "+", ms=11, mew=2, color=MINIMUM, label="minimum z̄ of V")
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
    axis.fill(*edge.T, color=MINIMUM, alpha=0.10, label="Ω seen over all other states (computed)")
    axis.plot(*np.vstack([edge, edge[:1]]).T, "--", color=MINIMUM, lw=1)
    curve = slice_boundary(design, level, window)
    if curve is not None:
        axis.fill(*curve.T, color=MINIMUM, alpha=0.15)
        top = level - design.V(design.z_bar)
        proved = f"proved: V − V(z̄) ≤ {engineering(top)}, other states at z*"
        outline = np.where(window.on_border(curve)[:, None], np.nan, curve)  # there Ω goes on
        axis.plot(*outline.T, color=MINIMUM, lw=2, label=proved)
    began = "that boundary" if curve is None or not window.on_border(curve).any() else "its edge"
    for index, response in enumerate(responses):
        label = f"simulated from {began}{_leaving(responses)}" if index == 0 else None
        axis.plot(*response.z[:, [i, j]].T, lw=0.8, color=INK, alpha=0.8, label=label)
        axis.plot(*response.z[0, [i, j]], ".", color=INK)
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
        axis.plot(*place, "s", ms=6, color=TARGET, label=f"ends Ω: {kind}")


def _leaving(responses: Sequence[Trajectory]) -> str:
    """Why responses leave the slice, or Ω itself."""
    left = sum(bool(np.any(r.V[0] + ROUNDING * abs(r.V[0]) < r.V)) for r in responses)
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
