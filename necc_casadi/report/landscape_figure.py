"""The least V over all states that were minimised out, with the level that is proved below it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from necc_casadi.arrays import Vector
from necc_casadi.certificate.claims.certificate import Certificate
from necc_casadi.certificate.claims.regions import Obstacle, Region
from necc_casadi.certificate.prover.region.landscape import Landscape
from necc_casadi.certificate.prover.region.obstacle import search
from necc_casadi.designs.design import Design
from necc_casadi.report.contours import number_contours
from necc_casadi.report.style import INK, MINIMUM, TARGET, UNSETTLED
from necc_casadi.report.ticks import engineering, finished, logarithmic, panels

__all__ = ["draw_landscape", "landscape_figure"]


#: Points of the curve, and of a side of the plane.
_CURVE, _PLANE = 401, 121


#: Room around the region and its obstacle, and above the obstacle, as shares.
_ROOM, _ABOVE = 0.25, 0.6


#: A minimum of the curve this near z̄, as a share of what is shown, is z̄ itself.
_APART = 0.02


#: States that can be drawn.
_MOST = 2


#: Height of the obstacle over what W is in most of the region, from which on W is drawn on a
#: logarithmic axis; and the share of the points, nearest to z̄, below it.
_TOWER, _BELOW_AXIS = 100.0, 0.02


#: An obstacle lower than this share of W there has the other states elsewhere than at W's minimum.
_AT_LEAST = 0.99


def landscape_figure(design: Design, certificate: Certificate) -> Figure | None:
    """W(s) = min V(s, ·) over the kept states s, its obstacle and its minima.

    None where no region is proved, or s is none or more than two states.
    """
    figure = panels(1, 1, (5.45, 3.3), legend=0.5)
    axis = figure.add_subplot()
    if not draw_landscape(axis, design, certificate):
        return None
    figure.legend(loc="lower center", ncols=2, fontsize=8)
    axis.set_title(
        f"{design.loop.plant.name}: the least V − V(z̄) over all other states", fontsize=10
    )
    return figure


def draw_landscape(axis: Axes, design: Design, certificate: Certificate) -> bool:
    """The same on any axes; False, and nothing drawn, where there is none."""
    region, obstacle = certificate.region, certificate.obstacle
    if not isinstance(region, Region) or obstacle is None or not 1 <= len(region.kept) <= _MOST:
        return False
    picture = _Picture(design, region, obstacle, certificate.level_above_minimum or 0.0)
    (picture.curve if len(region.kept) == 1 else picture.plane)(axis)
    return True


@dataclass(frozen=True, eq=False)
class _Picture:
    """W over a window of s, in the units of the model."""

    design: Design
    region: Region
    obstacle: Obstacle
    height: float  # of the level above V(z̄)

    @property
    def _states(self) -> list[int]:
        return [self.region.active[i] for i in self.region.kept]

    @cached_property
    def _unit(self) -> Vector:
        return np.asarray(self.design.units.state[self._states], float)

    @cached_property
    def _landscape(self) -> Landscape:
        gone = tuple(i for i in range(len(self.region.active)) if i not in self.region.kept)
        natural, region = self.design.natural, self.region
        return Landscape(natural.lyapunov, natural.z_star, region.active, region.kept, gone)

    @cached_property
    def _place(self) -> Vector | None:
        """The obstacle's s; None where it is no place."""
        names = [self.design.loop.states[i] for i in self._states]
        at = self.obstacle.at
        return np.array([at[name] for name in names]) if at else None

    @cached_property
    def _window(self) -> tuple[Vector, Vector]:
        box = np.array(self.region.box.whole) * self._unit[:, None]
        lo, hi = box[:, 0], box[:, 1]
        if self._place is not None:
            lo, hi = np.minimum(lo, self._place), np.maximum(hi, self._place)
        room = _ROOM * (hi - lo)
        return lo - room, hi + room

    def _w(self, s: Vector) -> Vector:
        """W − V(z̄) at points (B, ds)."""
        lowest = self._landscape.minima(s / self._unit).w * self.design.units.energy
        return np.asarray(lowest - self.design.V(self.design.z_bar), float)

    @cached_property
    def _others(self) -> Vector:
        """Minima of w besides z̄ in the window, (k, ds)."""
        lo, hi = self._window
        s_bar = self.design.natural.z_bar[self._states]
        found = search(self._landscape, lo / self._unit, hi / self._unit, s_bar)
        kept = [
            s
            for s, _, _, index in found.points
            if index == 0 and (np.abs(s - s_bar) > found.step).any()
        ]
        return np.array(kept).reshape(-1, len(self._unit)) * self._unit

    def _named(self, k: int) -> tuple[str, str]:
        name = self.design.loop.states[self._states[k]]
        return name, self.design.loop.plant.units.get(name, "")

    @cached_property
    def _marked(self) -> Vector | None:
        """Where the obstacle is marked: a place at which W is as high, no lower ground."""
        if self._place is None:
            return None
        here = float(self._w(self._place[None, :])[0])
        lower = here < _AT_LEAST * self.obstacle.level_above_minimum
        return None if lower and self.obstacle.kind != "singularity" else self._place

    @property
    def _proved(self) -> str:
        return f"proved up to V − V(z̄) = {engineering(self.height)}"

    @property
    def _met(self) -> str:
        kind = self.obstacle.kind.replace("_", " ")
        height = engineering(self.obstacle.level_above_minimum, digits=4)
        elsewhere = "" if self._marked is not None else ", of another state"
        return f"obstacle: {kind}{elsewhere}, {height}"

    def _mark_obstacle(self, axis: Axes, *height: float) -> None:
        """A dot where it is; else words alone."""
        at = ([], []) if self._marked is None else (*self._marked, *height)
        axis.plot(*at, " " if self._marked is None else "o", ms=8, color=TARGET, label=self._met)

    def _along(self, lo: float, hi: float) -> Vector:
        """Points of the curve, denser towards the ends of the region's box, where a pole may be."""
        box = np.array(self.region.box.whole[0]) * self._unit[0]
        inside = box.mean() - 0.5 * np.ptp(box) * np.cos(np.linspace(0, np.pi, _CURVE))
        return np.unique(np.concatenate([np.linspace(lo, hi, _CURVE), inside]))

    def curve(self, axis: Axes) -> None:
        """W over one state."""
        lo, hi = self._window
        s = self._along(lo[0], hi[0])
        w = self._w(s[:, None])
        top = (1 + _ABOVE) * self.obstacle.level_above_minimum
        drawn = w.copy()
        drawn[1:][np.abs(np.diff(w)) > top] = np.nan  # a pole is no line
        axis.plot(s, drawn, color=INK, lw=1.6)
        inside = self.region.covers(s[:, None] / self._unit) & (w <= self.height)
        axis.fill_between(
            s, w, self.height, where=inside.tolist(), color=MINIMUM, alpha=0.2, label=self._proved
        )
        axis.axhline(self.height, ls="--", lw=1, color=MINIMUM)
        self._mark_obstacle(axis, self.obstacle.level_above_minimum)
        star = self.design.z_bar[self._states[0]]
        low = _minima(drawn)
        low = low[np.abs(s[low] - star) > _APART * (hi[0] - lo[0])]
        if low.size:
            axis.plot(s[low], w[low], "x", ms=8, mew=2, color=UNSETTLED, label="other minimum")
        shown = w[np.isfinite(w)]
        lowest = max(float(shown.min(initial=0.0)) * 1.05, -top)  # not down a pole
        axis.set_xlim(lo[0], hi[0])
        axis.grid(alpha=0.25)
        finished(axis, [("x", *self._named(0))])
        inner = np.sort(w[inside])
        if inner.size and np.median(inner) * _TOWER < self.height and lowest > -inner[-1] / _TOWER:
            low_end = float(inner[int(_BELOW_AXIS * inner.size)])
            axis.set_yscale("log")
            axis.set_ylim(low_end, top)
            logarithmic(axis, "y")
            axis.set_ylabel("min V − V(z̄)")
            label, place = "minimum z̄ of V: 0", low_end
        else:
            axis.set_ylim(min(-0.05 * top, lowest), top)
            finished(axis, [("y", "min V − V(z̄)", "")])
            label, place = "minimum z̄ of V", 0.0
        axis.plot(star, place, "+", ms=11, mew=2, color=MINIMUM, label=label, clip_on=False)

    def plane(self, axis: Axes) -> None:
        """W over two states, and the cells that hold the region."""
        lo, hi = self._window
        A, B = np.meshgrid(*(np.linspace(a, b, _PLANE) for a, b in zip(lo, hi, strict=True)))
        s = np.stack([A.ravel(), B.ravel()], -1)
        w = self._w(s).reshape(A.shape)
        top = (1 + _ABOVE) * self.obstacle.level_above_minimum
        low = min(0.0, float(np.nanmin(w)))
        levels = low + (top - low) * np.linspace(0.02, 1.0, 16)
        lines = axis.contour(A, B, w, levels=levels, cmap="viridis", linewidths=0.8, alpha=0.7)
        cells = self.region.covers(s / self._unit).reshape(A.shape).astype(float)
        axis.contour(A, B, cells, levels=[0.5], colors=[INK], linewidths=0.9, linestyles="--")
        axis.plot([], [], "--", lw=0.9, color=INK, label="cells of the proof")
        inside = np.where(cells > 0, w, np.nan)
        axis.contourf(A, B, inside, levels=[low - 1.0, self.height], colors=[MINIMUM], alpha=0.15)
        axis.contour(A, B, inside, levels=[self.height], colors=[MINIMUM], linewidths=2)
        axis.plot([], [], color=MINIMUM, lw=2, label=self._proved)
        self._mark_obstacle(axis)
        star = self.design.z_bar[self._states]
        axis.plot(*star, "+", ms=11, mew=2, color=MINIMUM, label="minimum z̄ of V")
        places = self._others
        if len(places):
            axis.plot(*places.T, "x", ms=8, mew=2, color=UNSETTLED, label="other minimum")
        axis.set_xlim(lo[0], hi[0])
        axis.set_ylim(lo[1], hi[1])
        marks = [star, *places, *([] if self._marked is None else [self._marked])]
        number_contours(axis, lines, np.array(marks))
        finished(axis, [("x", *self._named(0)), ("y", *self._named(1))])


def _minima(w: Vector) -> npt.NDArray[np.intp]:
    """Indices of a curve's minima; beside a gap there is none."""
    inner = w[1:-1]
    with np.errstate(invalid="ignore"):
        low = (inner < w[:-2]) & (inner < w[2:])
    return np.flatnonzero(low) + 1
