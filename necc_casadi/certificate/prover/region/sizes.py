"""How large a proved region is, by lower bounds that the checker proves again.

All with the momenta at rest, so over the other states y, split into plant states and ξ:

* ``volume`` of Ω, in the product of the units of y, and ``domain_share``, its share of the domain;
* ``slice_share``: share of the plant's part of the domain that Ω covers at ξ = ξ*;
* ``plant_share``: the same of {x : V(x, ξ) ≤ c for some ξ in Ω}, where ξ(0) is chosen for x;
* ``reach_<state>``: Ω holds points that far from z̄ in this state, in both directions.
"""

from __future__ import annotations

import math

import numpy as np

from necc_casadi.arrays import Indices, Truth, Vector
from necc_casadi.certificate.prover.arithmetic.intervals import Interval
from necc_casadi.certificate.prover.arithmetic.potential import Potential
from necc_casadi.certificate.prover.region.grid import boxes_of
from necc_casadi.certificate.prover.region.grid_search import ProvedGrid
from necc_casadi.certificate.prover.region.shells import half_axes

__all__ = ["ball_volume", "ellipsoid_sizes", "grid_sizes"]


#: Room for rounding, and for the other arithmetic of the checker.
_EXACT, _EASE = 1 - 1e-12, 0.999


def grid_sizes(
    potential: Potential, found: ProvedGrid, domain: Interval, z_bar: Interval
) -> dict[str, float]:
    """Sizes of the cells that are wholly in {V ≤ c}; slices and shadows from thin boxes."""
    design, step = potential.design, np.array(found.grid.step)
    n = len(potential.active) - design.loop.controller.nc  # of the plant's axes
    inside, side = found.inside, float(np.prod(step[:n]))
    sides = domain.hi - domain.lo
    plant = float(np.prod(sides[:n]))
    sizes = {
        "volume": found.volume,
        "domain_share": found.volume / float(np.prod(sides)),
        "slice_share": _slice(potential, found, n).sum() * side / plant,
        "plant_share": _shadow(potential, found, inside, n).sum() * side / plant,
    }
    index = np.argwhere(inside) if inside.any() else np.zeros((1, len(step)))
    first = np.array(found.grid.first)
    below = z_bar.lo - (first + index.min(0)) * step
    above = (first + index.max(0) + 1) * step - z_bar.hi
    reach = np.maximum(0.0, np.minimum(below, above)) if inside.any() else np.zeros(len(step))
    sizes |= _reach(potential, reach)
    return {key: float(value) * _EXACT for key, value in sizes.items()}


def _slice(potential: Potential, found: ProvedGrid, n: int) -> Truth:
    """Cells of the plant's axes on which V ≤ c at ξ = ξ*."""
    grid, at = found.grid, np.asarray(potential.design.xi_star, float)
    index = np.floor(at / np.array(grid.step[n:])).astype(int) - np.array(grid.first[n:])
    if np.any(index < 0) or np.any(index >= np.array(grid.shape[n:])):
        return np.zeros(grid.shape[:n], dtype=bool)
    layer = int(np.ravel_multi_index(tuple(map(int, index)), grid.shape[n:]))
    columns = found.mask.reshape(-1, int(np.prod(grid.shape[n:])))
    covered: Truth = columns[:, layer].copy()
    rows = np.flatnonzero(covered)
    chosen = np.asarray(rows * columns.shape[1] + layer)
    covered[rows] = _below(potential, found, chosen, n, np.tile(at, (len(rows), 1)))
    return covered.reshape(grid.shape[:n])


def _shadow(potential: Potential, found: ProvedGrid, inside: Truth, n: int) -> Truth:
    """Cells of the plant's axes on which V ≤ c for one ξ: the middle of a cell of the component."""
    grid = found.grid
    seen: Truth = np.asarray(inside.any(axis=tuple(range(n, inside.ndim))))
    open_columns = ~seen.reshape(*seen.shape, *[1] * (inside.ndim - n))
    cells = np.flatnonzero((found.mask & open_columns).ravel())
    middle = boxes_of(grid, cells).mid[:, n:]
    fits = cells[_below(potential, found, cells, n, middle)]
    columns = np.unravel_index(fits, grid.shape)[:n]
    seen = seen.copy()
    seen[columns] = True
    return seen


def _below(potential: Potential, found: ProvedGrid, cells: Indices, n: int, xi: Vector) -> Truth:
    """Whether V ≤ c on the plant's part of each cell at one ξ each, (cells,)."""
    if cells.size == 0:
        return np.zeros(0, dtype=bool)
    boxes = boxes_of(found.grid, cells)
    thin = Interval(np.hstack([boxes.lo[:, :n], xi]), np.hstack([boxes.hi[:, :n], xi]))
    return np.asarray(potential.jet(thin).value.hi <= found.level)


def ellipsoid_sizes(
    potential: Potential, L: Vector, radius: float, domain: Interval, z_bar: Interval
) -> dict[str, float]:
    """Sizes of the ellipsoid ‖Lᵀ(y − z̄)‖ ≤ radius, part of Ω, of its slice and its shadow."""
    d, nc = len(L), potential.design.loop.controller.nc
    n, sides = d - nc, domain.hi - domain.lo
    offset = np.asarray(potential.design.xi_star, float) - z_bar[n:]
    shift = float(np.linalg.norm(np.abs(L[n:, n:].T) @ offset.magnitude))
    inverse = np.asarray(np.linalg.inv(L), float)
    diagonal = np.diagonal(L)
    volume = ball_volume(d) * radius**d / float(np.prod(diagonal))
    within = math.sqrt(max(0.0, radius**2 - shift**2))
    shadow = math.sqrt(max(0.0, float(np.linalg.det(inverse[:, :n].T @ inverse[:, :n]))))
    plant = float(np.prod(sides[:n]))
    sizes = {
        "volume": volume,
        "domain_share": volume / float(np.prod(sides)),
        "slice_share": ball_volume(n) * within**n / float(np.prod(diagonal[:n])) / plant,
        "plant_share": ball_volume(n) * radius**n * shadow / plant,
    }
    sizes |= _reach(potential, half_axes(L, radius))
    return {key: float(value) * _EASE for key, value in sizes.items()}


def ball_volume(d: int) -> float:
    """Volume of the unit ball."""
    return float(math.pi ** (d / 2) / math.gamma(d / 2 + 1))


def _reach(potential: Potential, half: Vector) -> dict[str, float]:
    states = [potential.design.loop.states[i] for i in potential.active]
    return {f"reach_{s}": float(v) for s, v in zip(states, half, strict=True)}
