"""A design beside LQR and the optimum: a step of the set-point, and the loop in frequency."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from necc_casadi.arrays import Vector
from necc_casadi.designs.design import Design
from necc_casadi.performance.margins import Sweep
from necc_casadi.performance.measure import Curve, Loop, Performance
from necc_casadi.report.named_axes import coarse_enough, draw_limits, named_input, named_state
from necc_casadi.report.style import INK, MINIMUM, TARGET, UNSETTLED, Drawing
from necc_casadi.report.ticks import engineering, finished, logarithmic
from necc_casadi.report.time_axis import until_rest

__all__ = [
    "draw_gain",
    "draw_nyquist",
    "draw_phase",
    "draw_step",
    "frequency_figure",
    "step_figure",
    "step_names",
]


#: Colour and line of each controller.
_STYLE: dict[str, dict[str, Any]] = {
    "this design": {"color": INK, "lw": 1.8},
    "LQR": {"color": TARGET, "lw": 1.3, "ls": "--"},
    "optimum": {"color": MINIMUM, "lw": 1.3, "ls": ":"},
}


#: States and inputs that are drawn at most.
_MOST_STATES, _MOST_INPUTS = 6, 3


#: Decades of |L| that are shown beside 1, and how far beyond the crossings.
_DECADES, _BEYOND = 2.5, 30.0


def step_figure(design: Design, found: Performance) -> Figure | None:
    """States and inputs from one size below the target, beside LQR and the optimum."""
    if not found.step:
        return None
    n = design.loop.plant.n
    names = step_names(design, found)
    columns = min(3, len(names))
    rows = -(-len(names) // columns)
    figure = Drawing(figsize=(3.8 * columns, 2.4 * rows + 0.9), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for name, axis in zip(names, axes, strict=False):
        draw_step(axis, design, found, name)
    for axis in axes[len(names) :]:
        axis.remove()
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, fontsize=8)
    shown = sum(name in design.loop.plant.states for name in names)
    left_out = "" if shown == n else f", {shown} of {n} states"
    figure.suptitle(
        f"{design.loop.plant.name}: from one size below the target{left_out}", fontsize=11
    )
    return figure


def step_names(design: Design, found: Performance) -> list[str]:
    """What a figure of the step has panels for: states and inputs, by name."""
    states = [design.loop.plant.states[k] for k in _telling(found.step, design)]
    return [*states, *design.loop.plant.input_names[:_MOST_INPUTS]]


def draw_step(axis: Axes, design: Design, found: Performance, name: str) -> None:
    """A plant state or an input in the step, beside LQR and the optimum, on any axes."""
    states, n = design.loop.plant.states, design.loop.plant.n
    if name in states:
        k = states.index(name)
        size = float(design.sizes.state[k])
        _panel(axis, [(c, c.x[:, k]) for c in found.step], float(design.z_star[k]), size)
        label = named_state(design, k)
    else:
        k = design.loop.plant.input_names.index(name)
        held = design.lyapunov.control_law(design.z_star[:n], design.xi_star)[0]
        size = float(design.sizes.input[k])
        _panel(axis, [(c, c.u[:, k]) for c in found.step], float(held[k]), size)
        draw_limits(axis, design, k)
        label = named_input(design, k)
    finished(axis, [("x", "time", "s"), ("y", *label)])


def _panel(axis: Axes, curves: Sequence[tuple[Curve, Vector]], target: float, size: float) -> None:
    for curve, values in curves:
        axis.plot(curve.t, values, label=curve.name, **_STYLE[curve.name])
    axis.axhline(target, color="0.5", lw=0.8)
    least, common = coarse_enough(axis, target, size), _settled([curve for curve, _ in curves])
    axis.set_xlim(0, until_rest([(curve.t, values) for curve, values in curves], common, least))
    axis.grid(alpha=0.25)


def _settled(curves: Sequence[Curve]) -> float:
    """A time at which all of them have come to rest, with some room."""
    ends = []
    for curve in curves:
        away = np.abs(curve.x - curve.x[-1])
        largest = np.maximum(away.max(axis=0), np.finfo(float).tiny)
        moving = np.flatnonzero((away / largest).max(axis=1) > 0.01)
        if np.isfinite(away).all() and moving.size:
            ends.append(float(curve.t[moving[-1]]))
    return 1.2 * max(ends, default=float(curves[0].t[-1]))


def _telling(curves: Sequence[Curve], design: Design) -> list[int]:
    """All states where they fit, else those that travel farthest."""
    n = design.loop.plant.n
    travel = np.nanmax([np.ptp(c.x / design.sizes.state[:n], axis=0) for c in curves], axis=0)
    return sorted(int(k) for k in np.argsort(-travel)[:_MOST_STATES])


def frequency_figure(design: Design, found: Performance) -> Figure | None:
    """Bode's and Nyquist's diagrams of the loop opened at each input, the others closed."""
    if not found.loops:
        return None
    m = min(design.loop.plant.m, _MOST_INPUTS)
    figure = Drawing(figsize=(9.6, 4.2 * m + 0.5), layout="constrained")
    for k in range(m):
        sides = figure.add_gridspec(m, 1)[k].subgridspec(2, 2, width_ratios=(3, 2))
        gain = figure.add_subplot(sides[0, 0])
        phase = figure.add_subplot(sides[1, 0], sharex=gain)
        plane = figure.add_subplot(sides[:, 1])
        draw_gain(gain, found, k)
        draw_phase(phase, found, k)
        draw_nyquist(plane, found, k)
        gain.set_xlabel("")
        gain.tick_params(labelbottom=False)
        gain.set_title(f"L with the loop broken at {named_input(design, k)[0]}", fontsize=10)
    handles, labels = plane.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", fontsize=8)
    figure.suptitle(f"{design.loop.plant.name}: loop at the plant's input", fontsize=11)
    return figure


def draw_gain(axis: Axes, found: Performance, k: int) -> None:
    """Bode's diagram of |L| with the loop broken at input k, on any axes."""
    for loop in found.loops:
        axis.loglog(
            loop.inputs[k].w, np.abs(loop.inputs[k].L), label=loop.name, **_STYLE[loop.name]
        )
    axis.set_xlim(*_crossings(found, k))
    axis.set_ylim(10**-_DECADES, 10**_DECADES)
    axis.axhline(1, color="0.5", lw=0.8)
    logarithmic(axis, "y")
    axis.set_ylabel("|L|")
    _over_frequency(axis)


def draw_phase(axis: Axes, found: Performance, k: int) -> None:
    """Bode's diagram of the phase of L with the loop broken at input k, on any axes."""
    for loop in found.loops:
        sweep = loop.inputs[k]
        angle = np.degrees(np.unwrap(np.angle(sweep.L)))
        crossing = int(np.argmin(np.abs(np.log(np.abs(sweep.L) + np.finfo(float).tiny))))
        angle -= 360 * np.round((angle[crossing] + 90) / 360)  # near −90° where it matters
        axis.semilogx(sweep.w, angle, label=loop.name, **_STYLE[loop.name])
    axis.set_xlim(*_crossings(found, k))
    axis.axhline(-180, color="0.5", lw=0.8)
    axis.set_ylabel("phase [°]")
    axis.set_yticks(_angles(axis))
    _over_frequency(axis)


def _over_frequency(axis: Axes) -> None:
    logarithmic(axis, "x")
    axis.set_xlabel("frequency [rad/s]")
    axis.grid(alpha=0.25)


def _crossings(found: Performance, k: int) -> tuple[float, float]:
    """Frequencies around those at which |L| is near 1."""
    low, high = [], []
    for sweep in (loop.inputs[k] for loop in found.loops):
        near = np.flatnonzero(np.abs(np.log10(np.abs(sweep.L) + np.finfo(float).tiny)) < 1.5)
        picked = sweep.w[near] if near.size else sweep.w
        low.append(float(picked[0]))
        high.append(float(picked[-1]))
    return min(low) / 3, max(high) * 3


def _angles(phase: Axes) -> Vector:
    """Multiples of 90° within what is shown."""
    low, high = phase.get_ylim()
    step = 90 if high - low < 720 else 360
    return np.asarray(np.arange(step * np.ceil(low / step), high + 1, step), float)


def _plane(sweep: Sweep) -> tuple[Vector, Vector]:
    """L(jω) where it is not far from the origin."""
    shown = np.where(np.abs(sweep.L) < _BEYOND, sweep.L, np.nan)
    return np.real(shown), np.imag(shown)


def draw_nyquist(axis: Axes, found: Performance, k: int) -> None:
    """Nyquist's diagram of L with the loop broken at input k, on any axes."""
    for loop in found.loops:
        axis.plot(*_plane(loop.inputs[k]), label=_margin_text(loop), **_STYLE[loop.name])
    circle = np.exp(1j * np.linspace(0, 2 * np.pi, 181))
    axis.plot(circle.real, circle.imag, color="0.7", lw=0.8)
    axis.plot(-1, 0, "+", color=UNSETTLED, ms=10, mew=2)
    axis.set_xlim(-3, 2)
    axis.set_ylim(-3, 2)
    axis.set_aspect("equal")
    axis.grid(alpha=0.25)
    axis.set_xlabel("Re L")
    axis.set_ylabel("Im L")


def _margin_text(loop: Loop) -> str:
    m = loop.margins
    gain = "∞" if np.isinf(m.gain) else f"{m.gain:.2g}"
    return (
        f"{loop.name}: phase margin {m.phase_deg:.0f}°, gain {m.gain_down:.2g} … {gain}, "
        f"disk {m.disk:.2f}, delay {engineering(m.delay, 's')}"
    )
