"""One loop for many set-points and plants: seen from the set-point, only H changes.

Let c be linear, N = ∂c/∂z, and x*(r) an equilibrium for each r. With x̂ = x − x*(r) + x*(r₀), and
r as the set-point at run time,

    K(c; r) = K(c − c*(r) + c₀) + Δλᵀ(c − c*(r)),   Hc(ξ; r) = Hc(ξ) − ΔλᵀN_ξ(ξ − ξ*),
    N_xᵀΔλ(r) = −(∇H(x*(r)) − ∇H(x*(r₀)))

give V = Ĥ(x̂; r) + Hc(ξ) + K(c(x̂, ξ)) with Ĥ = H(x̂ + x*(r) − x*(r₀)) + Δλ(r)ᵀN_x x̂: the V of the
design at r₀, with another energy. ∇Ĥ at x̂ = x*(r₀) does not depend on r, so that the gradient
condition holds for every r and all weights. What is added to u is GcᵀN_ξᵀΔλ(r).

Unknown constants θ of the plant stand in Ĥ as they do in H. A gain ρ(θ) > 0 with G(θ) = ρ G makes
(ρJ, ρR, ρG, H/ρ) of (J, R, ρG, H): the same motion, and the same measured y = Gᵀ∇H. A constant
disturbance d of u is H − dᵀη with (J − R)∇η = −G and Gᵀ∇η = 0. The controller holds neither θ nor
d: it takes y as it is measured (docs/theory.md#families).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import sympy as sp

from necc_casadi.model.closed_loop import ClosedLoop
from necc_casadi.model.control_affine import Equilibria
from necc_casadi.model.family_loop import FamilyLoop, NoFamily, Parameter, Reason
from necc_casadi.model.parametric import Parametric
from necc_casadi.model.plant import Plant
from necc_casadi.model.ranges import Ranges
from necc_casadi.model.shaped_loop import ShapedLoop
from necc_casadi.symbolic.derivatives import gradient
from necc_casadi.symbolic.elimination import eliminated
from necc_casadi.symbolic.linear_algebra import generic_rank
from necc_casadi.symbolic.semidefinite import is_positive_semidefinite
from necc_casadi.symbolic.zero import Undecided, is_zero

__all__ = ["family_loop"]


#: Places of a range at which a witness is looked for, as shares of its width.
_PLACES = tuple(sp.Rational(k, 8) for k in (8, 0, 6, 2, 7, 1, 5, 3))


def family_loop(
    loop: ClosedLoop,
    casimirs: Sequence[sp.Expr],
    x_star: Sequence[sp.Expr],
    ranges: Ranges,
    parametric: Parametric | None = None,
    *,
    phi_is_sum: bool = True,
) -> FamilyLoop | NoFamily:
    """The loop of a design over its ranges, or why there is none.

    Parameters
    ----------
    loop, casimirs, x_star
        Of the design.
    ranges
        Names are those of states and parameters; checked before.
    parametric
        The plant with its parameters as symbols; needed where some are uncertain.
    phi_is_sum
        Whether Φ = H + Hc + C.
    """
    plant = loop.plant
    if isinstance(loop, ShapedLoop) or plant.preliminary is not None:
        return NoFamily(
            "not_covered",
            "the target is held by another method than interconnection, whose feedback rests on "
            "the model: nothing is known of it with other set-points or parameters",
        )
    if not phi_is_sum:
        return NoFamily(
            "not_covered",
            "Φ is a network: its slope Φ₁ contains the energy, so that set-point and parameters "
            "would stand in the control law",
        )
    parameters = _parameters(loop, x_star, ranges, parametric)
    names = [p.name for p in parameters]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        return NoFamily(
            "not_covered", f"{twice[0]} names a parameter and something else that has a range"
        )
    unknown = [p for p in parameters if p.kind == "uncertain"]
    varied = _with_symbols(plant, unknown, parametric)
    builder = _Builder(loop, tuple(casimirs), tuple(x_star), parameters, varied)
    try:
        return builder.build()
    except _Stop as stop:
        return stop.found
    except Undecided as problem:
        return NoFamily("undecided", f"whether {problem} is zero was not decided")


class _Stop(Exception):
    """Leads out of the construction, with the reason."""

    def __init__(self, reason: Reason, text: str, at: Mapping[str, sp.Expr] | None = None) -> None:
        super().__init__(text)
        self.found = NoFamily(reason, text, at)


def _parameters(
    loop: ClosedLoop, x_star: Sequence[sp.Expr], ranges: Ranges, parametric: Parametric | None
) -> tuple[Parameter, ...]:
    taken = {*loop.states, *(parametric.values if parametric else ())}

    def fresh(name: str) -> sp.Symbol:
        while name in taken:
            name += "_"
        taken.add(name)
        return sp.Symbol(name, real=True)

    at = dict(zip(loop.plant.states, x_star, strict=True))
    found = [
        Parameter(name, "setpoint", fresh(f"r_{name}"), side, at[name])
        for name, side in ranges.setpoints.items()
    ]
    found += [
        Parameter(name, "uncertain", sp.Symbol(name, real=True), side, parametric.values[name])
        for name, side in ranges.uncertain.items()
        if parametric is not None
    ]
    names = loop.plant.input_names
    found += [
        Parameter(f"d_{name}", "disturbance", fresh(f"d_{name}"), side, sp.Integer(0))
        for name, side in zip(names, ranges.disturbance, strict=False)
    ]
    return tuple(found)


def _with_symbols(
    plant: Plant, unknown: Sequence[Parameter], parametric: Parametric | None
) -> Plant:
    """The plant with the uncertain parameters as symbols."""
    if parametric is None or not unknown:
        return plant
    names = {p.name for p in unknown}
    known = {name: v for name, v in parametric.values.items() if name not in names}
    varied = parametric.at(known)
    return replace(plant, J=varied.J, R=varied.R, G=varied.G, H=varied.H)


@dataclass(frozen=True, eq=False)
class _Builder:
    """Each step proves what it rests on."""

    base: ClosedLoop  # of the design, parameters nominal
    casimirs: tuple[sp.Expr, ...]
    target: tuple[sp.Expr, ...]
    parameters: tuple[Parameter, ...]
    plant: Plant  # θ as symbols

    def build(self) -> FamilyLoop:
        """All of it."""
        moved = self._moved_target()
        gain = self._gain()
        plant = self.plant
        structure = [sp.Matrix(m) for m in (plant.J, plant.R)]
        shift = {s: s + m - t for s, m, t in zip(plant.x, moved, self.target, strict=True)}
        J, R = (sp.ImmutableMatrix(gain * m.subs(shift, simultaneous=True)) for m in structure)
        G = sp.ImmutableMatrix(sp.Matrix(plant.G).subs(shift, simultaneous=True))
        self._check_structure(J, R)
        self._check_equilibrium(moved)
        slope = self._slope_of_casimirs(moved)
        energy = plant.H.subs(shift, simultaneous=True) / gain + slope
        measured = replace(plant, J=J, R=R, G=G, H=energy)
        loop = replace(self.base, plant=measured)
        self._check_casimirs(loop)
        return FamilyLoop(loop, self.parameters, moved, self.target, self._feedforward(moved))

    # --- set-points ---------------------------------------------------------------------------

    @property
    def _setpoints(self) -> dict[sp.Symbol, sp.Symbol]:
        """State -> its set-point."""
        states = {str(s): s for s in self.base.plant.x}
        return {states[p.name]: p.symbol for p in self.parameters if p.kind == "setpoint"}

    def _moved_target(self) -> tuple[sp.Expr, ...]:
        """x*(r): the branch of equilibria of the nominal plant on which the target lies."""
        plant, given = self.base.plant, self._setpoints
        at = dict(zip(plant.x, self.target, strict=True))
        if not given:
            return self.target
        branches = _branches(plant, {**given}, at)
        back = {p.symbol: p.nominal for p in self.parameters}
        for branch in branches:
            if all(is_zero(branch[s].subs(back) - at[s]) is True for s in plant.x):
                return tuple(sp.sympify(branch[s]) for s in plant.x)
        raise _Stop(
            "undecided", "no closed form x*(r) of the equilibria through the target was found"
        )

    @cached_property
    def _slopes(self) -> sp.ImmutableMatrix:
        """N = ∂c/∂z, r × N."""
        N = sp.Matrix([[sp.diff(c, s) for s in self.base.z] for c in self.casimirs])
        if N.free_symbols:
            curved = next(c for c in self.casimirs if sp.hessian(c, self.base.z).is_zero_matrix
                          is not True)  # fmt: skip
            raise _Stop(
                "not_covered",
                f"the Casimir {curved} is no linear function of the states, so that a design at "
                "one set-point is none at another, and no disturbance is a part of the energy",
            )
        return sp.ImmutableMatrix(N)

    def _multipliers(self, moved: Sequence[sp.Expr]) -> sp.Matrix:
        """Δλ(r) with N_xᵀΔλ = −(∇H(x*(r)) − ∇H(x*(r₀))), r × 1, of least norm."""
        plant = self.base.plant
        slope = gradient(plant.H, plant.x)
        here = dict(zip(plant.x, self.target, strict=True))
        there = dict(zip(plant.x, moved, strict=True))
        change = sp.Matrix(slope.subs(there, simultaneous=True) - slope.subs(here))
        N = sp.Matrix(self._slopes[:, : plant.n])
        change = change.applyfunc(sp.simplify)
        found = -_pseudo_inverse(N.T) * change
        left = N.T * found + change
        for i, entry in enumerate(left):
            if is_zero(entry) is False:
                raise _Stop(
                    "refused",
                    f"the Casimirs do not see ∂H/∂{plant.x[i]} at x*(r): it changes by "
                    f"{sp.sstr(sp.simplify(entry))}",
                    self._witness(entry),
                )
            if is_zero(entry) is None:
                raise Undecided(entry)
        return sp.Matrix(found)

    def _slope_of_casimirs(self, moved: Sequence[sp.Expr]) -> sp.Expr:
        """Δλᵀ N_x x̂ of the set-point and dᵀPᵀN_x x̂ of the disturbance, a part of Ĥ."""
        plant = self.base.plant
        total: sp.Expr = sp.Integer(0)
        disturbed = [p.symbol for p in self.parameters if p.kind == "disturbance"]
        if not self._setpoints and not disturbed:
            return total
        N = sp.Matrix(self._slopes[:, : plant.n])
        x = sp.Matrix(plant.x)
        if self._setpoints:
            total += (self._multipliers(moved).T * N * x)[0, 0]
        if disturbed:
            total += (sp.Matrix([disturbed]) * self._acting().T * N * x)[0, 0]
        return total

    def _acting(self) -> sp.Matrix:
        """P with (J − R)N_xᵀP = G and GᵀN_xᵀP = 0, r × m: −N_xᵀP is the slope of η."""
        plant, Gc = self.plant, sp.Matrix(self.base.controller.Gc)
        N_x, N_xi = (sp.Matrix(part) for part in self._parts)
        T = Gc.T * N_xi.T
        P = _pseudo_inverse(T)
        residuals = [
            *((plant.J - plant.R) * N_x.T * P * self._gain() - plant.G),
            *(sp.Matrix(plant.G).T * N_x.T * P),
        ]
        if not all(is_zero(entry) is True for entry in residuals):
            raise _Stop(
                "not_covered",
                "the disturbance is no part of the energy: no function η with (J − R)∇η = −G and "
                "Gᵀ∇η = 0 comes with the Casimirs",
            )
        return sp.Matrix(P)

    @property
    def _parts(self) -> tuple[sp.ImmutableMatrix, sp.ImmutableMatrix]:
        """N_x and N_ξ."""
        n = self.base.plant.n
        return self._slopes[:, :n], self._slopes[:, n:]

    def _feedforward(self, moved: Sequence[sp.Expr]) -> sp.ImmutableMatrix:
        m = self.base.plant.m
        if not self._setpoints:
            return sp.ImmutableMatrix(sp.zeros(m, 1))
        N_xi = sp.Matrix(self._parts[1])
        added = sp.Matrix(self.base.controller.Gc).T * N_xi.T * self._multipliers(moved)
        return sp.ImmutableMatrix(added.applyfunc(sp.simplify))

    # --- uncertainty --------------------------------------------------------------------------

    @property
    def _unknown(self) -> set[sp.Symbol]:
        return {p.symbol for p in self.parameters if p.kind == "uncertain"}

    def _gain(self) -> sp.Expr:
        """ρ(θ) with G(θ) = ρ G, positive."""
        own, varied = self.base.plant.G, self.plant.G
        if not varied.free_symbols & self._unknown:
            return sp.Integer(1)
        at = next((i, j) for (i, j), v in own.todok().items() if v != 0)
        ratio = sp.simplify(varied[at] / own[at])
        same = all(is_zero(entry) is True for entry in varied - ratio * own)
        if not same or ratio.free_symbols - self._unknown:
            named = ", ".join(sorted(map(str, varied.free_symbols & self._unknown)))
            raise _Stop(
                "not_covered",
                f"G depends on {named} by more than one factor for all inputs: its directions, or "
                "the gains of single inputs, would have to be known",
            )
        if not self._is_positive(ratio):
            raise _Stop("undecided", f"the gain of the inputs, {ratio}, is not proved positive")
        return sp.sympify(ratio)

    @cached_property
    def _beyond(self) -> dict[sp.Symbol, sp.Expr]:
        """θ = lo + t², t real: what is proved for all t holds on the range."""
        return {
            p.symbol: p.range[0] + sp.Symbol(f"t_{p.name}", real=True) ** 2
            for p in self.parameters
            if p.kind == "uncertain"
        }

    def _is_positive(self, ratio: sp.Expr) -> bool:
        return sp.simplify(ratio.subs(self._beyond)).is_positive is True

    def _check_structure(self, J: sp.ImmutableMatrix, R: sp.ImmutableMatrix) -> None:
        """J skew and R ⪰ 0 for every θ."""
        if not self._unknown & (J.free_symbols | R.free_symbols):
            return
        symmetric = [*(J + J.T), *(R - R.T)]
        if not all(is_zero(entry) is True for entry in symmetric):
            raise _Stop("not_covered", "J is not skew, or R not symmetric, for every parameter")
        if is_positive_semidefinite(sp.Matrix(R.subs(self._beyond))) is not True:
            raise _Stop("undecided", "R ⪰ 0 is not proved for every value of the parameters")

    def _check_equilibrium(self, moved: Sequence[sp.Expr]) -> None:
        """x*(r) is an equilibrium for every θ and r."""
        there = dict(zip(self.plant.x, moved, strict=True))
        for equation in self.plant.equilibrium_equations:
            left = equation.subs(there, simultaneous=True)
            if is_zero(left) is True:
                continue
            where = self._witness(left)
            if where is None:
                raise Undecided(left)
            raise _Stop(
                "refused",
                "x* is no equilibrium for every parameter: no controller holds it for all of "
                f"them, as {sp.sstr(sp.simplify(left))} would have to be 0",
                where,
            )

    def _check_casimirs(self, loop: ClosedLoop) -> None:
        """∇cᵀ(Jcl − Rcl) = 0 for every ϑ, and no unknown in what the controller computes."""
        for c in self.casimirs:
            slope = gradient(c, loop.z)
            for entry in loop.M.T * slope:
                if is_zero(entry) is True:
                    continue
                where = self._witness(entry)
                if where is None:
                    raise Undecided(entry)
                raise _Stop(
                    "refused",
                    f"{c} is no Casimir for every parameter: ∇Cᵀ(Jcl − Rcl) has the entry "
                    f"{sp.sstr(sp.simplify(entry))}",
                    where,
                )
            used = (sp.Matrix(loop.plant.G).T * slope[: loop.plant.n, :]).applyfunc(sp.simplify)
            if used.free_symbols & self._unknown:
                raise _Stop(
                    "not_covered", f"the damping would need Gᵀ∂C/∂x = {used}, which is not known"
                )

    def _witness(self, entry: sp.Expr) -> dict[str, sp.Expr] | None:
        """Values within the ranges for which an expression is not zero."""
        used = [p for p in self.parameters if entry.has(p.symbol)]
        for place in _PLACES:
            values = {p.symbol: p.range[0] + place * (p.range[1] - p.range[0]) for p in used}
            if is_zero(entry.subs(values)) is False:
                return {p.name: values[p.symbol] for p in used}
        return None


def _branches(
    plant: Equilibria, moved: Mapping[sp.Symbol, sp.Symbol], at: Mapping[sp.Symbol, sp.Expr]
) -> list[dict[sp.Symbol, sp.Expr]]:
    """Closed forms of all states along the equilibria, as functions of the set-points.

    A state that the equations leave free keeps its value at the target.
    """
    given: dict[sp.Symbol, sp.Expr] = dict(moved)
    equations = [sp.simplify(e.subs(given)) for e in plant.equilibrium_equations]
    unknown = [s for s in plant.x if s not in given]
    solved, equations = eliminated(equations, unknown)
    rest = [s for s in unknown if s not in solved]
    found: list[dict[sp.Symbol, sp.Expr]] = [{}]
    if equations:
        try:
            found = sp.solve(equations, rest, dict=True)
        except NotImplementedError:
            return []
    result = []
    for branch in found:
        free = {s: at[s] for s in rest if s not in branch}
        values = {s: v.subs(free) for s, v in branch.items()} | free
        whole = given | {s: v.subs(values) for s, v in solved.items()} | values
        result.append(whole)
    return result


def _pseudo_inverse(A: sp.Matrix) -> sp.Matrix:
    """A⁺ of a constant matrix: A⁺v is the solution of least norm where there is one."""
    left, right = A.T * A, A * A.T
    if generic_rank(A) == A.cols:
        return sp.Matrix(left.LUsolve(A.T))
    if generic_rank(A) == A.rows:
        return sp.Matrix(A.T * right.inv())
    raise _Stop("not_covered", "the Casimirs depend on one another in the states that move")
