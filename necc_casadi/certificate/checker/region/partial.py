"""A region by partial minimisation, proved again: every formula anew, in Arb balls.

Over the marked cells of s, w is regular or convex, and w > c on every face that no other marked
cell shares: their union holds the component of {w ≤ c} with s̄, and w has one critical point there.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from functools import cached_property

import sympy as sp
from flint import arb, arb_mat

from necc_casadi.certificate.checker.arithmetic.balls import Box, ball, by_bisection, ends, evaluate
from necc_casadi.certificate.checker.arithmetic.definite import positive
from necc_casadi.certificate.checker.arithmetic.hessian_floor import hessian_floor
from necc_casadi.certificate.checker.arithmetic.potential import Energy
from necc_casadi.certificate.checker.region.reduced import Cover, Reduced
from necc_casadi.certificate.claims.partial import Leaf, PartialRegion
from necc_casadi.symbolic.zero import is_zero

__all__ = ["BoundProof", "FloorProof", "LeafProof", "is_periodic", "stays_positive"]

#: Half a period, a little more than π.
_HALF_PERIOD = 3.15
#: How often a cell, a face or a box of angles may be halved before a test on it counts as failed.
_DEPTH, _ANGLES = 7, 14


class FloorProof:
    """V_ee ⪰ F for every e, and for every s of a box: by matrices below ∇²K and ∇²Hc."""

    def __init__(
        self, energy: Energy, kept: Sequence[int], floor: Sequence[Sequence[float]]
    ) -> None:
        self.energy, self.kept = energy, list(kept)
        self.gone = [i for i in range(energy.d) if i not in self.kept]
        self.F = arb_mat([list(row) for row in floor]) if self.gone else None

    def holds(self, box: Box) -> bool:
        """Whether F is below V_ee for s in the box (ds,), every e."""
        model, e = self.energy.model, [self.energy.variables[i] for i in self.gone]
        F = self.F
        if F is None:
            return True
        if model.form["phi"] is not None or model.form["betas"]:
            return False
        at_rest = {s: 0 for i, s in enumerate(model.z) if i not in self.energy.active}
        H = sp.hessian(model.H.subs(at_rest), e)
        N = sp.Matrix([[sp.diff(c, v) for v in e] for c in model.casimirs])
        if N.has(*e):
            return False
        K = hessian_floor(self.energy.k, model.form["k"]["activation"])
        below = self._of_controller(hessian_floor(self.energy.hc, model.form["hc"]["activation"]))
        used = sorted(H.free_symbols | N.free_symbols, key=str)
        cells = self._ranges(used, [*H, *N], box)
        if cells is None:
            return False

        def above(cell: Box) -> bool:
            values = {v: ball(*side) for v, side in zip(used, cell, strict=True)}
            slopes, rest = (_evaluated(M, values) for M in (N, H))
            return positive(slopes.transpose() * K * slopes + rest + below - F, 0)

        return by_bisection(cells, above, _ANGLES)

    def _of_controller(self, Hc: arb_mat) -> arb_mat:
        """What ∇²Hc adds to V_ee at least."""
        first, size = self.energy.d - self.energy.model.nc, len(self.gone)
        total = arb_mat(size, size)
        for a, i in enumerate(self.gone):
            for b, j in enumerate(self.gone):
                if i >= first and j >= first:
                    total[a, b] = Hc[i - first, j - first]
        return total

    def _ranges(self, used: Sequence[sp.Symbol], entries: list[sp.Expr], box: Box) -> Box | None:
        """A period of each angle, the box of the other kept states; None for anything else."""
        sides = []
        for symbol in used:
            i = self.energy.variables.index(symbol)
            if all(is_periodic(entry, symbol) for entry in entries if entry.has(symbol)):
                sides.append((-_HALF_PERIOD, _HALF_PERIOD))
            elif i in self.kept:
                sides.append(box[self.kept.index(i)])
            else:
                return None
        return tuple(sides)


def is_periodic(entry: sp.Expr, symbol: sp.Symbol) -> bool:
    """Whether an expression is proved to repeat after 2π in a symbol that stands in sin and cos."""
    inside = [f for f in entry.atoms(sp.Function) if f.has(symbol)]
    plain = all(isinstance(f, (sp.sin, sp.cos)) for f in inside)
    return plain and is_zero(entry.subs(symbol, symbol + 2 * sp.pi) - entry) is True


def _evaluated(matrix: sp.Matrix, values: dict[sp.Symbol, arb]) -> arb_mat:
    return arb_mat([[evaluate(e, values) for e in row] for row in matrix.tolist()])


class LeafProof:
    """The marked cells of a region: what w does on them and on the faces around them."""

    def __init__(self, reduced: Reduced, region: PartialRegion) -> None:
        self.reduced, self.region, self.level = reduced, region, region.level
        self.leaves = set(region.leaves)

    # --- geometry: integers, and ends that are computed as the region says --------------------

    @cached_property
    def whole(self) -> Box:
        """The box that is cut into cells."""
        return self.region.box((0, (0,) * len(self.reduced.s)), parts=1)

    def sides_are_sound(self) -> bool:
        """Whether the cells are what they are taken for: finite, of positive width, in the box."""
        region, deepest = self.region, 40
        sizes = [region.lo, region.side]
        return (
            all(math.isfinite(v) for side in sizes for v in side)
            and all(v > 0 for v in region.side)
            and region.parts in (1, 2, 4, 8, 16, 32, 64, 128)
            and bool(self.leaves)
            and all(
                0 <= depth <= deepest
                and len(index) == len(self.reduced.s)
                and all(0 <= k < region.parts * 2**depth for k in index)
                for depth, index in self.leaves
            )
            and not self._above_leaves & self.leaves
        )

    def _parents(self, leaf: Leaf) -> Iterator[Leaf]:
        depth, index = leaf
        while depth > 0:
            depth, index = depth - 1, tuple(k // 2 for k in index)
            yield depth, index

    def _covered(self, cell: Leaf) -> bool:
        return cell in self.leaves

    def _below_a_leaf(self, cell: Leaf) -> bool:
        """Whether a cell is marked, or part of a marked one."""
        return self._covered(cell) or any(map(self._covered, self._parents(cell)))

    @cached_property
    def _above_leaves(self) -> set[Leaf]:
        """Cells that hold smaller marked ones."""
        return {parent for leaf in self.leaves for parent in self._parents(leaf)}

    def faces(self) -> Iterator[Box]:
        """Faces of marked cells that no marked cell covers from the other side."""
        for depth, index in sorted(self.leaves):
            for axis in range(len(index)):
                for side in (-1, 1):
                    other = (depth, (*index[:axis], index[axis] + side, *index[axis + 1 :]))
                    yield from self._open(other, axis, side)

    def _open(self, other: Leaf, axis: int, side: int) -> Iterator[Box]:
        """The faces between a marked cell and the place beside it that are not covered there."""
        if self._below_a_leaf(other):
            return
        if other not in self._above_leaves:
            yield self._face(other, axis, side)
            return
        depth, index = other
        near = 0 if side > 0 else 1
        for move in range(2 ** (len(index) - 1)):
            bits = [(move >> k) & 1 for k in range(len(index) - 1)]
            bits.insert(axis, near)
            child = tuple(2 * k + b for k, b in zip(index, bits, strict=True))
            yield from self._open((depth + 1, child), axis, side)

    def _face(self, other: Leaf, axis: int, side: int) -> Box:
        """The face of a cell, which may lie outside of the box, on the side of the marked one."""
        depth, index = other
        inner = (depth, (*index[:axis], index[axis] - side, *index[axis + 1 :]))
        box = self.region.box(inner)
        end = box[axis][1] if side > 0 else box[axis][0]
        return (*box[:axis], (end, end), *box[axis + 1 :])

    # --- what has to be proved -----------------------------------------------------------------

    def holds_minimum(self, s_bar: Box) -> bool:
        """Whether s̄ is inside the core, in marked cells."""
        core = self.region.core
        inside = all(a < lo and hi < b for (a, b), (lo, hi) in zip(core, s_bar, strict=True))
        meets = [leaf for leaf in self.leaves if _touch(self.region.box(leaf), s_bar)]
        return inside and bool(meets)

    def core_is_convex(self) -> bool:
        """Whether ∇²w ≻ 0 on the core, which lies in the box."""
        core, whole = self.region.core, self.whole
        inside = all(a <= lo and hi <= b for (lo, hi), (a, b) in zip(core, whole, strict=True))
        return inside and self._everywhere(core, lambda c: c is not None and c.convex)

    def cells_are_settled(self) -> bool:
        """Whether every marked cell is in the core, or ∇w ≠ 0 wherever w ≤ c on it."""
        core = self.region.core
        for leaf in sorted(self.leaves):
            box = self.region.box(leaf)
            if all(a <= lo and hi <= b for (lo, hi), (a, b) in zip(box, core, strict=True)):
                continue
            if not self._everywhere(box, self._settled):
                return False
        return True

    def _settled(self, cover: Cover | None) -> bool:
        return _is_regular(cover) or self._is_above(cover)

    def _is_above(self, cover: Cover | None) -> bool:
        return cover is not None and bool(cover.low > self.level)

    def faces_are_above(self) -> bool:
        """Whether w > c on every face around the marked cells."""
        return all(self._everywhere(face, self._is_above) for face in self.faces())

    def _everywhere(self, box: Box, test: Callable[[Cover | None], bool]) -> bool:
        return by_bisection(box, lambda piece: test(self.reduced.cover(piece)), _DEPTH)

    def fibres(self) -> Iterator[tuple[arb, Box]]:
        """(c − w at most, box of the active states) for marked cells: together they hold Ω."""
        for leaf in sorted(self.leaves):
            yield from self._fibre(self.region.box(leaf), 3)

    def _fibre(self, cell: Box, depth: int) -> Iterator[tuple[arb, Box]]:
        cover = self.reduced.cover(cell)
        if cover is not None and bool(cover.low > self.level):
            return
        if cover is None:
            if depth == 0:
                raise ArithmeticError("a marked cell has no bound of its fibre")
            axis = max(range(len(cell)), key=lambda k: cell[k][1] - cell[k][0])
            lo, hi = cell[axis]
            middle = lo / 2 + hi / 2
            for half in ((lo, middle), (middle, hi)):
                yield from self._fibre((*cell[:axis], half, *cell[axis + 1 :]), depth - 1)
            return
        room = (self.level - cover.low).upper()
        reach = (2 * room).sqrt()
        box: list[tuple[float, float]] = [(0.0, 0.0)] * self.reduced.energy.d
        for k, i in enumerate(self.reduced.s):
            box[i] = cell[k]
        for k, i in enumerate(self.reduced.e):
            swing = reach * self.reduced.widths[k] * ball(-1.0, 1.0)
            box[i] = ends(cover.e[k] + swing)
        yield room, tuple(box)


def _is_regular(cover: Cover | None) -> bool:
    return cover is not None and cover.regular


def _touch(a: Box, b: Box) -> bool:
    return all(lo <= high and low <= hi for (lo, hi), (low, high) in zip(a, b, strict=True))


def stays_positive(A: sp.Matrix, variables: Sequence[sp.Symbol], boxes: Sequence[Box]) -> bool:
    """Whether a matrix is ≻ 0 on boxes of its variables."""
    counts = [A.has(v) for v in variables]

    def test(box: Box) -> bool:
        values = {v: ball(*side) for v, side in zip(variables, box, strict=True)}
        return positive(_evaluated(A, values), 0)

    return all(by_bisection(box, test, _DEPTH, counts) for box in boxes)


class BoundProof:
    """The user's bounds of states that s does not hold: V > c where one of them is met."""

    def __init__(self, leaves: LeafProof, inertia: sp.Matrix, resting: Sequence[int]) -> None:
        self.leaves, self.A, self.resting = leaves, inertia, list(resting)
        self.reduced, self.energy = leaves.reduced, leaves.reduced.energy

    def momentum_stays(self, i: int, reach: arb) -> bool:
        """Whether |pᵢ| = reach is met nowhere in {V ≤ c} over the marked cells."""
        k = self.resting.index(i)
        kept = {self.energy.variables[j] for j in self.reduced.s}
        if self.A.free_symbols <= kept:
            return self._jointly(k, reach)
        return all(self._within(k, reach, room, box) for room, box in self.leaves.fibres())

    def _jointly(self, k: int, reach: arb) -> bool:
        """W + ½ reach² det A/det A₍ₖ₎ > c, the sum as one energy."""
        others = [j for j in range(self.A.rows) if j != k]
        minor = self.A.extract(others, others)
        stiff = sp.cancel(sp.together(self.A.det() / minor.det()))
        half = sp.Rational(*float(reach.lower()).as_integer_ratio()) ** 2 / 2
        raised = Energy(self.energy.model, self.energy.active, half * stiff)
        return self._above(self.reduced.over(raised), lambda cell: cell)

    def _within(self, k: int, reach: arb, room: arb, box: Box) -> bool:
        """A − 2(c − w)/reach² eₖeₖᵀ ≻ 0 on a fibre."""
        shift, variables = 2 * room / (reach * reach), self.energy.variables
        counts = [self.A.has(v) for v in variables]

        def test(piece: Box) -> bool:
            values = {v: ball(*side) for v, side in zip(variables, piece, strict=True)}
            matrix = _evaluated(self.A, values)
            matrix[k, k] = matrix[k, k] - shift
            return positive(matrix, 0)

        return by_bisection(box, test, _DEPTH, counts)

    def state_stays(self, position: int, end: float) -> bool:
        """Whether eᵢ = end is met nowhere in {V ≤ c}: min {V(s, e): eᵢ = end} > c."""
        held = self.reduced.holding(position)
        at = held.s.index(position)
        return self._above(held, lambda cell: (*cell[:at], (end, end), *cell[at:]))

    def _above(self, other: Reduced, placed: Callable[[Box], Box]) -> bool:
        """Whether another w, at a place that belongs to each cell, is above c where w is not."""
        level = self.leaves.level

        def test(cell: Box) -> bool:
            cover = other.cover(placed(cell))
            if cover is not None and bool(cover.low > level):
                return True
            own = self.reduced.cover(cell)
            return own is not None and bool(own.low > level)

        cells = map(self.leaves.region.box, sorted(self.leaves.leaves))
        return all(by_bisection(cell, test, _DEPTH) for cell in cells)
