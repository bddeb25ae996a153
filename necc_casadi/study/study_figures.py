"""Figures of a study: how outcomes are spread, and maps over two of the things that vary."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from necc_casadi.arrays import Vector
from necc_casadi.report.style import INK, TARGET, Drawing, styled
from necc_casadi.report.ticks import finished, panels
from necc_casadi.study.tables import Table

__all__ = ["histograms", "maps"]


#: A figure shows so many panels at most.
_MOST = 9


#: What a map of designs shows, where there are numbers.
_MAPPED = {
    "domain_share": "share of the domain in Ω",
    "settling_time": "slowest of ten responses [s]",
    "peak_u": "largest |u|",
    "cost_to_lqr": "cost over LQR's",
}


def histograms(table: Table, title: str, units: Mapping[str, str]) -> Figure:
    """Of settling time, offset, peak inputs and converging share, over all plants."""
    wanted = [name for name in table.columns if name.startswith(("offset_", "peak_"))]
    shown = ["converging_share", "settling_time", *wanted][:_MOST]
    columns = min(3, len(shown))
    rows = -(-len(shown) // columns)
    with styled():
        figure = panels(rows, columns, (2.9, 1.9))
        figure.suptitle(f"{title}: {len(table)} plants")
        axes = figure.subplots(rows, columns, squeeze=False).ravel()
        for name, axis in zip(shown, axes, strict=False):
            _spread(axis, table.numbers(name), *_named(name, units), name.endswith("_share"))
        for axis in axes[len(shown) :]:
            axis.remove()
    return figure


def _named(name: str, units: Mapping[str, str]) -> tuple[str, str]:
    kind, _, of = name.partition("_")
    if kind == "offset":
        return f"{of} at rest less target", units.get(of, "")
    if kind == "peak":
        return f"largest |{of}|", units.get(of, "")
    return {"settling_time": ("slowest start settles", "s")}.get(
        name, ("share of starts that settle", "")
    )


def _spread(axis: Axes, values: Vector, label: str, unit: str, share: bool) -> None:
    known = values[np.isfinite(values)]
    if known.size:
        lo, hi = (0.0, 1.0) if share else (float(known.min()), float(known.max()))
        if not hi - lo > 1e-9 * max(abs(lo), abs(hi)):  # all alike
            half = abs(hi) / 2 or 0.5
            lo, hi = lo - half, hi + half
        axis.hist(known, bins=np.linspace(lo, hi, 26).tolist(), color=INK, alpha=0.85)
        axis.axvline(float(np.median(known)), color=TARGET, lw=1.2)
    if known.size < values.size:
        note = f"{values.size - known.size} have none"
        axis.text(0.97, 0.95, note, transform=axis.transAxes, ha="right", va="top", fontsize=8)
    axis.set_ylabel("plants")
    axis.grid(alpha=0.25)
    finished(axis, [("x", label, unit)])


def maps(table: Table, axes: Sequence[str], title: str, units: Mapping[str, str]) -> Figure | None:
    """Over the first two things that vary, the median over everything else.

    None where nothing varies.
    """
    shown = [name for name in _MAPPED if np.isfinite(table.numbers(name)).any()]
    if not axes:
        return None
    names = ["certified", *shown]
    with styled():
        if len(axes) == 1:
            return _curves(table, axes[0], names, title, units)
        columns = min(2, len(names))
        rows = -(-len(names) // columns)
        figure = Drawing(figsize=(4.6 * columns, 3.4 * rows + 0.4), layout="constrained")
        figure.suptitle(f"{title}: {len(table)} designs", fontsize=11)
        panes = figure.subplots(rows, columns, squeeze=False).ravel()
        for name, pane in zip(names, panes, strict=False):
            _map(pane, table, axes[0], axes[1], name, units)
        for pane in panes[len(names) :]:
            pane.remove()
    return figure


def _values(table: Table, name: str) -> tuple[Vector, str]:
    if name == "certified":
        good = [status in ("certified", "assignable") for status in table.texts("status")]
        return np.array(good, float), "share certified"
    return table.numbers(name), _MAPPED[name]


def _map(
    axis: Axes, table: Table, across: str, up: str, name: str, units: Mapping[str, str]
) -> None:
    values, label = _values(table, name)
    x, y = table.numbers(across), table.numbers(up)
    xs, ys = np.unique(x), np.unique(y)
    cells = np.full((len(ys), len(xs)), np.nan)
    for i, height in enumerate(ys):
        for j, left in enumerate(xs):
            here = values[(x == left) & (y == height)]
            here = here[np.isfinite(here)]
            if here.size:
                cells[i, j] = here.mean() if name == "certified" else np.median(here)
    low, high = (0.0, 1.0) if name in ("certified", "domain_share") else (None, None)
    axis.set_facecolor("0.9")  # where there is no number
    mesh = axis.pcolormesh(
        _edges(xs), _edges(ys), cells, cmap="viridis", rasterized=True, vmin=low, vmax=high
    )
    bar = axis.get_figure(root=True).colorbar(mesh, ax=axis)  # type: ignore[union-attr]
    bar.ax.tick_params(labelsize=8)
    axis.set_title(label, fontsize=10)
    finished(axis, [("x", across, units.get(across, "")), ("y", up, units.get(up, ""))])


def _edges(values: Vector) -> Vector:
    """Borders of cells around values."""
    if values.size == 1:
        half = abs(values[0]) / 2 or 0.5
        return np.array([values[0] - half, values[0] + half])
    middle = (values[1:] + values[:-1]) / 2
    first, last = 2 * values[0] - middle[0], 2 * values[-1] - middle[-1]
    return np.concatenate([[first], middle, [last]])


def _curves(
    table: Table, across: str, names: Sequence[str], title: str, units: Mapping[str, str]
) -> Figure:
    columns = min(3, len(names))
    rows = -(-len(names) // columns)
    figure = panels(rows, columns, (2.9, 1.9))
    figure.suptitle(f"{title}: {len(table)} designs")
    panes = figure.subplots(rows, columns, squeeze=False).ravel()
    x = table.numbers(across)
    for name, pane in zip(names, panes, strict=False):
        values, label = _values(table, name)
        pane.plot(x, values, "o", ms=4, color=INK)
        pane.grid(alpha=0.25)
        pane.set_title(label, fontsize=9)
        finished(pane, [("x", across, units.get(across, "")), ("y", "", "")])
    for pane in panes[len(names) :]:
        pane.remove()
    return figure
