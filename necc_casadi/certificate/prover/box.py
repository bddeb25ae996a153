"""Boxes of (e, ξ̃) around rest that solutions do not leave, below a level, searched and proved.

On the sides of the box an energy E(e, ξ̃; θ) is above the level c; on each cell it is, or something
else holds that makes it fall. θ are parameters within ranges, more axes of the cells.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import reduce
from itertools import product

import numpy as np

from necc_casadi.arrays import Truth, Vector
from necc_casadi.certificate.prover.arithmetic.boxes import subdivide
from necc_casadi.certificate.prover.arithmetic.intervals import Interval, concatenate, point, stack
from necc_casadi.designs.design import Design

__all__ = ["BoxProof", "Terms", "beside", "halved", "searched"]


#: Half widths of the box that are tried, in natural units, widest first, and those of ξ̃ over e.
_WIDTHS, _ASPECTS = 2.0 ** np.arange(2.0, -5.5, -0.5), (1.0, 0.5)


#: Points of the sides and of the inside at which a box is tried; boxes that are then proved.
_SIDE, _INSIDE, _TRIED = 60, 200, 4


#: Of the least E_W that is seen at points of the sides; there may be less between them.
_SHARES = (0.97, 0.9, 0.8, 0.65, 0.5, 0.3, 0.15)


#: First cells of the box together, cells at most, rounds of halving.
_CELLS, _MOST_CELLS, _ROUNDS = 256, 20_000, 20


#: Of the level that is proved: what is claimed, so that other arithmetic can confirm it.
_CLAIMED = 0.98


#: Cells at once.
_BATCH = 1024


#: Of boxes.
_Test = Callable[[Interval], Truth]


#: Parameters of which all ends are tried together.
_CORNERS = 4


class Terms(ABC):
    """An energy over boxes (B, 2m + parameters) of (e, ξ̃, θ), natural units but for θ."""

    design: Design  # in natural units
    m: int
    q_star: Vector  # (m,)
    theta: Interval  # ranges, (parameters,)

    @abstractmethod
    def energy(self, Z: Interval) -> Interval:
        """E over boxes, (B,)."""

    @abstractmethod
    def has_mass(self, Z: Interval) -> Truth:
        """Whether M ≻ 0 on boxes, (B,): only then is E a bound of the whole energy."""

    @abstractmethod
    def falls(self, Z: Interval) -> Truth:
        """Whether what has to hold below the level does, (B,)."""

    @property
    def corners(self) -> Interval:
        """What of θ is enough, (count, parameters): its ends where all is affine in it."""
        return self.theta[None]

    @property
    def rests(self) -> tuple[Vector, Vector]:
        """Least and greatest coordinates at which it may be at rest, (m,) each."""
        return self.q_star, self.q_star

    def ceiling(self, Z: Interval) -> Vector:
        """Below this level no momentum leaves the bounds that the model names, on boxes, (B,)."""
        return np.full(Z.shape[0], np.inf)


@dataclass(frozen=True, eq=False)
class BoxProof:
    """A box of (e, ξ̃) and a level, in natural units."""

    half_widths: Vector  # (2m,)
    level: float


def searched(terms: Terms) -> BoxProof | None:
    """The first box that is proved, below the level of points and then lower."""
    boxes = [(half, level, _falls_in(terms, half)) for half, level in _promising(terms)[:_TRIED]]
    for share, (half, level, falls) in product(_SHARES, boxes):
        closed = _is_closed(terms, half, share * level)
        if closed and (falls or _falls_below(terms, half, share * level)):
            return BoxProof(half, _CLAIMED * share * level)
    return None


def _promising(terms: Terms) -> list[tuple[Vector, float]]:
    """Boxes in which S ≻ 0 is seen where E_W is below its least on the sides; this; best first."""
    d, rng = 2 * terms.m, np.random.default_rng(0)
    inside = np.vstack([np.zeros(d), rng.uniform(-1, 1, (_INSIDE, d))])
    sides = rng.uniform(-1, 1, (_SIDE * d, d))
    rows = np.arange(len(sides))
    sides[rows, rows % d] = np.where(rows // d % 2, 1.0, -1.0)
    corners = np.array(list(product((-1.0, 0.0, 1.0), repeat=d)))
    sides = np.concatenate([sides, corners[np.abs(corners).max(axis=1) == 1]])
    inside, sides = (_with_parameters(terms, points) for points in (inside, sides))
    found = []
    for width, aspect in product(_WIDTHS, _ASPECTS):
        half = np.concatenate([np.full(terms.m, width), np.full(terms.m, width * aspect)])
        scale = np.concatenate([half, np.ones(len(terms.theta.lo))])
        if not _is_within(terms, half):
            continue
        least = float(terms.energy(point(sides * scale)).lo.min())
        if not (np.isfinite(least) and least > 0):
            continue
        Z = inside * scale
        if not np.all(terms.has_mass(point(Z))):
            continue
        level = min(least, float(terms.ceiling(point(Z)).min()))
        if not level > 0:
            continue
        below = terms.energy(point(Z)).lo <= level
        if np.all(terms.falls(point(Z[below]))):
            found.append((level * float(below.mean() * half.prod()), half, level))
    return [(half, level) for _, half, level in sorted(found, key=lambda entry: -entry[0])]


def _with_parameters(terms: Terms, points: Vector) -> Vector:
    """Each point with θ in the middle of its ranges, at a corner or anywhere in them."""
    lo, hi = terms.theta.lo, terms.theta.hi
    if not lo.size:
        return points
    shares = [*product((0.0, 1.0), repeat=min(len(lo), _CORNERS)), *[()] * 2]
    rng, found = np.random.default_rng(2), []
    for share in shares:
        place = rng.uniform(size=(len(points), len(lo)))
        place[:, : len(share)] = share
        found.append(np.hstack([points, lo + (hi - lo) * place]))
    return np.concatenate(found)


def _is_within(terms: Terms, half: Vector) -> bool:
    """Whether the box keeps the bounds that the model names."""
    loop, k = terms.design.loop, terms.m
    low, high = (np.concatenate([side, terms.design.xi_star]) for side in terms.rests)
    names = (*loop.plant.states[:k], *loop.controller.states)
    for name, least, most, reach in zip(names, low, high, half, strict=True):
        if name in loop.plant.domain:
            lo, hi = (float(v) for v in loop.plant.domain[name])
            if not (lo < least - reach and most + reach < hi):
                return False
    return True


def _is_closed(terms: Terms, half: Vector, level: float) -> bool:
    """E_W > c on every side."""
    d, size = len(half), _sizes(terms, half)
    parts = max(2, round(_CELLS ** (1 / d)))
    for axis, side in product(range(d), (-1.0, 1.0)):
        lo, hi = -half.copy(), half.copy()
        lo[axis] = hi[axis] = side * half[axis]
        kept = [i for i in range(d) if i != axis]
        cut = subdivide(Interval(lo[kept], hi[kept]), parts)
        face = [cut[:, kept.index(i)] if i != axis else point(np.full(cut.shape[0], lo[axis]))
                for i in range(d)]  # fmt: skip
        if not _holds_on(_over_all(terms, stack(face)), size, lambda Z: terms.energy(Z).lo > level):
            return False
    return True


def _falls_in(terms: Terms, half: Vector) -> bool:
    """What has to hold below a level does in all of the box, whatever the level.

    It depends little on ξ̃, which is not cut. Bounds of momenta depend on the level.
    """
    m, size = terms.m, _sizes(terms, half)
    size[m : 2 * m] = np.inf
    cells = subdivide(Interval(-half[:m], half[:m]), max(2, round(_CELLS ** (1 / m))))
    reach = np.broadcast_to(half[m:], (cells.shape[0], m))
    cells = _over_all(terms, beside(cells, Interval(-reach, reach)))
    bounded = bool(np.isfinite(terms.ceiling(cells[:1])).any())
    return not bounded and _holds_on(cells, size, terms.falls, _MOST_CELLS // 4)


def _falls_below(terms: Terms, half: Vector, level: float) -> bool:
    """On each cell M ≻ 0, and E_W > c, or S ≻ 0 and every momentum within its bounds."""
    parts = max(2, round(_CELLS ** (1 / len(half))))
    cells = _over_all(terms, subdivide(Interval(-half, half), parts))
    return _holds_on(cells, _sizes(terms, half), lambda Z: _settled(terms, Z, level))


def _sizes(terms: Terms, half: Vector) -> Vector:
    return np.concatenate([half, np.maximum(terms.theta.rad, np.finfo(float).tiny)])


def _over_all(terms: Terms, Z: Interval) -> Interval:
    """Boxes of (e, ξ̃) with all θ that have to be looked at."""
    theta, boxes = terms.corners, Z.shape[0]
    lo, hi = (np.repeat(side, boxes, axis=0) for side in (theta.lo, theta.hi))
    return beside(reduce(concatenate, [Z] * theta.shape[0]), Interval(lo, hi))


def _settled(terms: Terms, Z: Interval, level: float) -> Truth:
    high: Truth = np.asarray((terms.energy(Z).lo > level) & terms.has_mass(Z))
    result = high.copy()
    if not high.all():
        low = Z[~high]
        result[~high] = terms.falls(low) & (level < terms.ceiling(low))
    return result


def _holds_on(Z: Interval, size: Vector, test: _Test, most: int = _MOST_CELLS) -> bool:
    """Whether a test holds on every cell; cells are halved where it does not, but at the middle."""
    for _ in range(_ROUNDS):
        if Z.shape[0] > most:
            return False
        left = Z[~_tested(Z, test)]
        if left.shape[0] == 0:
            return True
        if not _tested(point(left.mid), test).all():
            return False
        Z = halved(left, size)
    return False


def _tested(Z: Interval, test: _Test) -> Truth:
    parts = np.array_split(np.arange(Z.shape[0]), -(-Z.shape[0] // _BATCH))
    return np.concatenate([test(Z[rows]) for rows in parts])


def halved(Z: Interval, half: Vector) -> Interval:
    """Each box (B, d) in two, across its longest side by these sizes (d,)."""
    axis = ((Z.hi - Z.lo) / half).argmax(axis=1)
    rows, middle = np.arange(Z.shape[0]), Z.mid
    upper, lower = Z.lo.copy(), Z.hi.copy()
    cut = middle[rows, axis]
    lower[rows, axis], upper[rows, axis] = cut, cut
    return concatenate(Interval(Z.lo, lower), Interval(upper, Z.hi))


def beside(a: Interval, b: Interval) -> Interval:
    """Columns of both."""
    lo, hi = (np.concatenate(sides, axis=1) for sides in ((a.lo, b.lo), (a.hi, b.hi)))
    return Interval(lo, hi)
