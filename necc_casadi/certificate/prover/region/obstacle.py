"""What ends the region, found in floating point: a guide for the proof, which then stands below it.

On a grid of s, w is flooded from s̄; a critical point of w that is reached at its own level is a
pass, a state of the grid at which the model is not defined ends the region where it is first
reached, and so does a bound of the user's own domain. Where none is met, the box grows.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from necc_casadi.arrays import Truth, Vector
from necc_casadi.certificate.claims.regions import ObstacleKind
from necc_casadi.certificate.prover.arithmetic.intervals import Interval, matmul, point
from necc_casadi.certificate.prover.arithmetic.potential import Potential
from necc_casadi.certificate.prover.region.landscape import Landscape, Minima

__all__ = ["NEAR_ENOUGH", "Obstacle", "Search", "judged", "search"]

#: A proof that ends lower than this share of the obstacle's height ends at its own arithmetic.
NEAR_ENOUGH = 0.95
#: Half-width of the box in which a critical point of V is proved, against the state's magnitude.
_TIGHT = 1e-8
#: Nodes per axis of the search.
_NODES = {0: 1, 1: 801, 2: 61, 3: 25}
#: A Newton step of at most so many steps of the grid makes a node a start for a critical point.
_SHORT, _NEWTON = 2.0, 14
#: Two critical points this close, in steps of the grid, are one; slopes this small are zero.
_SAME, _FLAT = 1e-3, 1e-8
#: Room around the component, in steps of the grid and as a share of its extent.
_ROOM, _ROOM_SHARE = 1.5, 0.05


@dataclass(frozen=True, eq=False)
class Obstacle:
    """Where the component of {w ≤ c} around s̄ first meets something real."""

    kind: ObstacleKind
    level: float  # of V
    z: Vector  # (N,)


@dataclass(frozen=True, eq=False)
class Search:
    """Nodes of a grid, the level at which each is reached from s̄, and the critical points of w."""

    landscape: Landscape
    lo: Vector  # (ds,)
    hi: Vector
    shape: tuple[int, ...]
    nodes: Vector  # (B, ds)
    minima: Minima
    levels: Vector  # (B,) the lowest c at which the component of {w ≤ c} may hold the node
    points: tuple[tuple[Vector, Vector, float, int], ...]  # (s, e, w, index) of critical points

    @property
    def step(self) -> Vector:
        """Width of the grid's cells, (ds,)."""
        return np.asarray((self.hi - self.lo) / (np.array(self.shape, float) - 1), float)

    def first(self, s_bar: Vector) -> Obstacle | None:
        """The lowest obstacle in the box; None where none is met."""
        found = [p for p in (self._pass(s_bar), self._pole()) if p is not None]
        return min(found, key=lambda obstacle: obstacle.level, default=None)

    def _pass(self, s_bar: Vector) -> Obstacle | None:
        """The lowest critical point that is no strict minimum and is reached at its own level."""
        best: Obstacle | None = None
        defined = self.minima.w[np.isfinite(self.minima.w)]
        rise = float(defined.max() - defined.min())
        for s, e, w, index in self.points:
            near = (np.abs(self.nodes - s) <= 2.01 * self.step).all(1)
            reached = float(np.min(self.levels[near], initial=np.inf))
            slack = 1e-9 * abs(rise) + 0.02 * max(0.0, w - float(defined.min()))
            far = bool((np.abs(s - s_bar) > _SAME * self.step).any())
            if index > 0 and far and reached <= w + slack and (best is None or w < best.level):
                best = Obstacle("critical_point", w, self.place(s, e))
        return best

    def _pole(self) -> Obstacle | None:
        """Where the flood first touches a node at which the model is not defined."""
        undefined = ~np.isfinite(self.minima.w)
        if not undefined.any():
            return None
        beside = _dilated(undefined.reshape(self.shape)).ravel() & ~undefined
        levels = np.where(beside, self.levels, np.inf)
        at = int(np.argmin(levels))
        if not np.isfinite(levels[at]):
            return None
        return self.node("singularity", at)

    def place(self, s: Vector, e: Vector) -> Vector:
        """The state z (N,) of s and e, the momenta at rest."""
        place: Vector = self.landscape.states(s[None], e[None])[0]
        return place

    def node(self, kind: ObstacleKind, at: int) -> Obstacle:
        """A node as an obstacle."""
        place = self.place(self.nodes[at], self.minima.e[at])
        return Obstacle(kind, float(self.minima.w[at]), place)

    def open_sides(self, level: float) -> tuple[Truth, Truth]:
        """Whether the component below `level` touches the lower and the upper side, (ds,)."""
        inside = self.levels <= level
        tiny = 1e-9 * (self.hi - self.lo)
        low = (inside[:, None] & (self.nodes <= self.lo + tiny)).any(0)
        high = (inside[:, None] & (self.nodes >= self.hi - tiny)).any(0)
        return np.asarray(low), np.asarray(high)

    def around(self, level: float) -> tuple[Vector, Vector]:
        """A box with room around the component below `level`."""
        inside = self.nodes[self.levels <= level]
        low, high = inside.min(0), inside.max(0)
        room = np.maximum(_ROOM * self.step, _ROOM_SHARE * (high - low))
        return low - room, high + room


def judged(potential: Potential, obstacle: Obstacle) -> Obstacle:
    """The obstacle; a critical point only where one is proved to be there."""
    if obstacle.kind != "critical_point":
        return obstacle
    y = obstacle.z[list(potential.active)]
    half = _TIGHT * (1 + np.abs(y))
    jet = potential.jet(Interval(y - half, y + half)[None])
    slope = potential.jet(point(y)[None]).grad[0]
    H = jet.hess[0]
    if not (np.isfinite(H.mid).all() and np.linalg.det(H.mid) != 0):
        return replace(obstacle, kind="arithmetic")
    T = np.asarray(np.linalg.inv(H.mid), float)
    step = matmul(T, slope[:, None])[:, 0]
    spread = matmul(np.eye(len(y)) - matmul(T, H), Interval(-half, half)[:, None])[:, 0]
    inside = bool(((spread - step).magnitude < half).all())
    return obstacle if inside else replace(obstacle, kind="arithmetic")


def search(
    landscape: Landscape,
    lo: Vector,
    hi: Vector,
    s_bar: Vector,
    defined: Callable[[Vector, Vector, Vector], Truth] | None = None,
) -> Search:
    """Flood w from s̄ on a grid of the box, and find its critical points there.

    `defined` tells nodes and minimisers near which, within some steps, the loop has no pole.
    """
    count = _NODES[len(lo)]
    axes = [np.linspace(a, b, count) for a, b in zip(lo, hi, strict=True)]
    mesh = [v.ravel() for v in np.meshgrid(*axes, indexing="ij")]
    nodes = np.stack(mesh, -1) if mesh else np.zeros((1, 0))
    minima = landscape.minima(nodes)
    if defined is not None:
        near = defined(nodes, minima.e, (hi - lo) / max(1, count - 1))
        minima = replace(minima, w=np.where(near, minima.w, np.nan))
    shape = (count,) * len(lo)
    start = int(np.argmin((((nodes - s_bar) / (hi - lo)) ** 2).sum(1)))
    w = np.where(np.isfinite(minima.w), minima.w, np.inf)
    levels = _flooded(w, shape, start)
    points = _critical_points(landscape, minima, nodes, lo, hi)
    return Search(landscape, lo, hi, shape, nodes, minima, levels, points)


def _flooded(w: Vector, shape: tuple[int, ...], start: int) -> Vector:
    """The least over all paths from `start` of the largest w on the way, for every node."""
    levels = np.full(w.size, np.inf)
    levels[start] = w[start]
    queue = [(float(w[start]), start)]
    strides = [int(np.prod(shape[axis + 1 :])) for axis in range(len(shape))]
    heights = w.tolist()
    while queue:
        level, i = heapq.heappop(queue)
        if level > levels[i]:
            continue
        for count, stride in zip(shape, strides, strict=True):
            k = i // stride % count
            for j in ([i - stride] if k > 0 else []) + ([i + stride] if k < count - 1 else []):
                reached = max(level, heights[j])
                if reached < levels[j]:
                    levels[j] = reached
                    heapq.heappush(queue, (reached, j))
    return levels


def _critical_points(
    landscape: Landscape, minima: Minima, nodes: Vector, lo: Vector, hi: Vector
) -> tuple[tuple[Vector, Vector, float, int], ...]:
    """(s, ε, w, index) of critical points of w, by Newton's method from every near node."""
    if not len(lo):
        return ()
    step = (hi - lo) / (_NODES[len(lo)] - 1)
    s = nodes[np.flatnonzero((np.abs(_newton(minima)) <= _SHORT * step).all(1))]
    for _ in range(_NEWTON):
        if not len(s):
            return ()
        move = _newton(landscape.minima(s))
        length = np.abs(move / step).max(1)
        s = s + move * np.minimum(1.0, 2.0 / np.maximum(length, 1e-300))[:, None]
        s = s[np.isfinite(s).all(1)]
    found = landscape.minima(s)
    flat = np.abs(found.grad * step).max(1) <= _FLAT * np.nanmax(np.abs(minima.grad * step))
    inside = ((s >= lo - step) & (s <= hi + step)).all(1)
    points: list[tuple[Vector, Vector, float, int]] = []
    for k in np.flatnonzero(flat & inside):
        if all((np.abs(s[k] - p[0]) > _SAME * step).any() for p in points):
            # a fold has nullity but no index: it stops a flood as a pass does
            scaled = found.hess[k] * np.outer(step, step)
            least = np.linalg.eigvalsh(scaled)
            index = int((least < 1e-6 * np.abs(least).max()).sum())
            points.append((s[k], found.e[k], float(found.w[k]), index))
    return tuple(sorted(points, key=lambda p: p[2]))


def _newton(minima: Minima) -> Vector:
    """Newton's steps to where ∇w vanishes, (B, ds); NaN where there is none."""
    usable = np.isfinite(minima.hess).all((1, 2)) & np.isfinite(minima.grad).all(1)
    steps = np.full(minima.grad.shape, np.nan)
    inverse = np.linalg.pinv(minima.hess[usable], hermitian=True)
    steps[usable] = -(inverse @ minima.grad[usable][..., None])[..., 0]
    return steps


def _dilated(mask: np.ndarray) -> np.ndarray:
    """Marked nodes and all that touch one."""
    padded = np.pad(mask, 1)
    result = np.zeros_like(mask)
    for shift in product((0, 1, 2), repeat=mask.ndim):
        result |= padded[tuple(slice(k, k + n) for k, n in zip(shift, mask.shape, strict=True))]
    return result
