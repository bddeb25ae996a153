"""Region of attraction on a grid of cells: critical points excluded, then flooded from z̄.

Every cell holds a lower bound of V; critical points are excluded cell by cell, or, around z̄, by
∇²V ≻ 0 on a block of cells. Flooding from z̄ gives each cell the lowest level at which the
connected component of {V ≤ c} may reach it. The largest c is just below the first level at which
a reached cell lies on the boundary or may hold another critical point.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass
from itertools import product

import numpy as np

from necc_casadi.arrays import Indices, Truth, Vector
from necc_casadi.certificate.claims.regions import Block, Grid
from necc_casadi.certificate.prover.arithmetic.definite import positive_definite
from necc_casadi.certificate.prover.arithmetic.intervals import Interval, matmul, point
from necc_casadi.certificate.prover.arithmetic.jets import Jet
from necc_casadi.certificate.prover.arithmetic.potential import Potential

__all__ = ["Flood", "boundary", "boxes_of", "cells_met", "dilated", "flood", "make_grid", "spread"]


#: Pieces per axis into which a cell that limits the region is cut.
_PIECES = {1: 16, 2: 8, 3: 4}  # powers of two: cut exactly


#: Rounds in which the cells that limit the region are cut.
_ROUNDS = 3


#: Cells that are added around z̄'s block where V is convex there too.
_ROOM = 2


def boxes_of(grid: Grid, cells: Indices) -> Interval:
    """Cells given by flat index as boxes, (cells, d)."""
    index = np.stack(np.unravel_index(cells, grid.shape), -1) + np.array(grid.first)
    step = np.array(grid.step)
    return Interval(index * step, (index + 1) * step)


def cells_met(grid: Grid, box: Interval) -> Indices:
    """Flat indices of the cells that a small box (d,) meets; empty if it leaves the grid."""
    first, step = np.array(grid.first), np.array(grid.step)
    low = np.floor(box.lo / step).astype(int) - first
    high = np.floor(box.hi / step).astype(int) - first
    if np.any(low < 0) or np.any(high >= np.array(grid.shape)):
        return np.array([], dtype=int)
    ranges = [range(a, b + 1) for a, b in zip(low, high, strict=True)]
    return np.array([np.ravel_multi_index(k, grid.shape) for k in product(*ranges)])


def make_grid(lo: Vector, hi: Vector, cells: int) -> Grid:
    """A grid inside the box [lo, hi] with about `cells` cells, as cubic as powers of two allow."""
    per_axis = cells ** (1 / lo.size)
    step = 2.0 ** np.round(np.log2((hi - lo) / per_axis))
    first = np.ceil(lo / step).astype(int)
    shape = np.floor(hi / step).astype(int) - first
    return Grid(tuple(map(int, first)), tuple(map(int, shape)), tuple(map(float, step)))


@dataclass(frozen=True, eq=False)
class Flood:
    """The outcome of :func:`flood`."""

    level: float  # c, just below what limits it
    levels: Vector  # grid.shape, the level at which each cell is reached
    upper: Vector  # grid.shape, upper bound of V on each cell
    convex_block: Block  # of cells around z̄ with ∇²V ≻ 0
    limiting: int  # flat index of the cell that limits c
    at_boundary: bool

    @property
    def cells(self) -> Truth:
        """The cells of the component, grid.shape."""
        return np.asarray(self.levels <= self.level)


def flood(potential: Potential, grid: Grid, z_bar: Interval) -> Flood | None:
    """The largest level on `grid`, or None where the surroundings of z̄ cannot be settled."""
    start = cells_met(grid, z_bar)
    if start.size == 0:
        return None
    with np.errstate(all="ignore"):
        if not positive_definite(potential.lower_hessian(boxes_of(grid, start))).all():
            return None
        boxes = boxes_of(grid, np.arange(grid.size))
        jet = potential.jet(boxes)
        low = _finite_lower(jet)
        open_cells = ~_excludes_zero(potential, boxes, jet)
        near = _undecided_block(grid, open_cells.reshape(grid.shape), start)
        for room in (_ROOM, 0):  # cells beside z̄'s are hard to settle in other arithmetic
            wide = _widened(grid, near, room)
            block = np.flatnonzero(_marked(grid, wide))
            if positive_definite(potential.lower_hessian(boxes_of(grid, block))).all():
                break
        else:
            return None
        open_cells[block] = False
        faces = _faces(potential, grid)
        limit = np.minimum(faces, np.where(open_cells, low, np.inf))
        for _ in range(_ROUNDS):
            level, levels, at = spread(grid, low, limit, start)
            worst = np.flatnonzero(open_cells & (levels.ravel() <= level) & (limit < faces))
            if worst.size == 0 or faces[at] <= limit[at]:
                break
            limit[worst] = np.minimum(faces[worst], _refined(potential, grid, worst))
        level, levels, at = spread(grid, low, limit, start)
    return Flood(
        level, levels, jet.value.hi.reshape(grid.shape), wide, at, bool(faces[at] <= limit[at])
    )


def _excludes_zero(potential: Potential, boxes: Interval, jet: Jet) -> Truth:
    """Boxes on which V is defined and ∇V cannot vanish, (B,).

    Where every component of ∇V may vanish, its components along the eigenvectors T of ∇²V are
    bounded by T∇V(middle) + T∇²V · (box − middle): in a narrow valley that is not along an axis
    only these tell that V falls along it.
    """
    defined = np.isfinite(jet.value.lo) & np.isfinite(jet.grad.lo + jet.grad.hi).all(-1)
    excluded: Truth = np.asarray(defined & ((jet.grad.lo > 0) | (jet.grad.hi < 0)).any(-1))
    hess = jet.hess
    usable = defined & ~excluded & np.isfinite(hess.lo + hess.hi).all((-1, -2))
    left = np.flatnonzero(usable)
    if left.size:
        middle, hess = boxes[left].mid, hess[left]
        T = np.swapaxes(np.linalg.eigh(hess.mid + np.swapaxes(hess.mid, -1, -2))[1], -1, -2)
        steps = (boxes[left] - middle)[..., None]
        slope = potential.jet(point(middle)).grad[..., None]
        turned = (matmul(T, slope) + matmul(matmul(T, hess), steps))[..., 0]
        excluded[left] = ((turned.lo > 0) | (turned.hi < 0)).any(-1)
    return excluded


def _finite_lower(jet: Jet) -> Vector:
    return np.where(np.isfinite(jet.value.lo), jet.value.lo, -np.inf)


def _undecided_block(grid: Grid, undecided: Truth, start: Indices) -> Block:
    """The block around the undecided cells that touch z̄'s."""
    near = np.zeros(grid.shape, dtype=bool)
    near.ravel()[start] = True
    while True:
        grown = near | (undecided & dilated(near))
        if (grown == near).all():
            break
        near = grown
    index = np.argwhere(near)
    return tuple(map(int, index.min(0))), tuple(map(int, index.max(0)))


def _widened(grid: Grid, block: Block, room: int) -> Block:
    """The block with `room` more cells on every side, as far as the grid goes."""
    low, high = block
    last = (n - 1 for n in grid.shape)
    return (
        tuple(max(0, k - room) for k in low),
        tuple(min(n, k + room) for k, n in zip(high, last, strict=True)),
    )


def dilated(mask: Truth) -> Truth:
    """Marked cells and all that touch one."""
    result = mask.copy()
    for axis in range(mask.ndim):
        forward = np.moveaxis(result, axis, 0).copy()
        grown = np.moveaxis(result, axis, 0)
        grown[1:] |= forward[:-1]
        grown[:-1] |= forward[1:]
    return result


def _marked(grid: Grid, block: Block) -> Truth:
    mask = np.zeros(grid.shape, dtype=bool)
    mask[tuple(slice(a, b + 1) for a, b in zip(*block, strict=True))] = True
    return mask


def boundary(grid: Grid) -> Truth:
    """Which cells lie on the boundary of the grid, (size,)."""
    mask = np.ones(grid.shape, dtype=bool)
    mask[(slice(1, -1),) * mask.ndim] = False
    return mask.ravel()


def _faces(potential: Potential, grid: Grid) -> Vector:
    """Lower bound of V on the faces that each cell shares with the boundary; +∞ inside."""
    result = np.full(grid.size, np.inf)
    index = np.arange(grid.size).reshape(grid.shape)
    for axis in range(len(grid.shape)):
        for side in (0, -1):
            cells = np.take(index, side, axis).ravel()
            boxes = boxes_of(grid, cells)
            lo, hi = boxes.lo.copy(), boxes.hi.copy()
            (hi if side == 0 else lo)[:, axis] = (lo if side == 0 else hi)[:, axis]
            value = _finite_lower(potential.jet(Interval(lo, hi)))
            result[cells] = np.minimum(result[cells], value)
    return result


def spread(grid: Grid, low: Vector, limit: Vector, start: Indices) -> tuple[float, Vector, int]:
    """Flood in the order of the levels: (c, levels of the cells reached, cell that limits c)."""
    levels = np.full(grid.size, np.inf)
    queue = [(low[i], int(i)) for i in start]
    for level, i in queue:
        levels[i] = level
    heapq.heapify(queue)
    strides = [int(np.prod(grid.shape[axis + 1 :])) for axis in range(len(grid.shape))]
    moves = list(zip(grid.shape, strides, strict=True))
    ceiling, at = np.inf, int(start[0])
    bottom, bound = low.tolist(), limit.tolist()
    while queue and queue[0][0] < ceiling:
        level, i = heapq.heappop(queue)
        if level > levels[i]:
            continue
        if max(level, bound[i]) < ceiling:  # below its level the cell is not reached at all
            ceiling, at = max(level, bound[i]), i
        for count, stride in moves:
            k = i // stride % count
            for j in ([i - stride] if k > 0 else []) + ([i + stride] if k < count - 1 else []):
                reached = max(level, bottom[j])
                if reached < levels[j]:
                    levels[j] = reached
                    heapq.heappush(queue, (reached, j))
    return float(np.nextafter(ceiling, -np.inf)), levels.reshape(grid.shape), at


def _refined(potential: Potential, grid: Grid, cells: Indices) -> Vector:
    """Lower bound of V where a cell may hold a critical point, after cutting it into pieces."""
    d = len(grid.shape)
    parts = _PIECES[d]
    boxes = boxes_of(grid, cells)
    offsets = np.array(list(product(range(parts), repeat=d)))
    step = np.array(grid.step) / parts
    lo = boxes.lo[:, None] + offsets * step
    pieces = Interval(lo.reshape(-1, d), (lo + step).reshape(-1, d))
    jet = potential.jet(pieces)
    open_pieces = np.where(_excludes_zero(potential, pieces, jet), np.inf, _finite_lower(jet))
    lowest: Vector = open_pieces.reshape(len(cells), -1).min(1)
    return lowest
