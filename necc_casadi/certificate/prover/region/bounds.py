"""The user's own bounds of the states: obstacles of their own, found in floats, then proved.

A bound of a state that is minimised out binds where min {V(s, e): eᵢ = b} reaches the level, which
is w of one state more; a bound of a momentum where w(s) + b²/(2(A⁻¹)ᵢᵢ) does, with A(s, e) its
inertia: (A⁻¹)ᵢᵢ < t if and only if A − eᵢeᵢᵀ/t ≻ 0.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np
import sympy as sp

from necc_casadi.arrays import Vector
from necc_casadi.certificate.prover.arithmetic.boxes import matrix_enclosure
from necc_casadi.certificate.prover.arithmetic.definite import positive_definite
from necc_casadi.certificate.prover.arithmetic.intervals import Interval, point
from necc_casadi.certificate.prover.arithmetic.jets import constant
from necc_casadi.certificate.prover.arithmetic.potential import Potential
from necc_casadi.certificate.prover.region.leaves import Leaves
from necc_casadi.certificate.prover.region.obstacle import Obstacle, Search
from necc_casadi.certificate.prover.region.reduced import Reduced
from necc_casadi.certificate.prover.region.split import Splits
from necc_casadi.designs.design import Design

__all__ = ["Bounds", "bounds_of"]

#: How often a cell may be halved before a bound counts as not kept on it.
_HALVINGS = 7


def bounds_of(design: Design) -> Interval:
    """The bounds that the model names for its states, rounded inwards; ±∞ where it names none."""
    lo, hi = np.full(design.loop.n, -np.inf), np.full(design.loop.n, np.inf)
    for i, name in enumerate(design.loop.states):
        if name in design.loop.plant.domain:
            below, above = (constant(sp.sympify(b)) for b in design.loop.plant.domain[name])
            lo[i], hi[i] = float(below.hi), float(above.lo)
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
        return sp.hessian(loop.plant.H, [loop.z[i] for i in self.reduced.potential.resting])

    # --- in floating point --------------------------------------------------------------------

    def lowest(self, found: Search) -> Obstacle | None:
        """The bound that the flood from s̄ meets first."""
        met = [*self._of_momenta(found), *self._of_gone(found), *self._of_kept(found)]
        return min(met, key=lambda obstacle: obstacle.level, default=None)

    def _of_momenta(self, found: Search) -> Iterator[Obstacle]:
        if not self._momenta:
            return
        nodes, resting = found.nodes, self.reduced.potential.resting
        inverse = self._inverse_inertia(self.reduced.landscape.joined(nodes, found.minima.e))
        for k, reach in self._momenta:
            levels = np.maximum(found.levels, found.minima.w + reach**2 / (2 * inverse[:, k]))
            yield self._at(found, levels, resting[k])

    def _of_gone(self, found: Search) -> Iterator[Obstacle]:
        active = self.reduced.potential.active
        for i, end in self._gone:
            held = self._held(i)
            if held is not None:
                nodes = self._with(held, found.nodes, i, end)
                levels = np.maximum(held.landscape.minima(nodes).w, found.levels)
                yield self._at(found, levels, active[i])

    def _of_kept(self, found: Search) -> Iterator[Obstacle]:
        active = self.reduced.potential.active
        for axis, i in enumerate(self.reduced.kept):
            for end in (self.bounds.lo[active[i]], self.bounds.hi[active[i]]):
                if np.isfinite(end):
                    near = np.abs(found.nodes[:, axis] - end) <= 1e-9 * (found.hi - found.lo)[axis]
                    if near.any():
                        levels = np.where(near, found.levels, np.inf)
                        yield self._at(found, levels, active[i])

    def _at(self, found: Search, levels: Vector, state: int) -> Obstacle:
        at = int(np.nanargmin(np.where(np.isnan(levels), np.inf, levels)))
        level, s, e = float(levels[at]), found.nodes[at], found.minima.e[at]
        return Obstacle("domain", level, s, e, state)

    def _inverse_inertia(self, Y: Vector) -> Vector:
        """(A⁻¹)ᵢᵢ at points of the active states, (B, momenta)."""
        resting = list(self.reduced.potential.resting)
        z = np.zeros((len(Y), self._design.loop.n))
        z[:, list(self.reduced.potential.active)] = Y
        n = self._design.loop.plant.n
        x = ca.MX.sym("x", n)
        hessian = ca.hessian(self._design.lyapunov.terms.H(x), x)[0][resting, resting]
        found = np.asarray(ca.Function("A", [x], [ca.densify(hessian)]).map(len(Y))(z[:, :n].T))
        blocks = found.reshape(len(resting), len(Y), len(resting)).swapaxes(0, 1)
        usable = np.isfinite(blocks).all((1, 2))
        safe = np.where(usable[:, None, None], blocks, np.eye(len(resting)))
        inverse = np.diagonal(np.linalg.inv(safe), axis1=1, axis2=2)
        return np.where(usable[:, None], inverse, np.nan)

    # --- proved -------------------------------------------------------------------------------

    def kept(self, leaves: Leaves, level: float) -> bool:
        """Whether no bound is met in {V ≤ c} over the marked cells."""
        return self._momenta_inside(leaves, level) and self._gone_inside(leaves, level)

    def _momenta_inside(self, leaves: Leaves, level: float) -> bool:
        """Whether every momentum with a bound stays within it over the marked cells."""
        steady = self.inertia.free_symbols <= {self.splits.symbols[i] for i in self.reduced.kept}
        inside = self._inside_jointly if steady else self._inside_by_cells
        return all(inside(leaves, level, k, reach) for k, reach in self._momenta)

    def _inside_jointly(self, leaves: Leaves, level: float, k: int, reach: float) -> bool:
        """W + ½b²σ > c with σ = 1/(A⁻¹)ᵢᵢ a function of s alone: one enclosure of the sum."""
        potential = self.reduced.potential
        sigma = sp.simplify(1 / self.inertia.inv()[k, k])
        half = sp.Rational(*reach.as_integer_ratio()) ** 2 / 2
        held = Potential(potential.design, potential.resting, half * sigma)
        raised = Reduced(held, self.reduced.kept, self.reduced.gone, self.reduced.floor)
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
            shift = ((level - point(cover.w.lo)) * 2.0 / point(reach).square()).hi
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
        for i, end in self._gone:
            held = self._held(i)
            if held is None or not self._held_above(held, leaves, i, end, level):
                return False
        return True

    def _held_above(self, held: Reduced, leaves: Leaves, i: int, end: float, level: float) -> bool:
        """Whether min {V(s, e): eᵢ = b} > c on every marked cell."""
        cells = leaves.boxes[np.flatnonzero(leaves.marked)]
        for _ in range(_HALVINGS):
            faces = Interval(self._with(held, cells.lo, i, end), self._with(held, cells.hi, i, end))
            cover, own = held.cover(faces), self.reduced.cover(cells)
            clear = (cover.ok & (cover.w.lo > level)) | (own.ok & (own.w.lo > level))
            if clear.all():
                return True
            cells = halves(cells[np.flatnonzero(~clear)])
        return False

    def _held(self, i: int) -> Reduced | None:
        """The split that keeps state i too; V_ee ≻ 0 holds there as it does without it."""
        kept = tuple(sorted((*self.reduced.kept, i)))
        gone = tuple(k for k in self.reduced.gone if k != i)
        rows = [k for k, j in enumerate(self.reduced.gone) if j != i]
        floor = self.reduced.floor[np.ix_(rows, rows)]
        return Reduced(self.reduced.potential, kept, gone, floor)

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
