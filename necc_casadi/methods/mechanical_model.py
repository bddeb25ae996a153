"""Mechanical plants with one unactuated direction, and their partial linearisation.

x = (q, p),  H = ½pᵀM⁻¹(q)p + V(q),  J canonical,  R = [0, 0; 0, D],  G = [0; B(q)],
rank B = dim q − 1                                        docs/theory.md#mechanical-structures

With B⊥B = 0 and v = M⁻¹p, B⊥(Mv̇ + …) = 0 is a row that no input enters. Divided by its entry at
one coordinate q_r it reads  g⊥v̇ = −s(q) + vᵀΓ(q)v − friction;  the accelerations of the other
coordinates are free inputs.

References
----------
Spong (1994), partial feedback linearisation.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import sympy as sp

from necc_casadi.model.plant import Plant
from necc_casadi.symbolic.derivatives import gradient, value_at
from necc_casadi.symbolic.expressions import complexity
from necc_casadi.symbolic.linear_algebra import kernel, tidy
from necc_casadi.symbolic.zero import is_zero, sign

__all__ = ["FreeRow", "MechanicalModel", "mechanical_model", "short"]


#: Symbols, powers and functions of a kinetic energy beyond which M takes minutes: three links.
_LONGEST = 45


@dataclass(frozen=True, eq=False)
class FreeRow:
    """g⊥(q) v̇ = −s(q) + vᵀΓ(q)v − d(q, v), with g⊥ᵣ = 1."""

    r: int  # place of q_r
    g_perp: sp.ImmutableMatrix  # 1 × k
    s: sp.Expr
    gamma: sp.ImmutableMatrix  # Γ, k × k, symmetric
    friction: sp.Expr  # d, of q and v
    input_rows: tuple[int, ...]  # k − 1 rows of B that are independent at the target

    def dependence(self, q: Sequence[sp.Symbol]) -> str:
        """Which coordinates each of its functions depends on, in words."""
        parts = []
        for name, entry in (("g⊥", self.g_perp), ("s", self.s), ("Γ", self.gamma)):
            seen = [str(s) for s in q if s in entry.free_symbols]
            zero = isinstance(entry, sp.MatrixBase) and entry.is_zero_matrix
            constant = "is 0" if zero else "is constant"
            parts.append(f"{name} {'depends on ' + ' and '.join(seen) if seen else constant}")
        return f"{', '.join(parts[:-1])} and {parts[-1]}"


@dataclass(frozen=True, eq=False)
class MechanicalModel:
    """A mechanical plant with k coordinates and k − 1 inputs."""

    plant: Plant
    q: tuple[sp.Symbol, ...]  # (k,)
    p: tuple[sp.Symbol, ...]  # (k,)
    v: tuple[sp.Symbol, ...]  # (k,) velocities, as symbols of their own
    inverse_mass: sp.ImmutableMatrix  # M⁻¹(q), k × k
    potential: sp.Expr  # V(q)
    damping: sp.ImmutableMatrix  # D, k × k
    inputs: sp.ImmutableMatrix  # B(q), k × k − 1

    @property
    def k(self) -> int:
        """Number of coordinates."""
        return len(self.q)

    @cached_property
    def mass(self) -> sp.ImmutableMatrix:
        """M(q), as the model file has it where it does."""
        if self.plant.inertia is not None:
            return sp.ImmutableMatrix(sp.Matrix(self.plant.inertia).applyfunc(short))
        return sp.ImmutableMatrix(sp.Matrix(self.inverse_mass).inv().applyfunc(short))

    @cached_property
    def velocity(self) -> sp.ImmutableMatrix:
        """M⁻¹p."""
        return self.inverse_mass * sp.Matrix(self.p)

    @cached_property
    def coriolis(self) -> sp.ImmutableMatrix:
        """Ṁv − ½∇_q(vᵀMv) =: c, of q and v: Mv̇ + c + ∇V + Dv = Bu."""
        v = sp.Matrix(self.v)
        momentum = self.mass * v
        kinetic = (v.T * self.mass * v)[0] / 2
        return sp.ImmutableMatrix(momentum.jacobian(self.q) * v - gradient(kinetic, self.q))

    def free_rows(self, x_star: Mapping[sp.Symbol, sp.Expr]) -> Iterator[FreeRow]:
        """The row that no input enters, divided by each of its entries that is not 0 at x*."""
        annihilator = kernel(sp.Matrix(self.inputs).T).T
        unactuated = _nonzero(annihilator, x_star)
        if not unactuated:
            return
        rows = tuple(i for i in range(self.k) if i != unactuated[0])
        row = (annihilator * self.mass).applyfunc(short)
        slope = gradient(self.potential, self.q)
        loss = self.damping * sp.Matrix(self.v)
        curving = sp.hessian((annihilator * self.coriolis)[0], self.v)
        for r in _nonzero(row, x_star):
            pivot = row[r]
            yield FreeRow(
                r,
                sp.ImmutableMatrix((row / pivot).applyfunc(short)),
                short((annihilator * slope)[0] / pivot),
                sp.ImmutableMatrix((-curving / (2 * pivot)).applyfunc(short)),
                short((annihilator * loss)[0] / pivot),
                rows,
            )


def mechanical_model(plant: Plant) -> MechanicalModel | str:
    """`plant` as a mechanical one with one unactuated direction, or what it lacks, in words."""
    n = plant.n
    if n % 2 or n < 4:
        return "the states are no two or more coordinates followed by their momenta"
    k = n // 2
    q, p = plant.x[:k], plant.x[k:]
    canonical = sp.zeros(n)
    canonical[:k, k:], canonical[k:, :k] = sp.eye(k), -sp.eye(k)
    if sp.ImmutableMatrix(canonical) != plant.J:
        return "J is not canonical in the states (q, p)"
    if plant.m != k - 1 or not plant.G[:k, :].is_zero_matrix:
        return f"G is not that of {k - 1} forces on {k} coordinates"
    inputs, damping = plant.G[k:, :], plant.R[k:, k:]
    if not plant.R[:k, :].is_zero_matrix:
        return "R damps coordinates"
    if (inputs.free_symbols | damping.free_symbols) & set(p):
        return "G or R depends on momenta"
    potential = plant.H.subs(dict.fromkeys(p, 0))
    if complexity(plant.H) - complexity(potential) > _LONGEST:
        return "its kinetic energy is too long"
    inverse_mass = sp.hessian(plant.H, p).applyfunc(short)
    kinetic = (sp.Matrix([p]) * inverse_mass * sp.Matrix(p))[0] / 2
    if inverse_mass.free_symbols & set(p) or is_zero(plant.H - kinetic - potential) is not True:
        return "H is not ½pᵀM⁻¹(q)p + V(q)"
    return MechanicalModel(
        plant,
        q,
        p,
        tuple(sp.Dummy(f"v_{s}", real=True) for s in q),
        sp.ImmutableMatrix(inverse_mass),
        potential,
        damping,
        inputs,
    )


def _nonzero(row: sp.MatrixBase, x_star: Mapping[sp.Symbol, sp.Expr]) -> list[int]:
    """Places of the entries that are proved to differ from 0 at the target."""
    return [i for i, entry in enumerate(row) if sign(value_at(entry, x_star)) in (1, -1)]


def short(expr: sp.Expr) -> sp.Expr:
    """The same function as one fraction in lowest terms: sin² as 1 − cos², no surd below.

    Much faster than a search for the shortest form, and nearly as short for what is formed from M.
    """
    expr = sp.sympify(expr)
    if not expr.free_symbols:
        return tidy(expr)
    expr = sp.expand_trig(expr.replace(sp.tan, lambda a: sp.sin(a) / sp.cos(a)))
    names = dict[sp.Expr, sp.Expr]()
    relations = list[tuple[sp.Expr, sp.Symbol]]()
    for angle in sorted({f.args[0] for f in expr.atoms(sp.sin, sp.cos)}, key=str):
        c, d = sp.Dummy("c"), sp.Dummy("d")
        names |= {sp.cos(angle): c, sp.sin(angle): d}
        relations.append((c**2 + d**2 - 1, d))
    for radicand in sorted({e.base for e in expr.atoms(sp.Pow) if _is_surd(e)}, key=str):
        w = sp.Dummy("w")
        names |= {sp.sqrt(radicand): w, 1 / sp.sqrt(radicand): w / radicand}
        relations.append((w**2 - radicand, w))
    numerator, denominator = sp.fraction(sp.together(expr.xreplace(names)))
    for relation, s in relations:
        mirrored = sp.rem(sp.expand(denominator), relation, s).subs(s, -s)
        factor = mirrored if mirrored.has(s) else sp.Integer(1)
        numerator = sp.rem(sp.expand(numerator * factor), relation, s)
        denominator = sp.rem(sp.expand(denominator * factor), relation, s)
    numerator, denominator = sp.fraction(sp.cancel(numerator / denominator))
    result = sp.factor_terms(numerator) / sp.factor(denominator)
    return result.xreplace({s: e for e, s in names.items() if s.is_Symbol})


def _is_surd(power: sp.Pow) -> bool:
    """Whether it is the square root of a rational number, or one over that."""
    return power.base.is_Rational and abs(power.exp) == sp.Rational(1, 2)
