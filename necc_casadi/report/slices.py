"""Planes of two states: which pair tells most, V in it, and the slice and the shadow of Ω there."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure
from matplotlib.path import Path as Curve

from necc_casadi.arrays import Vector
from necc_casadi.designs.design import Design

__all__ = [
    "Window",
    "domain_window",
    "shadow",
    "slice_boundary",
    "slice_values",
    "telling_pair",
]


_GRID = 121


#: Rays from z̄ along which the shadow is followed; steps to where a quadratic V would reach c.
_RAYS, _STEPS = 96, 12


#: How much farther than a quadratic V a ray is followed; halvings of the last step, of the
#: shortest ray and at most.
_FARTHEST, _HALVINGS, _MOST_HALVINGS = 6, 7, 20


_NEWTON, _BACKTRACKS = 4, 4


#: A step down by less than this share of V is the last one: a line in a figure is no finer.
_FLAT = 1e-6


#: Room around the shadow, as a share of its size; and of a window's border, of its own.
_MARGIN, _ON_BORDER = 0.2, 1e-9


#: Rounds in which rays are added where neighbours end farther apart than this share of the shadow.
_ROUNDS, _APART = 5, 0.06


@dataclass(frozen=True, eq=False)
class Window:
    """A rectangle in the plane of two states."""

    pair: tuple[int, int]  # their indices in z
    lo: Vector  # (2,)
    hi: Vector  # (2,)

    def around(self, curve: Vector) -> Window:
        """The part that holds a curve (k, 2) with some room around it."""
        low, high = curve.min(0), curve.max(0)
        room = _MARGIN * (high - low)
        return self.within(low - room, high + room)

    def within(self, lo: Vector, hi: Vector) -> Window:
        """The part between two corners."""
        return Window(self.pair, np.maximum(self.lo, lo), np.minimum(self.hi, hi))

    def on_border(self, points: Vector) -> npt.NDArray[np.bool_]:
        """Which of the points (k, 2) lie on the border."""
        room = _ON_BORDER * (self.hi - self.lo)
        return np.asarray(((points <= self.lo + room) | (points >= self.hi - room)).any(axis=1))


@lru_cache(maxsize=4)
def telling_pair(design: Design) -> tuple[int, int]:
    """The two plant states that a plot of V should show, in order.

    The state along which the design changed the plant's own energy most, and the stiffest of the
    others, in natural units; a momentum at rest only where there is nothing else.
    """
    n = design.loop.plant.n
    if n == 1:
        return 0, n
    import casadi as ca

    natural = design.natural
    scale = natural.sizes.state[:n] ** 2
    stiffness = scale * np.diag(natural.lyapunov.hessian(natural.z_bar))[:n]
    x = ca.MX.sym("x", n)
    own = ca.Function("own", [x], [ca.hessian(natural.lyapunov.terms.H(x), x)[0]])
    change = stiffness - scale * np.diag(np.asarray(own(natural.z_bar[:n]), float))
    first = int(np.argmax(np.abs(change)))
    resting = design.momenta
    others = sorted((i in resting, -stiffness[i], i) for i in range(n) if i != first)
    second = others[0][-1]
    return min(first, second), max(first, second)


@lru_cache(maxsize=4)
def domain_window(design: Design) -> Window:
    """The domain in the plane of :func:`telling_pair`."""
    pair = telling_pair(design)
    lo, hi = design.domain.lo, design.domain.hi
    return Window(pair, lo[list(pair)], hi[list(pair)])


@lru_cache(maxsize=4)
def slice_values(design: Design, window: Window) -> tuple[Vector, Vector, Vector]:
    """Grid over a window and V − V(z̄) there, the other states at z*; three arrays of one shape.

    Where V is not a finite number it is nan.
    """
    A, B = np.meshgrid(
        *(np.linspace(lo, hi, _GRID) for lo, hi in zip(window.lo, window.hi, strict=True))
    )
    points = np.repeat(design.z_star[None, :], A.size, axis=0)
    points[:, window.pair[0]], points[:, window.pair[1]] = A.ravel(), B.ravel()
    values = design.lyapunov.V(points).reshape(A.shape)
    values[~np.isfinite(values)] = np.nan
    return A, B, values - design.V(design.z_bar)


@lru_cache(maxsize=4)
def slice_boundary(design: Design, level: float, window: Window) -> Vector | None:
    """The closed curve around the part of {V ≤ level} at z̄, the other states at z*, (k, 2).

    Where that goes on beyond the window, the curve follows the border; None: z̄ is not in sight.
    """
    A, B, values = slice_values(design, window)
    middle, height = design.z_bar[list(window.pair)], level - design.V(design.z_bar)
    outside = 2 * abs(height) or 1.0
    walled = np.pad(np.where(np.isfinite(values), values, outside), 1, constant_values=outside)
    a, b = np.pad(A[0], 1, mode="edge"), np.pad(B[:, 0], 1, mode="edge")
    lines = Figure().add_subplot().contour(a, b, walled, levels=[height])
    for segment in lines.allsegs[0]:
        curve = np.asarray(segment, float)
        if len(curve) > 3 and Curve(curve).contains_point((middle[0], middle[1])):
            return curve
    return None


def shadow(design: Design, level: float, window: Window) -> Vector:
    """Where Ω lies in the plane, whatever the other states, (k, 2): min V ≤ level over them.

    Followed along rays from z̄ to where the minimum first exceeds the level, or to the window's
    edge, by Newton's method from the minimum before: computed, not proved.
    """
    angle = np.linspace(0, 2 * np.pi, _RAYS, endpoint=False)
    circle, box = np.stack([np.cos(angle), np.sin(angle)]), (window.lo, window.hi)
    pair = list(window.pair)
    edge = ray_ends(design, level, pair, circle, box)
    for _ in range(_ROUNDS):  # where V bends unevenly, most rays end close together
        after = np.roll(edge, -1, axis=0)
        far = (np.abs(after - edge) / np.ptp(edge, axis=0)).max(axis=1) > _APART
        if not far.any():
            break
        towards = 0.5 * (edge + after)[far] - design.z_bar[pair]
        more = ray_ends(design, level, pair, _directions(design, pair, towards), box)
        edge = np.insert(edge, np.flatnonzero(far) + 1, more, axis=0)
    return edge


def ray_ends(
    design: Design, level: float, shown: list[int], directions: Vector, box: tuple[Vector, Vector]
) -> Vector:
    """Where rays from z̄ leave Ω in the states `shown`, whatever the others, (rays, shown).

    Parameters
    ----------
    design
        The design.
    level
        Ω = {V ≤ level}, near z̄.
    shown
        Indices of states in z.
    directions
        Of the rays, of length 1 in units in which V rises alike in all of them, (shown, rays).
    box
        Least and greatest values of these states, where rays end at the latest.
    """
    units, (lo, hi) = design.units, box
    size = units.state[shown]
    ends = _followed(
        design.natural, level / units.energy, shown, directions, (lo / size, hi / size)
    )
    return ends * size


def _directions(design: Design, shown: list[int], towards: Vector) -> Vector:
    """Directions of :func:`ray_ends`, (shown, rays), along steps (rays, shown) from z̄."""
    natural = design.natural
    rest = [i for i in range(len(natural.z_bar)) if i not in shown]
    steps = (towards / design.units.state[shown]).T
    along = np.linalg.solve(_unit_rise(natural, shown, rest), steps)
    return np.asarray(along / np.linalg.norm(along, axis=0), float)


def _followed(
    design: Design, level: float, shown: list[int], directions: Vector, box: tuple[Vector, Vector]
) -> Vector:
    """Ends of rays in the states `shown`, (rays, shown), with directions (shown, rays) of length 1.

    Lengths are measured such that the least V over the other states rises as ½r² near z̄.
    """
    count = directions.shape[1]
    rest = [i for i in range(len(design.z_bar)) if i not in shown]
    rays, start = _unit_rise(design, shown, rest) @ directions, design.z_bar[shown][:, None]
    lo, hi = box[0][:, None], box[1][:, None]
    rise = max(0.0, level - design.V(design.z_bar))
    step = float(np.sqrt(2 * rise)) / _STEPS
    points = np.repeat(design.z_bar[:, None], count, axis=1)
    radius = np.zeros(count)

    def advance(step: float, moving: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
        """Move rays on where that stays inside; which did."""
        trial = points.copy()
        trial[shown] = start + (radius + step) * rays
        trial = _lowest(design, trial, rest)
        values = design.lyapunov.V(trial.T)
        seen = (trial[shown] >= lo) & (trial[shown] <= hi)
        moved: npt.NDArray[np.bool_] = moving & seen.all(0) & (values <= level)
        points[:, moved] = trial[:, moved]
        radius[moved] += step
        return moved

    every = np.full(count, True)
    moving = every
    for _ in range(_FARTHEST * _STEPS):
        moving = advance(step, moving)
        if not moving.any():
            break
    for halving in range(_MOST_HALVINGS):
        if halving >= _HALVINGS and step < radius.min() / 2**_HALVINGS:
            break  # a share of each ray: beside a pole some are very short
        step /= 2
        advance(step, every)
    return np.asarray((start + radius * rays).T, float)


def _unit_rise(design: Design, shown: list[int], rest: list[int]) -> Vector:
    """T with min V over `rest` ≈ V(z̄) + ½|v|² at z̄ + Tv in the states `shown`."""
    hessian = design.lyapunov.hessian(design.z_bar)
    coupling = hessian[np.ix_(rest, shown)]
    follow = np.linalg.solve(hessian[np.ix_(rest, rest)], coupling)
    reduced = hessian[np.ix_(shown, shown)] - coupling.T @ follow
    return np.asarray(np.linalg.inv(np.linalg.cholesky(reduced)).T, float)


def _lowest(design: Design, points: Vector, rest: list[int]) -> Vector:
    """Points (n + nc, B) moved down V along the states `rest`: Newton's method, never uphill."""
    V, count = design.lyapunov, points.shape[1]
    values = V.V(points.T)
    for _ in range(_NEWTON if rest else 0):
        g = V.gradient(points.T)[:, rest]
        hessian = V.hessian(points.T)[:, rest][:, :, rest]
        defined = np.isfinite(hessian).all(axis=(1, 2), keepdims=True)  # none at a pole
        bends, axes = np.linalg.eigh(np.where(defined, hessian, np.eye(len(rest))))
        bends = np.maximum(np.abs(bends), 1e-6)  # downhill where V is not convex, too
        move = -np.einsum("bij,bj->bi", axes, np.einsum("bji,bj->bi", axes, g) / bends)
        size, before = np.ones(count), values
        for _ in range(_BACKTRACKS):
            trial = points.copy()
            trial[rest] += (size[:, None] * move).T
            found = V.V(trial.T)
            better = found < values
            points = np.where(better, trial, points)
            values = np.where(better, found, values)
            size = np.where(better, 0.0, size / 2)
            if better.all():
                break
        if not np.any(before - values > _FLAT * np.abs(values)):
            break
    return points
