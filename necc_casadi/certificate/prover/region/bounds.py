"""What must hold over the marked cells besides V: bounds, inertia, poles; and how far Ω reaches.

The bounds of states that the model names are obstacles of their own, found in floats, then proved.
A bound of a state that is minimised out binds where min {V(s, e): eᵢ = b} reaches the level, which
is w of one state more; a bound of a momentum where w(s) + b²/(2(A⁻¹)ᵢᵢ) does, with A(s, e) its
inertia: (A⁻¹)ᵢᵢ < t if and only if A − eᵢeᵢᵀ/t ≻ 0. Where Φ₁ ≥ δ only, w(s) + ½δpᵀAp is below V.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import sympy as sp

from necc_casadi.arrays import Truth, Vector
from necc_casadi.certificate.prover.arithmetic.boxes import matrix_enclosure
from necc_casadi.certificate.prover.arithmetic.definite import positive_definite
from necc_casadi.certificate.prover.arithmetic.intervals import Interval, concatenate, point
from necc_casadi.certificate.prover.arithmetic.jets import constant, expression_values
from necc_casadi.certificate.prover.arithmetic.potential import Potential
from necc_casadi.certificate.prover.arithmetic.smooth import written
from necc_casadi.certificate.prover.invariant_sets import loop_is_defined
from necc_casadi.certificate.prover.region.leaves import Leaves
from necc_casadi.certificate.prover.region.obstacle import Obstacle, Search
from necc_casadi.certificate.prover.region.reduced import Reduced
from necc_casadi.certificate.prover.region.split import Splits
from necc_casadi.designs.design import Design
from necc_casadi.symbolic.smoothness import Condition, conditions

__all__ = ["Bounds", "bounds_of"]

#: How often a cell may be halved before a bound counts as not kept on it.
_HALVINGS = 7
#: Share of a bound that no double is, as π/2, by which the prover stays within it: the arithmetic
#: of the checker rounds otherwise.
_ROOM = 2.0**-48
#: A place is behind a pass where it is reached this share of its height above its own V. Widths of
#: a momentum's range that are tried, by what it is at the middles of the cells.
_OVER = 1e-6
_WIDER = (1.01, 1.05, 1.2, 1.5, 2.0, 4.0)


def bounds_of(design: Design, *, outwards: bool = False) -> Interval:
    """The bounds that the model names for its states, ±∞ where it names none; rounded inwards."""
    lo, hi = np.full(design.loop.n, -np.inf), np.full(design.loop.n, np.inf)
    for i, name in enumerate(design.loop.states):
        if name in design.loop.plant.domain:
            below, above = (constant(sp.sympify(b)) for b in design.loop.plant.domain[name])
            sides = (below.lo, above.hi) if outwards else (below.hi, above.lo)
            room = [
                0.0 if outwards or b.lo == b.hi else _ROOM * float(b.magnitude)
                for b in (below, above)
            ]
            lo[i], hi[i] = float(sides[0] + room[0]), float(sides[1] - room[1])
    return Interval(lo, hi)


@dataclass(frozen=True, eq=False)
class Bounds:
    """The bounds of the states that s does not hold, for one way to split the states."""

    reduced: Reduced
    splits: Splits
    bounds: Interval  # (N,) of all states

    @property
    def _design(self) -> Design:
        return self.reduced.potential.design

    @cached_property
    def _momenta(self) -> list[tuple[int, float]]:
        """(position among the momenta, distance of the nearer bound) where one is named."""
        resting = self.reduced.potential.resting
        reach = np.minimum(-self.bounds.lo, self.bounds.hi)[list(resting)]
        return [(k, float(reach[k])) for k in range(len(resting)) if np.isfinite(reach[k])]

    @cached_property
    def _gone(self) -> list[tuple[int, float]]:
        """(position among the active states, bound) of states that are minimised out."""
        active = self.reduced.potential.active
        pairs = [(i, end) for i in self.reduced.gone for end in (self.bounds.lo, self.bounds.hi)]
        return [(i, float(end[active[i]])) for i, end in pairs if np.isfinite(end[active[i]])]

    @cached_property
    def inertia(self) -> sp.Matrix:
        """A = ∂²H/∂p² of the momenta."""
        loop = self._design.loop
        momenta = [loop.z[i] for i in self.reduced.potential.resting]
        return sp.hessian(loop.plant.H, momenta) if momenta else sp.zeros(0, 0)

    @cached_property
    def _delta(self) -> float:
        """A lower bound of Φ₁."""
        phi = self._design.form.phi
        return 1.0 if phi is None else float(phi.delta)

    @cached_property
    def _conditions(self) -> list[Condition]:
        """What must hold for everything to be smooth, of parts that vary."""
        demands = conditions(written(self._design)) or ()
        return sorted((d for d in demands if d.part.free_symbols), key=str)

    # --- in floating point --------------------------------------------------------------------

    def defined(self, nodes: Vector, e: Vector, half: Vector) -> Truth:
        """Whether all is smooth near nodes (B, ds), within ± half, at minimisers e."""
        loop, landscape = self._design.loop, self.reduced.landscape
        lo, hi = landscape.states(nodes - half, e), landscape.states(nodes + half, e)
        result = np.ones(len(nodes), dtype=bool)
        with np.errstate(all="ignore"):
            box = Interval(np.minimum(lo, hi), np.maximum(lo, hi))
            around = {s: box[:, i] for i, s in enumerate(loop.z)}
            for demand in self._conditions:
                (value,) = expression_values([demand.part], around)
                result &= (value.lo > 0) | ((value.hi < 0) & (not demand.positive))
        return result

    def lowest(self, found: Search) -> Obstacle | None:
        """The bound that the flood from s̄ meets first."""
        met = [*self._of_momenta(found), *self._of_gone(found), *self._of_kept(found)]
        return min(met, key=lambda obstacle: obstacle.level, default=None)

    def _of_momenta(self, found: Search) -> Iterator[Obstacle]:
        """V is least with pₖ at its bound b where p = b A⁻¹eₖ/(A⁻¹)ₖₖ."""
        if not self._momenta:
            return
        resting = list(self.reduced.potential.resting)
        inverse = self._inverse_inertia(self.reduced.landscape.joined(found.nodes, found.minima.e))
        for k, reach in self._momenta:
            z = self.reduced.landscape.states(found.nodes, found.minima.e)
            with np.errstate(all="ignore"):
                z[:, resting] = reach * inverse[:, k] / inverse[:, k, k][:, None]
            if reach < self.bounds.hi[resting[k]]:
                z[:, resting] *= -1
            values = self._design.lyapunov.V(z)
            yield from self._met(found, values, z)

    def _of_gone(self, found: Search) -> Iterator[Obstacle]:
        for i, end in self._gone:
            held = self._held(i)
            s = self._with(held, found.nodes, i, end)
            minima = held.landscape.minima(s)
            z = held.landscape.states(s, minima.e)
            yield from self._met(found, minima.w, z)

    def _of_kept(self, found: Search) -> Iterator[Obstacle]:
        active = self.reduced.potential.active
        z = self.reduced.landscape.states(found.nodes, found.minima.e)
        for axis, i in enumerate(self.reduced.kept):
            for end in (self.bounds.lo[active[i]], self.bounds.hi[active[i]]):
                if np.isfinite(end):
                    near = np.abs(found.nodes[:, axis] - end) <= 1e-9 * (found.hi - found.lo)[axis]
                    yield from self._met(found, np.where(near, found.minima.w, np.inf), z)

    def _met(self, found: Search, values: Vector, z: Vector) -> Iterator[Obstacle]:
        """The lowest place of a bound, by V there, that the flood reaches without a higher pass."""
        slack = _OVER * (values - float(np.nanmin(found.minima.w)))
        with np.errstate(all="ignore"):
            met = np.isfinite(values) & (found.levels <= values + slack)
        if met.any():
            at = int(np.argmin(np.where(met, values, np.inf)))
            yield Obstacle("domain", float(values[at]), z[at])

    def _inverse_inertia(self, Y: Vector) -> Vector:
        """A⁻¹ at points of the active states, (B, momenta, momenta); NaN where there is none."""
        symbols = self.splits.symbols
        A = np.empty((len(Y), *self.inertia.shape))
        with np.errstate(all="ignore"):
            A[:] = matrix_enclosure(self.inertia, symbols, point(Y)).mid
        usable: Truth = np.asarray(np.isfinite(A).all((1, 2)))
        safe = np.where(usable[:, None, None], A, np.eye(A.shape[-1]))
        return np.where(usable[:, None, None], np.linalg.pinv(safe, hermitian=True), np.nan)

    def defined_on(self, cells: Interval) -> Truth:
        """Whether what depends on s alone is smooth on cells (B, ds)."""
        kept = [self.splits.symbols[i] for i in self.reduced.kept]
        around = {s: cells[:, k] for k, s in enumerate(kept)}
        result = np.ones(cells.shape[0], dtype=bool)
        with np.errstate(all="ignore"):
            for demand in self._conditions:
                if demand.part.free_symbols <= set(kept):
                    (value,) = expression_values([demand.part], around)
                    result &= (value.lo > 0) | ((value.hi < 0) & (not demand.positive))
        return result

    # --- proved -------------------------------------------------------------------------------

    def kept(self, leaves: Leaves, level: float) -> bool:
        """Whether no bound is met in {V ≤ c} over the marked cells."""
        return self._momenta_inside(leaves, level) and self._gone_inside(leaves, level)

    def fibres(self, leaves: Leaves, level: float) -> tuple[Vector, Interval]:
        """At most 2(c − w)/δ (B,), and boxes (B, d) that hold {V(·, p = 0) ≤ c}, cell by cell."""
        rows = np.flatnonzero(leaves.marked & ~(leaves.cover.ok & (leaves.cover.w.lo > level)))
        cover = leaves.cover[rows]
        room = ((level - point(cover.w.lo)) * 2.0 / self._delta).hi
        boxes = self.reduced.fibres(leaves.boxes[rows], cover, level)
        active = list(self.reduced.potential.active)
        lo = np.maximum(boxes.lo, self.bounds.lo[active])
        return room, Interval(lo, np.minimum(boxes.hi, self.bounds.hi[active]))

    def ranges(self, leaves: Leaves, level: float) -> Interval | None:
        """A box (N,) of all states that holds Ω; None where A ≻ 0 or the loop is not proved there.

        |pᵢ| ≤ √(2(c − w)(A⁻¹)ᵢᵢ/δ) over each cell and the range of e there.
        """
        room, boxes = self.fibres(leaves, level)
        lo, hi = np.zeros(self._design.loop.n), np.zeros(self._design.loop.n)
        active, resting = list(self.reduced.potential.active), self.reduced.potential.resting
        lo[active], hi[active] = boxes.lo.min(0), boxes.hi.max(0)
        if not (np.isfinite(lo).all() and np.isfinite(hi).all()):
            return None
        inverse = self._inverse_inertia(boxes.mid)
        for k, i in enumerate(resting):
            near = float(np.sqrt(np.nanmax(np.maximum(room * inverse[:, k, k], 0.0))))
            reach = next((r for f in _WIDER if self._within(room, boxes, k, r := f * near)), None)
            if reach is None:
                return None
            lo[i], hi[i] = max(-reach, self.bounds.lo[i]), min(reach, self.bounds.hi[i])
        found = Interval(lo, hi)
        return found if loop_is_defined(self._design, found) else None

    def _within(self, room: Vector, boxes: Interval, k: int, reach: float) -> bool:
        """Whether A − 2(c − w)/(δ reach²) eₖeₖᵀ ≻ 0 over boxes (B, d), cut where it is needed."""
        if not reach > 0:
            return False
        used = [i for i, v in enumerate(self.splits.symbols) if self.inertia.has(v)]
        symbols, cells = [self.splits.symbols[i] for i in used], boxes[:, used]
        shift = (point(room) / point(reach).square()).hi
        unit = np.diag(np.eye(self.inertia.rows)[k])
        for _ in range(2 * _HALVINGS):
            A = matrix_enclosure(self.inertia, symbols, cells)
            open_ = np.flatnonzero(~positive_definite(A - shift[:, None, None] * unit))
            if not open_.size:
                return True
            if not used:
                return False
            left, shift = cells[open_], np.tile(shift[open_], 2)
            axis, rows = np.argmax(left.hi - left.lo, axis=1), np.arange(len(open_))
            lo, hi = left.lo.copy(), left.hi.copy()
            lo[rows, axis] = hi[rows, axis] = left.mid[rows, axis]
            cells = concatenate(Interval(left.lo, hi), Interval(lo, left.hi))
        return False

    def _momenta_inside(self, leaves: Leaves, level: float) -> bool:
        """Whether every momentum with a bound stays within it over the marked cells."""
        steady = self.inertia.free_symbols <= {self.splits.symbols[i] for i in self.reduced.kept}
        joint = steady and self._design.form.phi is None
        inside = self._inside_jointly if joint else self._inside_by_cells
        return all(inside(leaves, level, k, reach) for k, reach in self._momenta)

    def _inside_jointly(self, leaves: Leaves, level: float, k: int, reach: float) -> bool:
        """W + ½b²σ > c with σ = 1/(A⁻¹)ᵢᵢ a function of s alone: one enclosure of the sum."""
        potential = self.reduced.potential
        sigma = sp.simplify(1 / self.inertia.inv()[k, k])
        half = sp.Rational(*reach.as_integer_ratio()) ** 2 / 2
        held = Potential(potential.design, potential.resting, half * sigma)
        raised = replace(self.reduced, potential=held)
        cells = leaves.boxes[np.flatnonzero(leaves.marked)]
        for _ in range(_HALVINGS):
            cover, own = raised.cover(cells), self.reduced.cover(cells)
            clear = (cover.ok & (cover.w.lo > level)) | (own.ok & (own.w.lo > level))
            if clear.all():
                return True
            cells = halves(cells[np.flatnonzero(~clear)])
        return False

    def _inside_by_cells(self, leaves: Leaves, level: float, k: int, reach: float) -> bool:
        """A − κeᵢeᵢᵀ ≻ 0 with κ = 2(c − w)/b² on every marked cell and the range of e there."""
        rows = np.flatnonzero(leaves.marked)
        cells, cover = leaves.boxes[rows], leaves.cover[rows]
        for _ in range(_HALVINGS):
            shift = ((level - point(cover.w.lo)) * 2.0 / point(reach).square() / self._delta).hi
            boxes = self.reduced.fibres(cells, cover, level)
            A = matrix_enclosure(self.inertia, self.splits.symbols, boxes)
            unit = np.diag(np.eye(A.shape[-1])[k])
            clear = cover.ok & positive_definite(A - shift[:, None, None] * unit)
            clear |= cover.ok & (cover.w.lo > level)
            if clear.all():
                return True
            cells = halves(cells[np.flatnonzero(~clear)])
            cover = self.reduced.cover(cells)
        return False

    def _gone_inside(self, leaves: Leaves, level: float) -> bool:
        above = (self._held_above(self._held(i), leaves, i, end, level) for i, end in self._gone)
        return all(above)

    def _held_above(self, held: Reduced, leaves: Leaves, i: int, end: float, level: float) -> bool:
        """Whether min {V(s, e): eᵢ = b} > c on every marked cell.

        No halving helps a cell in the middle of which it is no higher: w is not either.
        """
        cells = leaves.boxes[np.flatnonzero(leaves.marked)]
        for _ in range(_HALVINGS):
            faces = Interval(self._with(held, cells.lo, i, end), self._with(held, cells.hi, i, end))
            cover = held.cover(faces)
            cells = cells[np.flatnonzero(~(cover.ok & (cover.w.lo > level)))]
            if not cells.shape[0]:
                return True
            if held.reaches(self._with(held, cells.mid, i, end), level):
                return False
            own = self.reduced.cover(cells)
            cells = halves(cells[np.flatnonzero(~(own.ok & (own.w.lo > level)))])
            if not cells.shape[0]:
                return True
        return False

    def _held(self, i: int) -> Reduced:
        """The split that keeps state i too; V_ee ≻ 0 holds there as it does without it."""
        kept = tuple(sorted((*self.reduced.kept, i)))
        gone = tuple(k for k in self.reduced.gone if k != i)
        rows = [k for k, j in enumerate(self.reduced.gone) if j != i]
        floor, tube = self.reduced.floor[np.ix_(rows, rows)], self.reduced.tube
        return Reduced(
            self.reduced.potential, kept, gone, floor, None if tube is None else tube[rows]
        )

    def _with(self, held: Reduced, s: Vector, i: int, end: float) -> Vector:
        """Points of the kept states with state i at its bound."""
        at = held.kept.index(i)
        return np.insert(s, at, end, axis=1)


def halves(cells: Interval) -> Interval:
    """Each cell cut in two along every axis on which it has a width."""
    lo, hi = cells.lo, cells.hi
    for axis in range(cells.shape[1]):
        wide = hi[:, axis] > lo[:, axis]
        middle = np.clip(lo[:, axis] + (hi[:, axis] - lo[:, axis]) / 2, lo[:, axis], hi[:, axis])
        low, high = hi.copy(), lo.copy()
        low[:, axis], high[:, axis] = np.where(wide, middle, hi[:, axis]), middle
        lo = np.concatenate([lo, high[wide]])
        hi = np.concatenate([low, hi[wide]])
    return Interval(lo, hi)
