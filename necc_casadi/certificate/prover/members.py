"""Regions of a family's members: boxes of parameters ϑ, each with a box of states and a level.

With the momenta p at rest let E(y; ϑ) = V_ϑ(y, 0) − V_ϑ(z*). Where for every ϑ of a box E > h on
the sides of a box B of y around z*, and on each cell of B E > h, or ∂V/∂y ≠ 0, or the cell is in a
core in which ∂²V/∂y² ≻ 0, the set {y in B, V ≤ V(z*) + h} is compact, is not left, and holds one
critical point, z̄(ϑ) (docs/theory.md#families). What lies in the sets of all is marked on cells.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise, product

import numpy as np
import sympy as sp

from necc_casadi.arrays import Truth, Vector
from necc_casadi.certificate.claims.claim import Claim
from necc_casadi.certificate.claims.members import HeldBox, MembersClaim, members
from necc_casadi.certificate.claims.regions import CellBox, Side, numbers, packed
from necc_casadi.certificate.claims.statements import NO_MEMBERS
from necc_casadi.certificate.prover.arithmetic.boxes import matrix_enclosure, subdivide
from necc_casadi.certificate.prover.arithmetic.definite import positive_definite
from necc_casadi.certificate.prover.arithmetic.intervals import Interval, concatenate, point
from necc_casadi.certificate.prover.arithmetic.jets import Jet, coordinates, expression_jets
from necc_casadi.certificate.prover.arithmetic.potential import Potential
from necc_casadi.certificate.prover.arithmetic.smooth import is_smooth_on, written
from necc_casadi.certificate.prover.box import beside, halved
from necc_casadi.certificate.prover.everywhere import Whole
from necc_casadi.designs.family import Family
from necc_casadi.symbolic.floats import to_float

__all__ = ["prove_members"]


#: States that do not rest, at most; sizes of a state that a box of ϑ may move the set-point by.
_MOST_STATES, _MOVED = 3, 0.3


#: Boxes of ϑ at most, and how often one that fails is halved.
_MOST, _HALVINGS = 48, 1


#: Half widths of B that are tried, in sizes, those of ξ over the others, and how many are proved.
_WIDTHS, _ASPECTS, _TRIED = 2.0 ** np.arange(2.5, -4.5, -0.5), (1.0, 0.5), 1


#: Of the least E that is seen on the sides: the levels that are tried. Of a level that is proved:
#: what is claimed, so that other arithmetic confirms it.
_SHARES, _CLAIMED = (0.95, 0.6, 0.3), 0.88


#: Shares of B that are tried for the core.
_CORES = (1.0, 0.7, 0.5, 0.35, 0.25, 0.18, 0.12, 0.08)


#: First cells together, cells at most, rounds of halving, cells at once, points that are seen.
_CELLS, _MOST_CELLS, _ROUNDS, _BATCH, _SEEN = 512, 4_000, 10, 2048, 400


#: Cells of y along each side, by their number, and pieces of ϑ on which they are looked at.
_GRID, _PIECES = {1: 512, 2: 64, 3: 20}, 16


#: Of the distance to a bound of the model, of a level, and of a share: what rounding gets.
_INSIDE, _EASED, _ROUND = 0.98, 0.99, 1e-9


#: Shares of its range by which a set-point is tried to move.
_STEPS = tuple(2.0 ** (-k / 4) for k in range(28))


def prove_members(family: Family, near: Claim) -> Claim:
    """Regions of all members; `near` is the claim that encloses where they rest."""
    found = _proved(family, near)
    if found is None:
        return Claim("members", False, NO_MEMBERS)
    ranges = {p.name: (to_float(p.range[0]), to_float(p.range[1])) for p in family.parameters}
    measured = bool(family.moved.of("uncertain"))
    text = members(ranges, found, family.design.units.energy, measured)
    return Claim("members", True, text, found.data)


def _proved(family: Family, near: Claim) -> MembersClaim | None:
    whole = Whole(family)
    if not near.holds or whole.missing or not whole.has_momenta or whole.follows != "converges":
        return None
    bounded = any(str(s) in whole.minima.design.loop.plant.domain for s in whole.momenta)
    if bounded or not 0 < len(whole.active) <= _MOST_STATES:
        return None
    regions = _Regions(whole, near)
    boxes, left = regions.covered()
    if not boxes:
        return None
    grid, marked, share = regions.common(boxes)
    step = {} if left else regions.step(boxes)
    return MembersClaim(
        family.hash, whole.active, tuple(boxes), tuple(left), grid, marked, share, step
    )


@dataclass(frozen=True, eq=False)
class _Regions:
    """E and its slopes over boxes of y (B, d) and ϑ (B, k), in natural units of the states."""

    whole: Whole
    near: Claim

    # --- enclosures -------------------------------------------------------------------------------

    @cached_property
    def y_star(self) -> Interval:
        """z* in the active states, (d,)."""
        return self.whole.minima.target[list(self.whole.active)]

    @cached_property
    def _networks(self) -> Potential:
        """Hc + K, in the active states."""
        loop = self.whole.minima.design.loop
        resting = tuple(i for i in range(loop.n) if i not in self.whole.active)
        return Potential(self.whole.minima.networks.design, resting)

    @cached_property
    def _own(self) -> sp.Expr:
        """U(y; ϑ) − U(y*; ϑ)."""
        design = self.whole.minima.design
        U = self.whole.potential
        here = dict(zip(design.loop.plant.x, design.x_star, strict=True))
        return sp.expand(U - U.subs(here))

    @cached_property
    def _bottom(self) -> Interval:
        """Hc + K at z*."""
        return self._networks.jet(self.y_star[None]).value[0]

    def jet(self, Y: Interval, theta: Interval) -> Jet:
        """E and its derivatives in (y, ϑ), by mean-value forms about the middles."""
        with np.errstate(all="ignore"):
            both = beside(Y, theta)
            middle, boxes = both.mid, both.shape[0]
            found = self._jet(concatenate(both, point(middle)))
            return found[:boxes].centred(found[boxes:], both - middle)

    def _jet(self, Z: Interval) -> Jet:
        d = len(self.whole.active)
        symbols = (*self.whole.y, *self.whole.family.moved.symbols)
        variables = coordinates(Z)
        (own,) = expression_jets([self._own], dict(zip(symbols, variables, strict=True)))
        net = self._networks.jet(Z[:, :d])
        wide = variables[0] * 0.0 + (-self._bottom)
        for part, kept in ((wide.value, net.value), (wide.grad[:, :d], net.grad),
                           (wide.hess[:, :d, :d], net.hess)):  # fmt: skip
            total = part + kept
            part.lo[...], part.hi[...] = total.lo, total.hi
        return wide + own

    # --- one box of ϑ -----------------------------------------------------------------------------

    def covered(self) -> tuple[list[HeldBox], list[tuple[Side, ...]]]:
        """Boxes of ϑ with regions that are proved, and those without."""
        first = self._first()
        if self._held(first[len(first) // 2]) is None:  # the others are hardly easier
            return [], [_sides(box) for box in first]
        todo = [(box, 0) for box in first]
        boxes: list[HeldBox] = []
        left: list[tuple[Side, ...]] = []
        while todo:
            theta, depth = todo.pop()
            found = self._held(theta)
            if found is not None:
                boxes.append(found)
            elif depth < _HALVINGS and len(boxes) + len(todo) + 2 <= _MOST:
                todo += [(half, depth + 1) for half in _halved(theta, self._moves)]
            else:
                left.append(_sides(theta))
        return boxes, left

    def _first(self) -> list[Interval]:
        """The ranges cut across the set-points."""
        ranges, family = self.whole.minima.ranges, self.whole.family
        units, sizes = family.state_units, self.whole.minima.design.sizes.state
        place = {name: i for i, name in enumerate(family.design.loop.states)}
        edges = []
        for k, p in enumerate(family.parameters):
            count = 1
            if p.kind == "setpoint":
                length = float(ranges.hi[k] - ranges.lo[k]) / units[p.name]
                count = max(1, int(np.ceil(length / (_MOVED * sizes[place[p.name]]))))
            edges.append(np.linspace(ranges.lo[k], ranges.hi[k], count + 1))
        pairs = [list(pairwise(e)) for e in edges]
        cut = list(product(*pairs))
        if len(cut) > _MOST // 2:
            return [ranges]
        return [Interval(*map(np.array, zip(*sides, strict=True))) for sides in cut]

    @cached_property
    def _moves(self) -> Vector:
        """How much each parameter moves the slope at z*, over its range, (k,)."""
        ranges = self.whole.minima.ranges
        effects = []
        for k in range(ranges.shape[0]):
            lo, hi = ranges.mid.copy(), ranges.mid.copy()
            lo[k], hi[k] = ranges.lo[k], ranges.hi[k]
            at_rest = self.jet(self.y_star[None], Interval(lo, hi)[None])
            moved = max(float(v.rad.max()) for v in (at_rest.grad, at_rest.hess))
            effects.append(float(np.nan_to_num(moved, nan=1.0)))
        return np.array(effects) / np.maximum(ranges.rad, np.finfo(float).tiny)

    def _held(self, theta: Interval) -> HeldBox | None:
        """The widest region that is found for all ϑ of a box."""
        for half, least in self._promising(theta)[:_TRIED]:
            if not self._is_defined(half, theta):
                continue
            core = next((s for s in _CORES if self._is_convex(s * half, theta)), None)
            if core is None or not self._holds_minima(core * half, theta):
                continue
            for share in _SHARES:
                if self._is_kept(half, core, share * least, theta):
                    return HeldBox(_sides(theta), numbers(half), core, _CLAIMED * share * least)
        return None

    def _promising(self, theta: Interval) -> list[tuple[Vector, float]]:
        """Half widths and the least E that is seen on their sides, the largest region first."""
        d, rng = len(self.whole.active), np.random.default_rng(0)
        inside, sides = rng.uniform(-1, 1, (2, _SEEN, d))
        rows = np.arange(_SEEN)
        sides[rows, rows % d] = np.where(rows // d % 2, 1.0, -1.0)
        corners = rng.integers(0, 2, (_SEEN, theta.shape[0]))
        at = np.where(corners, theta.hi, theta.lo)
        found = []
        for width, aspect in product(_WIDTHS, _ASPECTS):
            half = self._room(width, aspect, theta)
            if half is None:
                continue
            face, inner = (self._looks(half * shares, at) for shares in (sides, inside))
            least = float(face.min())
            if np.isfinite(face).all() and least > 0:
                found.append((float((inner <= least).mean() * half.prod()), half, least))
        found.sort(key=lambda entry: -entry[0])
        return [(half, least) for _, half, least in found]

    def _looks(self, away: Vector, theta: Vector) -> Vector:
        """E at y* + away (B, d) and ϑ (B, k) in floats: a guide, no bound."""
        family, active = self.whole.family, list(self.whole.active)
        units = family.design.units
        z = np.repeat(family.design.z_star[None], len(away), 0)
        start = z.copy()
        z[:, active] += away * units.state[active]
        V = family.V_function.map(len(away))
        there, rest = (np.asarray(V(at.T, theta.T), float)[0] for at in (z, start))
        return np.asarray((there - rest) / units.energy, float)

    def _room(self, width: float, aspect: float, theta: Interval) -> Vector | None:
        """Half widths that keep the bounds that the model names, wherever the set-point is."""
        design, n = self.whole.minima.design, self.whole.minima.design.loop.plant.n
        active = list(self.whole.active)
        scale = np.array([1.0 if i < n else aspect for i in active])
        half = np.asarray(width * scale * design.sizes.state[active], float)
        shift = self._shift(theta)
        for k, i in enumerate(active):
            name = design.loop.states[i]
            if name in design.loop.plant.domain:
                lo, hi = (float(v) for v in design.loop.plant.domain[name])
                at = self.y_star[k] + (shift[i] if i < n else 0.0)
                half[k] = min(half[k], _INSIDE * (hi - float(at.hi)), _INSIDE * (float(at.lo) - lo))
        return half if (half > 0).all() else None

    def _shift(self, theta: Interval) -> Interval:
        """x*(r) − x*(r₀) over a box of ϑ, (n,)."""
        symbols = list(self.whole.family.moved.symbols)
        return matrix_enclosure(sp.Matrix(self.whole.shift), symbols, theta[None])[0, :, 0]

    def _is_defined(self, half: Vector, theta: Interval) -> bool:
        """Whether all is smooth in the box, and the inertia ≻ 0."""
        design, whole = self.whole.minima.design, self.whole
        lo, hi = (np.zeros(design.loop.n) for _ in range(2))
        lo[list(whole.active)] = self.y_star.lo - half
        hi[list(whole.active)] = self.y_star.hi + half
        resting = [i for i in range(design.loop.n) if i not in whole.active]
        lo[resting], hi[resting] = -np.inf, np.inf
        box = concatenate(Interval(lo, hi), theta)
        symbols = (*design.loop.z, *whole.family.moved.symbols)
        if not is_smooth_on(written(design), symbols, box):
            return False
        if not resting:
            return True
        inertia = [*whole.y, *whole.family.moved.symbols]

        def test(Y: Interval, T: Interval) -> Truth:
            return positive_definite(matrix_enclosure(whole.inertia, inertia, beside(Y, T)))

        return self._on_cells(Interval(-half, half), theta, test)

    def _is_convex(self, half: Vector, theta: Interval) -> bool:
        d = len(self.whole.active)

        def test(Y: Interval, T: Interval) -> Truth:
            return positive_definite(self.jet(Y, T).hess[:, :d, :d])

        return self._on_cells(Interval(-half, half), theta, test)

    def _holds_minima(self, half: Vector, theta: Interval) -> bool:
        """Whether every place at rest of these ϑ is in the core."""
        active = list(self.whole.active)
        least, most = self.y_star.hi - half, self.y_star.lo + half
        for box in self.near.data["boxes"]:
            sides = np.array(box["theta"])
            if ((sides[:, 0] <= theta.hi) & (theta.lo <= sides[:, 1])).all():
                found = np.array(box["minimum"])[active]
                if not ((least < found[:, 0]) & (found[:, 1] < most)).all():
                    return False
        return True

    def _is_kept(self, half: Vector, core: float, level: float, theta: Interval) -> bool:
        """E > h on the sides, and on cells E > h, a slope or the core."""
        d = len(half)

        def high(Y: Interval, T: Interval) -> Truth:
            return np.asarray(self.jet(Y, T).value.lo > level)

        def settled(Y: Interval, T: Interval) -> Truth:
            jet = self.jet(Y, T)
            grad = jet.grad[:, :d]
            slopes = ((grad.lo > 0) | (grad.hi < 0)).any(1)
            away = (Y - self.y_star).magnitude <= core * half
            return np.asarray((jet.value.lo > level) | slopes | away.all(1))

        for axis, side in product(range(d), (-1.0, 1.0)):
            lo, hi = -half.copy(), half.copy()
            lo[axis] = hi[axis] = side * half[axis]
            if not self._on_cells(Interval(lo, hi), theta, high):
                return False
        return self._on_cells(Interval(-half, half), theta, settled)

    def _on_cells(
        self, box: Interval, theta: Interval, test: Callable[[Interval, Interval], Truth]
    ) -> bool:
        """Whether a test holds on every cell of y* + box and ϑ; cells that fail are halved."""
        d = box.shape[0]
        flat = np.concatenate([box.hi - box.lo, theta.hi - theta.lo]) == 0
        size = np.where(flat, 1.0, np.concatenate([box.rad, theta.rad]))
        moving = ~flat[:d]
        parts = max(2, round(_CELLS ** (1 / max(1, int(moving.sum())))))
        cells = subdivide(Interval(box.lo[moving], box.hi[moving]), parts)
        lo, hi = (np.tile(side, (cells.shape[0], 1)) for side in (box.lo, box.hi))
        lo[:, moving], hi[:, moving] = cells.lo, cells.hi
        Y = Interval(lo, hi) + self.y_star
        Z = beside(Y, Interval(*(np.tile(v, (Y.shape[0], 1)) for v in (theta.lo, theta.hi))))
        for _ in range(_ROUNDS):
            left = Z[~self._tested(Z, d, test)]
            if left.shape[0] == 0:
                return True
            if left.shape[0] > _MOST_CELLS or not self._tested(point(left.mid), d, test).all():
                return False
            Z = halved(left, size)
        return False

    def _tested(self, Z: Interval, d: int, test: Callable[[Interval, Interval], Truth]) -> Truth:
        parts = np.array_split(np.arange(Z.shape[0]), -(-Z.shape[0] // _BATCH))
        return np.concatenate([test(Z[rows][:, :d], Z[rows][:, d:]) for rows in parts])

    # --- what all have in common ------------------------------------------------------------------

    def common(self, boxes: list[HeldBox]) -> tuple[CellBox, str, float]:
        """Cells of y that at rest lie in the region of every member, and their share."""
        half = np.array([box.half for box in boxes]).min(0)
        d, active = len(half), list(self.whole.active)
        parts = _GRID[d]
        lo = self.y_star.hi - half
        side = np.nextafter(self.y_star.lo + half - lo, 0.0)
        grid = CellBox(numbers(lo), numbers(side), parts)
        index = np.array(list(product(range(parts), repeat=d)))
        cells = np.array([grid.cell((0, tuple(map(int, i)))) for i in index])
        Y, alive = Interval(cells[..., 0], cells[..., 1]), np.ones(len(index), dtype=bool)
        for box in boxes:
            level, whole = _EASED * box.level, Interval(*np.array(box.theta).T)
            rows = np.flatnonzero(alive)
            rows = rows[~self._is_low(Y[rows], whole, level)]  # the others are settled
            alive[rows] = self._is_low(Y[rows], point(whole.mid), level)
            for theta in _pieces(whole, self._moves):
                rows = rows[alive[rows]]
                alive[rows] = self._is_low(Y[rows], theta, level)
        domain = self.whole.minima.design.domain.of(active)
        volume = float(np.prod(domain.hi - domain.lo))
        inside = np.maximum(0.0, np.minimum(Y.hi, domain.hi) - np.maximum(Y.lo, domain.lo)).prod(1)
        share = float(inside[alive].sum() / volume) * (1 - _ROUND)
        marked = packed((0, tuple(map(int, i))) for i in index[alive])
        return grid, marked, share

    def _is_low(self, Y: Interval, theta: Interval, level: float) -> Truth:
        if not Y.shape[0]:
            return np.zeros(0, dtype=bool)
        shape = (Y.shape[0], theta.shape[0])
        wide = Interval(np.broadcast_to(theta.lo, shape), np.broadcast_to(theta.hi, shape))
        d = Y.shape[1]
        return self._tested(
            beside(Y, wide), d, lambda y, t: np.asarray(self.jet(y, t).value.hi <= level)
        )

    def step(self, boxes: list[HeldBox]) -> dict[str, float]:
        """How far set-points may move at once from rest, all by one share of their ranges.

        Nothing where other states move with them.
        """
        family, plant = self.whole.family, self.whole.family.moved.loop.plant
        moving = {p.name: p for p in family.parameters if p.kind == "setpoint"}
        follows = {str(s): v - t for s, v, t in zip(plant.x, family.moved.x_star,
                                                   family.moved.origin, strict=True)}  # fmt: skip
        apart = all(
            v == moving[name].symbol - moving[name].nominal if name in moving else v == 0
            for name, v in follows.items()
        )
        for share in _STEPS if apart and moving else ():
            far = {n: share * to_float(p.range[1] - p.range[0]) for n, p in moving.items()}
            if all(self._may_jump(box, far) for box in boxes):
                return far
        return {}

    def _may_jump(self, box: HeldBox, far: dict[str, float]) -> bool:
        """Whether rest at any set-point so near is in the region of these members."""
        start = self.starts(box, far)
        half = np.array(box.half)
        if not ((start - self.y_star).magnitude < half).all():
            return False
        theta = Interval(*np.array(box.theta).T)
        level = _EASED * box.level

        def low(Y: Interval, T: Interval) -> Truth:
            return np.asarray(self.jet(Y, T).value.hi <= level)

        offset = start - self.y_star
        return self._on_cells(Interval(offset.lo, offset.hi), theta, low)

    def starts(self, box: HeldBox, far: dict[str, float]) -> Interval:
        """Places at rest at set-points that are no farther, seen from those of a box, (d,)."""
        family, active = self.whole.family, list(self.whole.active)
        theta, found = np.array(box.theta), list[Interval]()
        for other in self.near.data["boxes"]:
            sides = np.array(other["theta"])
            gaps = np.array([far.get(p.name, 0.0) for p in family.parameters])
            near = (sides[:, 0] <= theta[:, 1] + gaps) & (theta[:, 0] - gaps <= sides[:, 1])
            if near.all():
                minimum = np.array(other["minimum"])
                found.append(Interval(minimum[:, 0], minimum[:, 1])[active])
        n, units = family.design.loop.plant.n, family.design.units.state
        lo, hi = np.min([v.lo for v in found], 0), np.max([v.hi for v in found], 0)
        names = family.design.loop.states
        reach = np.array([far.get(names[i], 0.0) / units[i] if i < n else 0.0 for i in active])
        return Interval(lo, hi) + Interval(-reach, reach)


def _sides(box: Interval) -> tuple[Side, ...]:
    return tuple((float(a), float(b)) for a, b in zip(box.lo, box.hi, strict=True))


def _halved(theta: Interval, moves: Vector) -> list[Interval]:
    """A box of ϑ in two, across what moves V most."""
    axis = int(np.argmax(moves * theta.rad))
    middle = float(theta.mid[axis])
    low, high = theta.hi.copy(), theta.lo.copy()
    low[axis] = high[axis] = middle
    return [Interval(theta.lo, low), Interval(high, theta.hi)]


def _pieces(theta: Interval, moves: Vector) -> list[Interval]:
    """A box of ϑ in pieces."""
    pieces = [theta]
    while len(pieces) < _PIECES:
        pieces = [half for piece in pieces for half in _halved(piece, moves)]
    return pieces
