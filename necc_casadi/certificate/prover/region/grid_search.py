"""Where the cells of a grid are spent: on the domain, or on a smaller box around the component.

The domain may be far larger than the region: cells are then too coarse to settle the surroundings
of z̄, or few of them lie in the region. Smaller boxes come from floods of plain values of V, from
z̄ to ever lower levels, and from the component that a grid has proved. They are guesses, whose worth
the grid on each decides.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from necc_casadi.arrays import Truth, Vector
from necc_casadi.certificate.claims.regions import Grid
from necc_casadi.certificate.prover.arithmetic.intervals import Interval
from necc_casadi.certificate.prover.arithmetic.potential import Potential
from necc_casadi.certificate.prover.region.grid import (
    Flood,
    boundary,
    boxes_of,
    cells_met,
    flood,
    make_grid,
    spread,
)

__all__ = ["GRID_CELLS", "ProvedGrid", "widest_grid"]


#: Cells of the grid, by dimension; more dimensions are the business of the ellipsoid.
GRID_CELLS = {1: 4096, 2: 128**2, 3: 40**3}


#: The same where the box fits the component, so that most cells count.
_CLOSE_CELLS = {1: 2048, 2: 96**2, 3: 40**3}


#: The same for plain values of V.
_VALUES = {1: 256, 2: 64**2, 3: 24**3}


#: Heights that are tried above V(z̄), as shares of the one at which V leaves the domain.
_HEIGHTS = (1.0, 0.5, 0.25, 0.1, 0.03, 0.01, 1e-3)


#: A box is worth another grid where its volume is smaller by this.
_WORTH = 0.5


#: Boxes that are tried in pursuit of a component.
_ROUNDS = 12


#: Free width around a component, and where it leaves the grid, as shares of the component's.
_MARGIN, _GROWTH = 0.05, 0.5


#: A box that would grow by less than this share is kept.
_STILL = 0.1


#: Share of the height of a level that is given up, so that other arithmetic, which rounds otherwise
#: and halves faces a few times only, can confirm it.
_EASED = 1e-6


@dataclass(frozen=True, eq=False)
class ProvedGrid:
    """A grid, its flood, and the level that is claimed, at most the ceiling."""

    grid: Grid
    flood: Flood
    level: float

    @property
    def mask(self) -> Truth:
        """The cells of the component of {V ≤ level}."""
        return np.asarray(self.flood.levels <= self.level)

    @property
    def inside(self) -> Truth:
        """The cells that are wholly in it."""
        return np.asarray(self.mask & (self.flood.upper <= self.level))

    def boxes(self) -> Interval:
        """The cells of the component, (B, d)."""
        return boxes_of(self.grid, np.flatnonzero(self.mask.ravel()))

    def hull(self) -> Interval:
        """The box around them, (d,)."""
        boxes = self.boxes()
        return Interval(boxes.lo.min(0), boxes.hi.max(0))

    @property
    def volume(self) -> float:
        """Of the cells inside."""
        return float(self.inside.sum()) * float(np.prod(self.grid.step))


def widest_grid(
    potential: Potential, domain: Interval, z_bar: Interval, ceiling: float
) -> ProvedGrid | None:
    """The largest region that a grid in the domain proves, of level ≤ ceiling, or None."""
    box = domain
    best = _proved(potential, make_grid(box.lo, box.hi, GRID_CELLS[box.shape[0]]), z_bar, ceiling)
    for height in _HEIGHTS if best is None else ():
        guess = _guessed(potential, domain, z_bar, height)
        if _smaller(guess, box):
            box = guess
            best = _proved(potential, _close_grid(box), z_bar, ceiling)
        if best is not None:
            break
    while best is not None and _smaller(guess := _around(best.grid, best.mask, domain), box):
        box = guess
        again = _proved(potential, _close_grid(box), z_bar, ceiling)
        if again is None or (again.volume, again.level) <= (best.volume, best.level):
            break
        best = again
    return best


def _proved(potential: Potential, grid: Grid, z_bar: Interval, ceiling: float) -> ProvedGrid | None:
    """What one grid proves; None where its cells are too coarse for the surroundings of z̄."""
    found = flood(potential, grid, z_bar)
    bottom = float(potential.jet(z_bar[None, :]).value.hi[0])
    if found is None or not found.level > bottom:
        return None
    eased = bottom + (1 - _EASED) * (found.level - bottom)
    return ProvedGrid(grid, found, min(eased, ceiling))


def _close_grid(box: Interval) -> Grid:
    return make_grid(box.lo, box.hi, _CLOSE_CELLS[box.shape[0]])


def _smaller(guess: Interval, box: Interval) -> bool:
    return bool(np.prod((guess.hi - guess.lo) / (box.hi - box.lo)) < _WORTH)


def _around(grid: Grid, mask: Truth, domain: Interval) -> Interval:
    """The box around the marked cells, a little widened, more so where they near its border."""
    index, step = np.argwhere(mask), np.array(grid.step)
    low, high = index.min(0), index.max(0) + 1
    width = high - low
    below = np.where(low > 1, _MARGIN, _GROWTH) * width
    above = np.where(high < np.array(grid.shape) - 1, _MARGIN, _GROWTH) * width
    first = np.array(grid.first)
    return Interval(
        np.maximum((first + low - np.maximum(1.0, below)) * step, domain.lo),
        np.minimum((first + high + np.maximum(1.0, above)) * step, domain.hi),
    )


def _guessed(potential: Potential, domain: Interval, z_bar: Interval, height: float) -> Interval:
    """A box around the component of {V ≤ V(z̄) + height · (its least value on the border)}.

    The box follows the component to the border of the domain: cells of the whole domain may miss
    it, and those of a box that it leaves say nothing about the border.
    """
    bottom = float(_values(potential, z_bar.mid[None])[0])
    box, guess = domain, domain
    for _ in range(_ROUNDS):
        grid = make_grid(box.lo, box.hi, _VALUES[box.shape[0]])
        start = cells_met(grid, z_bar)
        if start.size == 0:
            break
        low = _values(potential, boxes_of(grid, np.arange(grid.size)).mid)
        low[start] = bottom
        top, levels, _ = spread(grid, low, np.where(boundary(grid), low, np.inf), start)
        guess = _around(grid, np.asarray(levels <= bottom + height * (top - bottom)), domain)
        whole = _around(grid, np.asarray(levels <= top), domain)
        if _smaller(whole, box):
            box = whole
            continue
        grown = Interval(np.minimum(whole.lo, box.lo), np.maximum(whole.hi, box.hi))
        if (grown.hi - grown.lo < (1 + _STILL) * (box.hi - box.lo)).all():
            break
        box = grown
    return guess


def _values(potential: Potential, points: Vector) -> Vector:
    """V at points (B, active) in plain floating point, ∞ where it is not defined, (B,)."""
    loop = potential.design.loop
    z = np.zeros((len(points), loop.n))
    z[:, list(potential.active)] = points
    values = potential.design.lyapunov.V(z)
    return np.where(np.isfinite(values), values, np.inf)
