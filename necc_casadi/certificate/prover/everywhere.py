"""A family in the whole space: every V_ϑ convex with the momenta at rest, and where it rests.

With momenta s, Ĥ = ½sᵀA(y; ϑ)s + U(y; ϑ), and linear Casimirs, ∂²V_ϑ/∂y² is that of U, which a
set-point only shifts along y, and matrices below ∇²K and ∇²Hc for all arguments. Where it is
⪰ F ≻ 0 and A ≻ 0 for every y and ϑ, V_ϑ is radially unbounded, has one critical point z̄(ϑ), and

    (z̄ − z*)ᵀF(z̄ − z*) ≤ gᵀF⁻¹g,   g = ∂V_ϑ/∂y (z*),

so that |z̄ᵢ − zᵢ*|² ≤ (F⁻¹)ᵢᵢ gᵀF⁻¹g (docs/theory.md#families).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import sympy as sp

from necc_casadi.arrays import Truth, Vector
from necc_casadi.certificate.claims.claim import Claim
from necc_casadi.certificate.claims.everywhere import EverywhereClaim, Gathers, everywhere
from necc_casadi.certificate.claims.regions import rows
from necc_casadi.certificate.claims.statements import NotEverywhere, not_everywhere
from necc_casadi.certificate.prover.arithmetic.boxes import matrix_enclosure, subdivide
from necc_casadi.certificate.prover.arithmetic.definite import inverse, positive_definite
from necc_casadi.certificate.prover.arithmetic.hessian_floor import sharpest_floor
from necc_casadi.certificate.prover.arithmetic.intervals import (
    Interval,
    concatenate,
    matmul,
    point,
)
from necc_casadi.certificate.prover.arithmetic.smooth import is_smooth_everywhere, written
from necc_casadi.certificate.prover.family import Minima, open_condition
from necc_casadi.certificate.prover.invariant_sets import (
    OverBox,
    largest_invariant_set_is_critical,
)
from necc_casadi.certificate.prover.region.critical_box import is_periodic
from necc_casadi.designs.family import Family
from necc_casadi.symbolic.derivatives import sparse_hessian
from necc_casadi.symbolic.floats import to_float
from necc_casadi.symbolic.zero import is_zero

__all__ = ["Whole", "prove_everywhere"]


#: Half a period, a little more than π.
_HALF_PERIOD = 3.15


#: First cells in all, those at most, and rounds in which cells that fail are halved.
_CELLS, _MOST, _ROUNDS = 4096, 1 << 17, 6


#: Of the least eigenvalue that is seen at points: by how much of it F is lower, in turn.
_SHARES = (0.05, 0.2, 0.5, 0.9)


#: Of the squares of the errors: more than other arithmetic may find them to be.
_ROOM = 1.01


def prove_everywhere(family: Family) -> Claim:
    """Every V_ϑ is radially unbounded, with one critical point, and what follows."""
    found = _proved(family)
    if not isinstance(found, EverywhereClaim):
        return Claim("everywhere", False, not_everywhere(found))
    ranges = {p.name: (to_float(p.range[0]), to_float(p.range[1])) for p in family.parameters}
    measured = bool(family.moved.of("uncertain"))
    text = everywhere(ranges, found.error, family.state_units, measured, found.follows)
    return Claim("everywhere", True, text, found.data)


def _proved(family: Family) -> EverywhereClaim | NotEverywhere:
    whole = Whole(family)
    if whole.missing is not None:
        return whole.missing
    if not whole.is_smooth:
        return "energy, structure and Casimirs are not proved to be smooth for all states"
    if not (whole.has_momenta and whole.has_inertia):
        return "the inertia is not proved positive definite for every state"
    floor = whole.floor
    if floor is None:
        return "V is not proved to be convex for every parameter, the momenta at rest"
    _, bends = whole.networks
    return EverywhereClaim(
        family.hash, whole.active, rows(floor), bends, whole.errors(floor), whole.follows
    )


@dataclass(frozen=True, eq=False)
class Whole:
    """What is to be proved for all states and ϑ, in natural units of the states."""

    family: Family

    @cached_property
    def minima(self) -> Minima:
        """Slopes of V_ϑ at the target, and the ranges."""
        return Minima(self.family)

    @cached_property
    def active(self) -> tuple[int, ...]:
        """The states y."""
        resting = self.family.design.momenta
        return tuple(i for i in range(self.minima.design.loop.n) if i not in resting)

    @cached_property
    def momenta(self) -> list[sp.Symbol]:
        """The other states, which rest at 0."""
        return [self.minima.design.loop.z[i] for i in self.family.design.momenta]

    @cached_property
    def y(self) -> list[sp.Symbol]:
        """The states that are left."""
        return [self.minima.design.loop.z[i] for i in self.active]

    @cached_property
    def potential(self) -> sp.Expr:
        """U of y and ϑ."""
        H = self.minima.design.loop.plant.H
        return H.subs(dict.fromkeys(self.momenta, sp.Integer(0)))

    @cached_property
    def shift(self) -> list[sp.Expr]:
        """x*(r) − x*(r₀), (n,)."""
        units = self.family.design.units.state
        return [
            shift / sp.Rational(*float(unit).as_integer_ratio())
            for shift, unit in zip(self.family.moved.shift, units, strict=False)
        ]

    @cached_property
    def missing(self) -> NotEverywhere | None:
        """What the loop lacks, wherever the states are."""
        design = self.minima.design
        if open_condition(self.family) is not None:
            return "a condition of V falling is open for some of it"
        if design.form.phi is not None or design.form.betas:
            return "only Φ = H + Hc + C with C = K(c) is covered"
        if design.loop.M.free_symbols & set(design.loop.z):
            return "J, R or G depend on the state"
        return None

    @cached_property
    def _place(self) -> dict[sp.Symbol, sp.Expr]:
        """x̂ → x − x*(r) + x*(r₀): no matter where in the space, the set-point drops out."""
        x = self.minima.design.loop.plant.x
        return {s: s - shift for s, shift in zip(x, self.shift, strict=True)}

    def _seen(self, entries: Sequence[sp.Expr]) -> list[sp.Expr]:
        """Expressions by where the plant is, not by its error."""
        return [sp.sympify(e).subs(self._place, simultaneous=True) for e in entries]

    # --- the plant --------------------------------------------------------------------------------

    @cached_property
    def is_smooth(self) -> bool:
        """Whether energy, structure and Casimirs are, for all states and ϑ."""
        design, ranges = self.minima.design, self.minima.ranges
        sides = {s: ranges[i] for i, s in enumerate(self.family.moved.symbols)}
        return is_smooth_everywhere(self._seen(written(design)), design.loop.z, sides)

    @cached_property
    def inertia(self) -> sp.Matrix:
        """A."""
        return sp.Matrix(sparse_hessian(self.minima.design.loop.plant.H, self.momenta))

    @cached_property
    def has_momenta(self) -> bool:
        """Whether Ĥ = ½sᵀA(y; ϑ)s + U(y; ϑ) for every ϑ."""
        s, H = self.momenta, self.minima.design.loop.plant.H
        flat = all(is_zero(sp.diff(a, v)) is True for a in set(self.inertia) for v in s)
        at_rest = dict.fromkeys(s, sp.Integer(0))
        return flat and all(is_zero(sp.diff(H, v).subs(at_rest)) is True for v in s)

    @cached_property
    def has_inertia(self) -> bool:
        """Whether A ≻ 0."""
        return not self.momenta or self._holds(self.inertia, positive_definite)

    # --- curvature --------------------------------------------------------------------------------

    @cached_property
    def networks(self) -> tuple[Interval, tuple[float | None, float | None]]:
        """A matrix below what the networks add to ∂²V/∂y² (d, d), and the bends it rests on."""
        design = self.minima.design
        of_hc, of_k = design.form.split(design.weights)[:2]
        (Hc, first), (K, second) = (
            sharpest_floor(design.form.hc, of_hc),
            sharpest_floor(design.form.k, of_k),
        )
        slopes = sp.Matrix([[sp.diff(c, s) for s in self.y] for c in design.casimirs.functions])
        N = matrix_enclosure(slopes, [], point(np.zeros((1, 0))))[0]
        total = matmul(Interval(N.lo.T, N.hi.T), matmul(K, N))
        lo, hi = (np.zeros(total.shape) for _ in range(2))
        lo[-Hc.shape[0] :, -Hc.shape[0] :], hi[-Hc.shape[0] :, -Hc.shape[0] :] = Hc.lo, Hc.hi
        return total + Interval(lo, hi), (first, second)

    @cached_property
    def _bends(self) -> sp.Matrix:
        """∂²U/∂y²."""
        return sp.Matrix(sparse_hessian(self.potential, self.y))

    @cached_property
    def floor(self) -> Vector | None:
        """F with ∂²V/∂y² ⪰ F ≻ 0; None where none is found."""
        added = self.networks[0]
        cells = self._cells(self._bends)
        if cells is None:
            return None
        at = (self._enclosed(self._bends, point(cells.mid)) + added).mid
        at = (at + np.swapaxes(at, 1, 2)) / 2
        if not np.isfinite(at).all():
            return None
        least = at[int(np.argmin(np.linalg.eigvalsh(at)[:, 0]))]
        # none of the others is lower in any direction
        least = least + min(0.0, float(np.linalg.eigvalsh(at - least).min())) * np.eye(len(least))
        lowest = float(np.linalg.eigvalsh(least)[0])
        for share in _SHARES if lowest > 0 else ():
            F = np.asarray(least - share * lowest * np.eye(len(least)), float)
            if self._holds(self._bends, lambda A, F=F: positive_definite(A + added - F)):  # type: ignore[misc]
                return F
        return None

    def _cells(self, matrix: sp.Matrix) -> Interval | None:
        """Cells (B, used) of what a matrix depends on, ϑ and a period of each state."""
        entries, used = self._by_place(matrix)
        sides = []
        for s in used:
            if s in self.family.moved.symbols:
                sides.append(self.minima.ranges[self.family.moved.symbols.index(s)])
            elif is_periodic([e for e in set(entries) if e.has(s)], s):
                sides.append(Interval(np.array(-_HALF_PERIOD), np.array(_HALF_PERIOD)))
            else:
                return None
        whole = Interval(np.array([v.lo for v in sides]), np.array([v.hi for v in sides]))
        return subdivide(whole, max(2, int(_CELLS ** (1 / max(1, len(sides))))))

    def _by_place(self, matrix: sp.Matrix) -> tuple[sp.ImmutableMatrix, list[sp.Symbol]]:
        """A matrix by where the plant is, and the symbols that are left in it."""
        key = sp.ImmutableMatrix(matrix)
        if key not in self._placed:
            entries = self._seen(list(matrix))
            used = sorted(set().union(*(e.free_symbols for e in entries)), key=str)
            self._placed[key] = sp.ImmutableMatrix(*matrix.shape, entries), used
        return self._placed[key]

    @cached_property
    def _placed(self) -> dict[sp.ImmutableMatrix, tuple[sp.ImmutableMatrix, list[sp.Symbol]]]:
        return {}

    def _enclosed(self, matrix: sp.Matrix, cells: Interval) -> Interval:
        return matrix_enclosure(*self._by_place(matrix), cells)

    def _holds(self, matrix: sp.Matrix, test: Callable[[Interval], Truth]) -> bool:
        """Whether a test of a matrix holds for all states and ϑ; cells that fail are halved."""
        cells = self._cells(matrix)
        if cells is None:
            return False
        for _ in range(_ROUNDS):
            failed = ~test(self._enclosed(matrix, cells))
            if not failed.any():
                return True
            left = cells[np.flatnonzero(failed)]
            at_middle = self._enclosed(matrix, point(left.mid))
            if left.shape[0] * 2 ** left.shape[1] > _MOST or not test(at_middle).all():
                return False
            cells = _cut(left)
        return False

    # --- where it rests, and what follows ---------------------------------------------------------

    def errors(self, floor: Vector) -> dict[str, float]:
        """|x̄ᵢ − xᵢ*| is at most this for every ϑ, units of the model."""
        minima, n = self.minima, self.minima.design.loop.plant.n
        count = minima.ranges.shape[0]
        theta = subdivide(minima.ranges, max(2, int(_CELLS ** (1 / count))))
        own = minima.networks.jet(minima.target[None]).grad[0]
        energy = minima.slope_at_target(theta)
        lo, hi = (np.tile(side, (theta.shape[0], 1)) for side in (own.lo, own.hi))
        lo[:, :n], hi[:, :n] = (own[:n] + energy).lo, (own[:n] + energy).hi
        g = Interval(lo, hi)[:, list(self.active)]
        F_inverse = inverse(floor)
        size = float(np.maximum((matmul(F_inverse, g[..., None])[..., 0] * g).sum().hi, 0).max())
        units, names, found = self.family.design.units.state, minima.design.loop.states, {}
        for i in range(n):
            found[names[i]] = 0.0
            if i in self.active:
                k = self.active.index(i)
                square = point(_ROOM * size) * F_inverse[k, k]
                found[names[i]] = float(square.sqrt().hi * units[i])
        return found

    @property
    def follows(self) -> Gathers:
        """Where all solutions go."""
        loop, ranges = self.minima.design.loop, self.minima.ranges
        nowhere = Interval(np.zeros(loop.n), np.zeros(loop.n))
        box = concatenate(nowhere, ranges)
        constants = OverBox((*loop.z, *self.family.moved.symbols), box)
        critical = largest_invariant_set_is_critical(
            self.minima.design, self.family.design.momenta, None, constants
        )
        return "converges" if critical else "stable"


def _cut(cells: Interval) -> Interval:
    """Each cell halved along every axis."""
    for k in range(cells.shape[1]):
        middle = cells.mid[:, k]
        low, high = cells.hi.copy(), cells.lo.copy()
        low[:, k], high[:, k] = middle, middle
        cells = concatenate(Interval(cells.lo, low), Interval(high, cells.hi))
    return cells
