"""Designs against a: how far from the target they rest, and how much is proved."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from necc_casadi.designs.design import Design
from necc_casadi.report.style import INK, MINIMUM, TARGET, Drawing
from necc_casadi.report.sweep_point import SweepPoint

__all__ = ["draw_distances", "draw_shares", "sweep_figure"]


#: Where no proved share exceeds this, shares are drawn on a logarithmic axis.
_SMALL_SHARE = 0.02


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
            axis.axvspan(ceiling, right, color=TARGET, alpha=0.08, lw=0, label="a above a_max")
            axis.set_xlim(right=right)
        axis.legend(fontsize=8)
    lower.set_xlabel("a, curvature asked of ∇²V(z*)")
    return figure


def draw_distances(axis: Axes, design: Design, points: Sequence[SweepPoint]) -> None:
    """Distance and bounds; what is smaller than one rounding of z* lies in a band of its own."""
    rounding = float(np.spacing(np.linalg.norm(design.z_star)))
    series = (
        ("paper's bound ε/(a − ε)", [p.bound_paper for p in points], "s--", TARGET),
        ("proved bound g/μ", [p.bound_rigorous for p in points], "^-", MINIMUM),
        ("distance ‖z̄ − z*‖", [p.distance for p in points], "o-", INK),
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
        ("converges in simulation", [p.simulated_share for p in points], "o-", INK),
        ("in the proved region", [p.domain_share for p in points], "^-", MINIMUM),
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
            missing, [0.0] * len(missing), "x", color=TARGET, ms=8, mew=2, transform=at_bottom,
            clip_on=False, label="no region proved",
        )  # fmt: skip
    axis.set_ylabel("share of the domain [%],\nmomenta at rest")
