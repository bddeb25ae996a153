"""No motion without loss: derives ∇V = 0 along solutions that stay where V is constant.

By exhaustive forward chaining with the rules of
:mod:`necc_casadi.certificate.claims.motions`. For Φ = H + Hc + C, linear Casimirs and constant
Jcl, Rcl, 𝒢. LaSalle: every solution from a compact invariant set then tends to the critical
points of V in it; where all solutions are bounded, every solution does.

What is not derived is not refuted: a plant that no input feels may swing for ever.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import sympy as sp
from flint import fmpq, fmpq_mat

from necc_casadi.certificate.claims.motions import Rule, Step
from necc_casadi.certificate.prover.arithmetic.boxes import matrix_enclosure, subdivide
from necc_casadi.certificate.prover.arithmetic.definite import positive_definite
from necc_casadi.certificate.prover.arithmetic.hessian_floor import hessian_floor
from necc_casadi.certificate.prover.arithmetic.intervals import Interval, matmul, point
from necc_casadi.designs.design import Design
from necc_casadi.symbolic.zero import is_zero

__all__ = ["no_motion_without_loss"]

#: Cells on which an expression of the states is bounded, in all; half a period, a little more.
_CELLS, _HALF_PERIOD = 1024, 3.15
#: Analytic wherever they are finite, and of one value: such a function that vanishes on an
#: interval vanishes everywhere.
_ANALYTIC = (sp.sin, sp.cos, sp.tan, sp.sinh, sp.cosh, sp.tanh, sp.exp)


def no_motion_without_loss(
    design: Design, resting: Sequence[int], z_bar: Interval, box: Interval | None
) -> tuple[Step, ...] | None:
    """Steps that lead to ∇V = 0; None where none are found.

    Parameters
    ----------
    design
        With H = ½ sᵀA(y)s + U(y) in the `resting` states s, which no Casimir contains.
    z_bar
        Holds the critical point z̄, (N,).
    box
        Holds the compact set, (N,); None for the whole space, where solutions are bounded.
    """
    loop = design.loop
    structure = [*loop.J, *loop.R]
    slopes = [sp.diff(c, s) for c in design.casimirs.functions for s in loop.z]
    constant = all(e.is_Rational for e in structure) and not any(e.free_symbols for e in slopes)
    if not constant or design.form.phi is not None or design.form.betas:
        return None
    with np.errstate(all="ignore"):
        known = _Known(design, tuple(resting), z_bar, box)
        return known.derivation() if known.has_inertia else None


@dataclass
class _Known:
    """What is known of a solution on which V stays constant."""

    design: Design
    resting: tuple[int, ...]
    z_bar: Interval
    box: Interval | None
    constant: set[int] = field(default_factory=set)  # states
    steady: set[int] = field(default_factory=set)  # entries of w
    placed: set[int] = field(default_factory=set)  # constant states that are as at z̄
    zero: list[list[fmpq]] = field(default_factory=list)  # forms with aᵀw = 0

    def __post_init__(self) -> None:
        loop = self.design.loop
        rows = [*sp.Matrix(loop.ports.T).tolist(), *sp.Matrix(loop.R).tolist()]
        constant = [row for row in rows if all(e.is_Rational for e in row)]
        self.zero = [_exact(row) for row in constant if any(row)]

    # --- the plant --------------------------------------------------------------------------------

    @cached_property
    def _rates(self) -> list[list[fmpq]]:
        """Rows of Jcl."""
        return [_exact(row) for row in sp.Matrix(self.design.loop.J).tolist()]

    @cached_property
    def _inertia(self) -> sp.Matrix:
        """A⁻¹, so that s = A⁻¹w_s."""
        return self._kinetic.inv().applyfunc(sp.simplify) if self.resting else sp.zeros(0)

    @cached_property
    def _kinetic(self) -> sp.Matrix:
        """A."""
        s = [self.design.loop.z[i] for i in self.resting]
        return sp.hessian(self.design.loop.plant.H, s)

    @cached_property
    def has_inertia(self) -> bool:
        """Whether A⁻¹ is finite, so that A is regular."""
        regular = not self.resting or is_zero(self._kinetic.det()) is False
        return regular and all(self._finite(e) for e in self._inertia)

    @cached_property
    def _pull(self) -> list[sp.Expr]:
        """∂U/∂z: what H adds to w with the momenta at rest."""
        loop = self.design.loop
        U = loop.plant.H.subs({loop.z[i]: 0 for i in self.resting})
        return [sp.diff(U, s) for s in loop.z]

    def _states_in(self, expr: sp.Expr | sp.Matrix) -> set[int]:
        return {i for i, s in enumerate(self.design.loop.z) if s in expr.free_symbols}

    def _is_controller(self, i: int) -> bool:
        return i >= self.design.loop.plant.n

    @property
    def _xi(self) -> list[int]:
        return list(range(self.design.loop.plant.n, self.design.loop.n))

    # --- forms ------------------------------------------------------------------------------------

    def _unit(self, i: int) -> list[fmpq]:
        return [fmpq(int(i == j)) for j in range(self.design.loop.n)]

    def vanishes(self, form: list[fmpq], extra: Iterable[int] = ()) -> bool:
        """Whether aᵀw is a combination of zeros and of entries of w that are named."""
        rows = [*self.zero, *(self._unit(i) for i in extra)]
        return _rank([*rows, form]) == _rank(rows)

    def _is_steady(self, i: int) -> bool:
        return i in self.steady or self.vanishes(self._unit(i), self.steady)

    @property
    def _moving(self) -> list[int]:
        """Momenta whose velocity may differ from 0, positions in `resting`."""
        return [k for k, i in enumerate(self.resting) if not self.vanishes(self._unit(i))]

    def _only_pulled(self, i: int) -> bool:
        """Whether ∂H/∂zᵢ = ∂U/∂zᵢ, since ∂(½ sᵀAs)/∂zᵢ = −½ w_sᵀ(∂A⁻¹/∂zᵢ)w_s vanishes."""
        if i in self.resting:
            return False
        at, symbol = self._moving, self.design.loop.z[i]
        return all(is_zero(sp.diff(self._inertia[a, b], symbol)) is True for a in at for b in at)

    # --- premises ---------------------------------------------------------------------------------

    def holds(self, step: Step) -> bool:
        """Whether the premises of a step are proved."""
        premises: dict[Rule, Callable[..., bool]] = {
            "rate": self._rate, "steady": self._steady, "level": self._level,
            "convex": self._convex, "momentum": self._momentum, "inertia": self._moves_inertia,
            "swing": self._swing, "placed": self._placed, "linear": self._linear,
        }  # fmt: skip
        return premises[step.rule](*step.states)

    def _rate(self, i: int) -> bool:
        return self.vanishes(self._rates[i], self.steady)

    def _steady(self, i: int) -> bool:
        if self._is_controller(i):
            return set(self._xi) <= self.constant
        return self._only_pulled(i) and self._states_in(self._pull[i]) <= self.constant

    def _level(self, i: int, other: int) -> bool:
        if self._is_controller(i) or not (self._is_steady(i) and self._only_pulled(i)):
            return False
        pull, symbol = self._pull[i], self.design.loop.z[other]
        used = self._states_in(pull)
        if used - self.constant != {other}:
            return False
        slope = sp.diff(pull, symbol)
        if used == {other} and _is_analytic(pull):
            return is_zero(slope) is False
        return self._keeps_sign(slope, ())

    def _convex(self, *states: int) -> bool:
        free = [i for i in self._xi if i not in self.constant]
        if not free or list(states) != free or not all(map(self._is_steady, free)):
            return False
        at = np.array(free) - self.design.loop.plant.n
        floor = self._network_floors[1]
        return bool(positive_definite(floor[np.ix_(at, at)][None])[0])

    def _factors(self, j: int) -> list[int]:
        """Velocities that s_j is made of, positions in `resting`."""
        row = self.resting.index(j)
        return [k for k in self._moving if is_zero(self._inertia[row, k]) is not True]

    def _momentum(self, j: int) -> bool:
        if j not in self.resting:
            return False
        row = self.resting.index(j)
        return all(
            self._is_steady(self.resting[k])
            and self._states_in(self._inertia[row, k]) <= self.constant
            for k in self._factors(j)
        )

    def _is_driven(self, j: int, other: int) -> sp.Expr | None:
        """(A⁻¹)_jl where s_j = (A⁻¹)_jl w_l is constant."""
        if j not in self.constant or j not in self.resting:
            return None
        factors = self._factors(j)
        if [self.resting[k] for k in factors] != [other]:
            return None
        return self._inertia[self.resting.index(j), factors[0]]

    def _moves_inertia(self, j: int, other: int) -> bool:
        factor = self._is_driven(j, other)
        if factor is None or not self._states_in(factor) <= self.constant:
            return False
        return self._keeps_sign(factor, self.placed)

    def _swing(self, j: int, other: int, k: int) -> bool:
        factor = self._is_driven(j, other)
        if factor is None or self._states_in(factor) != {k} or not _is_analytic(factor):
            return False
        turned = self.vanishes(self._rates[k], (other,)) and not self.vanishes(self._rates[k])
        return turned and is_zero(factor) is False

    def _placed(self, *states: int) -> bool:
        mine = set(states)
        if not mine or list(states) != sorted(mine) or not mine <= self.constant:
            return False
        if not all(self.vanishes(self._unit(i)) for i in states):
            return False
        controlled = mine & set(self._xi)
        if controlled and controlled != set(self._xi):
            return False
        plant = [i for i in states if not self._is_controller(i)]
        apart = all(self._only_pulled(i) and self._states_in(self._pull[i]) <= mine for i in plant)
        seen = [self._states_in(c) for c in self.design.casimirs.functions]
        if not apart or not all(s <= mine for s in seen):
            return False
        return self._is_injective(states)

    def _linear(self, *states: int) -> bool:
        return bool(states) and set(states) <= set(self._stiff)

    @cached_property
    def _stiff(self) -> dict[int, list[fmpq]]:
        """∇(∂H/∂zᵢ) of the plant's states i in which it is a constant vector of fractions."""
        loop = self.design.loop
        found = {}
        for i in range(loop.plant.n):
            slope = sp.diff(loop.plant.H, loop.z[i])
            row = [sp.diff(slope, s) for s in loop.z]
            if all(e.is_Rational for e in row):
                found[i] = _exact(row)
        return found

    def _rates_of_zeros(self, states: Sequence[int]) -> list[list[fmpq]]:
        """Rates of the forms that vanish and are made of the w of these states alone."""
        count = self.design.loop.n
        order = [i for i in range(count) if i not in states] + sorted(states)
        if not self.zero:
            return []
        reduced, rank = fmpq_mat([[row[i] for i in order] for row in self.zero]).rref()
        rates = []
        for row in reduced.tolist()[:rank]:
            form = dict(zip(order, row, strict=True))
            if any(bool(form[i]) for i in range(count) if i not in states):
                continue
            slope = _combined([(form[i], self._stiff[i]) for i in states])
            rates.append(_combined(list(zip(slope, self._rates, strict=True))))
        return rates

    # --- values over the set ----------------------------------------------------------------------

    @cached_property
    def _network_floors(self) -> tuple[Interval, Interval]:
        """Matrices below ∇²K and ∇²Hc."""
        form = self.design.form
        of_hc, of_k = form.split(self.design.weights)[:2]
        return hessian_floor(form.k, of_k), hessian_floor(form.hc, of_hc)

    def _is_injective(self, states: Sequence[int]) -> bool:
        """Whether ∇V in some states, as a function of them alone, has a positive Jacobian."""
        K, Hc = self._network_floors
        symbols = [self.design.loop.z[i] for i in states]
        functions = self.design.casimirs.functions
        slopes = sp.Matrix([[sp.diff(c, s) for s in symbols] for c in functions])
        N = matrix_enclosure(slopes, [], point(np.zeros((1, 0))))[0]
        added = matmul(Interval(N.lo.T, N.hi.T), matmul(K, N))
        lo, hi = added.lo.copy(), added.hi.copy()
        rows = [k for k, i in enumerate(states) if self._is_controller(i)]
        if rows:
            lo[np.ix_(rows, rows)] += Hc.lo
            hi[np.ix_(rows, rows)] += Hc.hi
        wide = Interval(np.nextafter(lo, -np.inf), np.nextafter(hi, np.inf))
        stiffness = sp.Matrix([[sp.diff(self._pull[i], s) for s in symbols] for i in states])
        enclosed = self._enclosed(stiffness, ())
        return enclosed is not None and bool(positive_definite(enclosed + wide).all())

    def _keeps_sign(self, expr: sp.Expr, at_z_bar: Iterable[int]) -> bool:
        found = self._enclosed(sp.Matrix([[expr]]), at_z_bar)
        return found is not None and bool((found.lo > 0).all() or (found.hi < 0).all())

    def _finite(self, expr: sp.Expr) -> bool:
        found = self._enclosed(sp.Matrix([[expr]]), ())
        return found is not None and bool(np.isfinite(found.lo + found.hi).all())

    def _enclosed(self, matrix: sp.Matrix, at_z_bar: Iterable[int]) -> Interval | None:
        """Over cells of the set, (cells, rows, columns), some states being as at z̄.

        None where a state is not bounded and the matrix not periodic in it.
        """
        known, used = set(at_z_bar), sorted(self._states_in(matrix))
        lo, hi = [], []
        for i in used:
            side = self._side(i, matrix, i in known)
            if side is None:
                return None
            lo.append(side[0])
            hi.append(side[1])
        free = [k for k, i in enumerate(used) if i not in known]
        parts = int(_CELLS ** (1 / max(1, len(free))))
        cells = subdivide(Interval(np.array(lo)[free], np.array(hi)[free]), parts)
        wide = [np.tile(np.array(end, float), (cells.shape[0], 1)) for end in (lo, hi)]
        wide[0][:, free], wide[1][:, free] = cells.lo, cells.hi
        return matrix_enclosure(matrix, [self.design.loop.z[i] for i in used], Interval(*wide))

    def _side(self, i: int, matrix: sp.Matrix, at_z_bar: bool) -> tuple[float, float] | None:
        if at_z_bar:
            return float(self.z_bar.lo[i]), float(self.z_bar.hi[i])
        if self.box is not None:
            return float(self.box.lo[i]), float(self.box.hi[i])
        symbol = self.design.loop.z[i]
        turned = matrix.subs(symbol, symbol + 2 * sp.pi) - matrix
        if all(is_zero(entry) is True for entry in turned):
            return -_HALF_PERIOD, _HALF_PERIOD
        return None

    # --- chaining ---------------------------------------------------------------------------------

    def apply(self, step: Step) -> None:
        """Add what a step concludes."""
        first = step.states[0]
        if step.rule == "steady":
            self.steady.add(first)
        elif step.rule == "inertia":
            self.steady.add(step.states[1])
        elif step.rule == "placed":
            self.placed |= set(step.states)
        elif step.rule == "linear":
            self.zero += self._rates_of_zeros(step.states)
        else:
            of = {"level": step.states[1:], "convex": step.states, "swing": step.states[2:]}
            for i in of.get(step.rule, step.states):
                self.constant.add(i)
                self.zero.append(self._rates[i])

    def derivation(self) -> tuple[Step, ...] | None:
        """Steps until nothing is left, or None where they end before."""
        steps = []
        while _rank(self.zero) < self.design.loop.n:
            step = next((s for s in self._candidates() if self.holds(s)), None)
            if step is None:
                return None
            self.apply(step)
            steps.append(step)
        return tuple(steps)

    def _candidates(self) -> Iterator[Step]:
        """Steps that would add something, the cheapest to prove first."""
        count = self.design.loop.n
        free = [i for i in range(count) if i not in self.constant]
        yield from (Step("rate", (i,)) for i in free)
        yield from (Step("momentum", (i,)) for i in free if i in self.resting)
        linear = tuple(self._stiff)
        if not all(map(self.vanishes, self._rates_of_zeros(linear))):
            yield Step("linear", linear)
        unsteady = [i for i in range(count) if i not in self.resting and i not in self.steady]
        yield from (Step("steady", (i,)) for i in unsteady)
        yield from (Step("level", (i, k)) for i in range(count) for k in free)
        yield Step("convex", tuple(i for i in self._xi if i in free))
        for j in self.resting:
            if j in self.constant:
                yield from self._driven(j)
        found = self._placeable()
        if set(found) - self.placed:
            yield Step("placed", found)

    def _driven(self, j: int) -> Iterator[Step]:
        for other in [self.resting[k] for k in self._factors(j)]:
            if other not in self.steady:
                yield Step("inertia", (j, other))
                yield from (
                    Step("swing", (j, other, k))
                    for k in range(self.design.loop.n)
                    if k not in self.constant
                )

    def _placeable(self) -> tuple[int, ...]:
        """Constant states whose w vanishes and depends on them alone."""
        found = {
            i
            for i in self.constant
            if i not in self.resting and self.vanishes(self._unit(i)) and i not in self.placed
        }
        while True:
            outside = {
                i
                for i in found
                if not self._is_controller(i) and not self._states_in(self._pull[i]) <= found
            }
            if not outside:
                return tuple(sorted(found))
            found -= outside


def _exact(row: Sequence[sp.Expr]) -> list[fmpq]:
    return [fmpq(int(e.p), int(e.q)) for e in map(sp.Rational, row)]


def _combined(parts: Sequence[tuple[fmpq, list[fmpq]]]) -> list[fmpq]:
    """Σ factor · row."""
    columns = zip(*(row for _, row in parts), strict=True)
    factors = [factor for factor, _ in parts]
    return [sum((f * e for f, e in zip(factors, c, strict=True)), fmpq(0)) for c in columns]


def _rank(rows: list[list[fmpq]]) -> int:
    return int(fmpq_mat(rows).rank()) if rows else 0


def _is_analytic(expr: sp.Expr) -> bool:
    """Whether an expression is made of functions of this kind and of whole powers alone."""
    return all(
        part.is_Atom
        or part.is_Add
        or part.is_Mul
        or (isinstance(part, sp.Pow) and part.exp.is_Integer)
        or isinstance(part, _ANALYTIC)
        for part in sp.preorder_traversal(expr)
    )
