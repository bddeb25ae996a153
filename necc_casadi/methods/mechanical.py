"""Mechanical target structures of plants with one unactuated direction.

In coordinates and velocities (q, v) the target structure is

    F_d = [0, M_d; −M_d, J₂],   H₀ = ½vᵀM_d⁻¹v + V_d(q)    docs/theory.md#mechanical-structures

and with b = M_d g⊥ᵀ the plant matches it where

    kinetic     ½ b·∇(g⊥b) = (b·∇g⊥)b + bᵀΓb,   g⊥b > 0
    potential   b·∇V_d = s,   with minimum at q* if b·∇s(q*) > 0

Three choices of b that quadratures integrate: M_d constant where Γ = 0, b a function of q_r alone,
and b with constant entries off q_r. What they leave free is chosen by the cost of the linearised
loop (:mod:`necc_casadi.methods.mechanical_response`). The structure is then written in the plant's
own states (q, p), p = M(q)v: F_d becomes T F_d Tᵀ with T = ∂(q, p)/∂(q, v).

With b·∇γ = 0 the functions ξ − γ(q) are Casimirs of the published loop.

References
----------
Ortega, Spong, Gómez-Estern, Blankenstein (2002); Acosta, Ortega, Astolfi, Mahindrakar (2005).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations, combinations_with_replacement

import numpy as np
import sympy as sp

from necc_casadi.errors import ModelError
from necc_casadi.methods.linear_target import Weigh
from necc_casadi.methods.mechanical_model import FreeRow, MechanicalModel, mechanical_model, short
from necc_casadi.methods.mechanical_response import MechanicalResponse, mechanical_response
from necc_casadi.methods.no_structure import NoStructure
from necc_casadi.model.control_affine import Preliminary
from necc_casadi.model.cost import bryson
from necc_casadi.model.matching import Matching
from necc_casadi.model.plant import Plant, make_plant
from necc_casadi.symbolic.derivatives import at, gradient, value_at
from necc_casadi.symbolic.floats import float_matrix, to_float
from necc_casadi.symbolic.quadrature import even_and_odd, quadrature
from necc_casadi.symbolic.zero import Undecided, is_zero, sign

__all__ = ["mechanical_structures"]


#: With b_r = m − μ cos q_r and m : μ = 7 : 25 the roots in the quadratures are rational.
_OWN, _COUPLED, _OTHER = sp.Rational(7, 25), sp.Integer(1), sp.Integer(4)

#: The largest power of a cosine by which β falls off, and how many of them are compared by cost.
_MOST_POWER, _TRIED = 16, 5

#: Costs below this multiple of LQR's are alike.
_ALIKE = 1.5


@dataclass(frozen=True, eq=False)
class _Question:
    """A row that no input enters, at a target."""

    model: MechanicalModel
    row: FreeRow
    x_star: Mapping[sp.Symbol, sp.Expr]
    weigh: Weigh

    @cached_property
    def response(self) -> MechanicalResponse | None:
        """What numbers of a structure cost; None where that is not known."""
        return mechanical_response(self.model, self.row, self.x_star, self.weigh)

    @property
    def q_r(self) -> sp.Symbol:
        return self.model.q[self.row.r]

    @property
    def others(self) -> tuple[int, ...]:
        """Places of the coordinates whose accelerations are inputs."""
        return tuple(a for a in range(self.model.k) if a != self.row.r)

    def at_target(self, expr: sp.Expr) -> sp.Expr:
        return value_at(expr, self.x_star)

    def integral(self, f: sp.Expr) -> sp.Expr | None:
        """∫f dq_r from q_r*."""
        return quadrature(short(f), self.q_r, self.x_star[self.q_r])

    @property
    def of_one_coordinate(self) -> bool:
        """Whether g⊥, s and Γ are functions of q_r alone."""
        row = self.row
        return row.g_perp.free_symbols | row.s.free_symbols | row.gamma.free_symbols <= {self.q_r}

    @property
    def slope(self) -> int | None:
        """Sign of ∂s/∂q_r at the target."""
        return sign(self.at_target(sp.diff(self.row.s, self.q_r)))

    @property
    def unit(self) -> sp.Expr:
        """1/M_rr: with it H₀ is an energy of the size of the plant's."""
        return 1 / _near(self.at_target(self.model.mass[self.row.r, self.row.r]))

    def size(self, a: int) -> sp.Expr:
        """The size of q_a beside that of q_r: where the row couples them, 1/|g⊥ₐ|."""
        coupling = self.at_target(self.row.g_perp[a])
        if sign(coupling) in (1, -1):
            return 1 / _near(sp.Abs(coupling))
        mass = self.model.mass
        ratio = self.at_target(mass[self.row.r, self.row.r] / mass[a, a])
        return _near(sp.sqrt(ratio))


@dataclass(frozen=True, eq=False)
class _Shape:
    """What determines a mechanical target structure."""

    M_d: sp.Matrix  # k × k, of q
    inverse: sp.Matrix  # M_d⁻¹
    V_d: sp.Expr
    gammas: tuple[sp.Expr, ...]  # γ, k − 1
    slopes: sp.Matrix  # ∇γ, k × k − 1, as it was integrated


def mechanical_structures(
    plant: Plant, x_star: Mapping[sp.Symbol, sp.Expr], weigh: Weigh = bryson
) -> Iterator[Matching | NoStructure]:
    """Mechanical target structures of `plant` with a minimum of H₀'s potential at x*.

    Constant M_d comes first where g⊥ is constant; where it is not, V_d has a pole at an angle that
    M_d of one coordinate does not have. Numbers that the matching equations leave free are those
    of the least cost of the linearised loop. A family that gives none says why. Every matching is
    proved.

    Parameters
    ----------
    plant
        Any plant; what is not mechanical with one unactuated direction has no structure here.
    x_star
        Exact value of every state.
    weigh
        What responses cost, from the sizes of the plant.

    Yields
    ------
    Matching
        In the states of `plant`; ``shaping`` holds k − 1 functions γ with the Casimirs ξᵢ − γᵢ.
    NoStructure
        For each family without one.
    """
    try:
        yield from _structures(plant, x_star, weigh)
    except Undecided as unknown:
        reason = f"no proof was found whether {unknown} is zero"
        yield NoStructure("mechanical", reason, False)
    except ModelError as problem:
        yield NoStructure("mechanical", problem.fault, False)


def _structures(
    plant: Plant, x_star: Mapping[sp.Symbol, sp.Expr], weigh: Weigh
) -> Iterator[Matching | NoStructure]:
    """What each family gives, or what stands against all of them."""
    model = mechanical_model(plant)
    if isinstance(model, str):
        yield NoStructure("mechanical", f"it is not tried, because {model}", False)
        return
    questions = [_Question(model, row, x_star, weigh) for row in model.free_rows(x_star)]
    obstacle = _obstacle(questions, x_star)
    if obstacle is not None:
        yield obstacle
        return
    steady = all(not question.row.g_perp.free_symbols for question in questions)
    for family in sorted(_FAMILIES, key=lambda family: steady and family != _STEADY):
        build, form = _FAMILIES[family]
        missing = NoStructure(family, _other_form(questions, form), False)
        for question in questions:
            shape = build(question)
            if isinstance(shape, _Shape):
                matching = _matching(question, shape)
                if matching.holds:
                    yield matching
                    break
                shape = "the matching equations could not be proved"
            if isinstance(shape, str):
                missing = NoStructure(family, shape, False)
        else:
            yield missing


def _other_form(questions: Sequence[_Question], form: str) -> str:
    """Which form a family integrates, and the row that comes nearest to it."""

    def others(question: _Question) -> int:
        row = question.row
        return sum(len(e.free_symbols - {question.q_r}) for e in (row.g_perp, row.s, row.gamma))

    nearest = min(questions, key=others)
    depends = nearest.row.dependence(nearest.model.q)
    return (
        f"it takes {form} in the row that no input enters; there, divided by the entry of "
        f"{nearest.q_r}, {depends}"
    )


def _obstacle(
    questions: Sequence[_Question], x_star: Mapping[sp.Symbol, sp.Expr]
) -> NoStructure | None:
    """Why no mechanical target structure at all is tried, or exists."""
    if not questions:
        reason = "no entry of the row that no input enters is proved to differ from 0 at the target"
        return NoStructure("mechanical", reason, False)
    question = questions[0]
    at_rest = [is_zero(x_star[s]) for s in question.model.p]
    still = [is_zero(question.at_target(question.row.s)), *at_rest]
    if False in still:
        return NoStructure("mechanical", "the target is no equilibrium", True)
    if None in still:
        return NoStructure("mechanical", "the target is not proved to be an equilibrium", False)
    damped = [_of_friction(q) for q in questions if is_zero(q.row.friction) is not True]
    proved = next((obstacle for obstacle in damped if obstacle.proved), None)
    return proved or next(iter(damped), None) or _of_curvature(questions[0])


def _of_curvature(question: _Question) -> NoStructure | None:
    """With ∇s = −c g⊥ᵀ, c ≥ 0, at the target, b·∇s = −c g⊥M_dg⊥ᵀ ≤ 0 for every M_d ≻ 0."""
    row = question.row
    slopes = [question.at_target(slope) for slope in gradient(row.s, question.model.q)]
    parallel = [
        slope - slopes[row.r] * question.at_target(e)
        for slope, e in zip(slopes, row.g_perp, strict=True)
    ]
    if not all(is_zero(entry) is True for entry in parallel) or sign(slopes[row.r]) not in (0, -1):
        return None
    reason = (
        "no mechanical structure has a nondegenerate minimum there: the force that no input "
        "opposes changes only along the row that no input enters"
    )
    return NoStructure("mechanical", reason, True)


def _of_friction(question: _Question) -> NoStructure:
    """Friction d on q_r: matching gives d b_r ≥ 0, and b_r < 0 is needed where s′(q*) < 0."""
    name = question.q_r
    loss = sp.diff(question.row.friction, question.model.v[question.row.r])
    upright = (
        question.row.s.free_symbols <= {name}
        and question.slope == -1
        and is_zero(question.row.friction - loss * question.model.v[question.row.r]) is True
        and sign(question.at_target(loss)) == 1
    )
    if not upright:
        reason = "friction in the row that no input enters is not covered"
        return NoStructure("mechanical", reason, False)
    reason = (
        f"no mechanical structure: with friction on the unactuated coordinate {name}, a minimum "
        f"where its potential has a maximum would need dissipation of the wrong sign"
    )
    return NoStructure("mechanical", reason, True)


def _constant_inertia(question: _Question) -> _Shape | str | None:
    """M_d constant: needs Γ = 0, and s and g⊥ of q_r alone."""
    row = question.row
    if not question.of_one_coordinate or not row.gamma.is_zero_matrix:
        return None
    slope = question.slope
    if slope not in (1, -1):
        return f"the force on {question.q_r} has no slope at the target"
    chosen = None if row.g_perp.free_symbols else _least_direction(question)
    if chosen is not None and sign((row.g_perp * chosen[0])[0]) == slope:
        return _along(question, chosen[0], slope * question.unit, chosen[1])
    M_d = _usual_inertia(question, slope)
    return _integrated(question, M_d, M_d.inv(), M_d * sp.Matrix(row.g_perp.T))


def _least_direction(question: _Question) -> tuple[sp.Matrix, list[sp.Expr]] | None:
    """K = b/bᵣ of the least cost, in three digits, and the sizes of the other coordinates."""
    response, r = question.response, question.row.r
    best = None if response is None else response.best
    if response is None or best is None:
        return None
    units = response.units / response.units[r]
    K = sp.Matrix(
        [
            _near(sp.Float(v)) * sp.Rational(u)
            for v, u in zip(best[0] / best[0][r], units, strict=True)
        ]
    )
    priced = _priced(question, response, K)
    return None if priced is None else (K, priced[1])


def _priced(
    question: _Question, response: MechanicalResponse, K: sp.Matrix
) -> tuple[float, list[sp.Expr]] | None:
    """The cost that K(q*) allows, and the sizes of the other coordinates with which it does."""
    units = response.units / response.units[question.row.r]
    b = float_matrix(at(K, question.x_star)).ravel() / units * np.sign(response.slope)
    found = response.best_beside(b)
    if found is None:
        return None
    squares = units[list(question.others)] ** 2
    sizes = [
        _near(sp.Float(share)) * sp.Rational(square)
        for share, square in zip(found[0].tolist(), squares.tolist(), strict=True)
    ]
    return found[1], sizes


def _usual_inertia(question: _Question, slope: int) -> sp.Matrix:
    """M_d that couples q_r to the others as much as the row does."""
    row, r = question.row, question.row.r
    coupled = [a for a in question.others if sign(question.at_target(row.g_perp[a])) in (1, -1)]
    M_d = sp.zeros(question.model.k)
    M_d[r, r] = _OWN
    for a in question.others:
        M_d[a, a] = _OTHER * question.size(a) ** 2
    for a in coupled:
        towards = sp.sign(question.at_target(row.g_perp[a])) * slope
        M_d[r, a] = M_d[a, r] = towards * _COUPLED * question.size(a) / len(coupled)
    return question.unit * M_d


def _one_coordinate(question: _Question) -> _Shape | str | None:
    """With b = β(q_r) K(q_r), where Kᵣ = 1 and Kₐ ~ κ/g⊥ₐ, so that g⊥K = 1 + κ is constant."""
    row = question.row
    coupled = [a for a in question.others if sign(question.at_target(row.g_perp[a])) in (1, -1)]
    if not question.of_one_coordinate or not coupled:
        return None
    if question.slope != -1:
        return f"it is made for targets at which the potential of {question.q_r} has a maximum"
    if not row.g_perp.free_symbols and row.gamma.is_zero_matrix:
        return "it is the one with constant M_d"
    for K, sizes in _directions(question, coupled):
        ratio = question.integral(_rate(question, K))
        if ratio is None:
            continue
        shape = _along(question, K, -question.unit * sp.exp(ratio), sizes)
        if isinstance(shape, _Shape):
            return shape
    return "no quadrature in closed form was found"


def _directions(
    question: _Question, coupled: Sequence[int]
) -> Iterator[tuple[sp.Matrix, list[sp.Expr]]]:
    """K and the sizes of the other coordinates, the least cost first where it is known.

    Near the target a steeper β may cost less; far from it the slowest one does.
    """
    kappas = list(_kappas(question, coupled))
    response = question.response
    best = None if response is None else response.best
    if response is None or best is None:
        usual = [question.size(a) ** 2 for a in question.others]
        yield from ((_direction(question, coupled, kappa), usual) for kappa in kappas)
        return
    compared: list[tuple[float, sp.Matrix, list[sp.Expr]]] = []
    for kappa in kappas[:_TRIED]:
        K = _direction(question, coupled, kappa)
        priced = _priced(question, response, K)
        if priced is not None:
            compared.append((priced[0], K, priced[1]))
    compared.sort(key=lambda entry: max(entry[0], _ALIKE))
    yield from ((K, sizes) for _, K, sizes in compared)


def _along(
    question: _Question, K: sp.Matrix, beta: sp.Expr, sizes: Sequence[sp.Expr]
) -> _Shape | str:
    """M_d = bbᵀ/(g⊥b) + gΛgᵀ with b = βK, and its inverse by the basis dual to (b, g)."""
    row, k = question.row, question.model.k
    e = sp.Matrix(row.g_perp).T
    mu = short((e.T * K)[0])
    M_d, inverse = beta / mu * K * K.T, e * e.T / (beta * mu)
    for a, size in zip(question.others, sizes, strict=True):
        unit = sp.eye(k)[:, a]
        g = unit - e[a] * sp.eye(k)[:, row.r]
        dual = unit - K[a] / mu * e
        share = question.unit * size
        M_d, inverse = M_d + share * g * g.T, inverse + dual * dual.T / share
    return _integrated(question, M_d.applyfunc(short), inverse.applyfunc(short), beta * K)


def _direction(question: _Question, coupled: Sequence[int], kappa: sp.Expr) -> sp.Matrix:
    K = sp.zeros(question.model.k, 1)
    K[question.row.r] = 1
    for a in coupled:
        K[a] = kappa / (len(coupled) * question.row.g_perp[a])
    return K


def _rate(question: _Question, K: sp.Matrix) -> sp.Expr:
    """β′/β = 2(g⊥′K + KᵀΓK)/μ with μ = g⊥K constant."""
    row = question.row
    turning = (sp.Matrix(row.g_perp).diff(question.q_r) * K)[0] + (K.T * row.gamma * K)[0]
    return short(2 * turning / (row.g_perp * K)[0])


def _kappas(question: _Question, coupled: Sequence[int]) -> Iterator[sp.Expr]:
    """κ < −1 for which β has a whole power of what vanishes in it, the slowest fall first.

    Then g⊥b = β(1 + κ) > 0 while β < 0 turns the maximum of the potential into a minimum.
    """
    kappa = sp.Dummy("kappa", real=True)
    rate = _rate(question, _direction(question, coupled, kappa))
    powers = _powers(rate, question.q_r, kappa)
    if not powers:  # as if β were a power of a cosine
        powers = [-question.at_target(sp.diff(rate, question.q_r))]
    for whole in range(1, _MOST_POWER + 1):
        for power in powers:
            roots = map(sp.radsimp, sp.solve(sp.numer(sp.together(power - whole)), kappa))
            yield from (root for root in roots if root.is_real and sign(root + 1) == -1)


def _powers(rate: sp.Expr, s: sp.Symbol, kappa: sp.Symbol) -> list[sp.Expr]:
    """Exponents, as far as they depend on κ, of the factors a cos s + b in exp ∫ rate ds."""
    parts = even_and_odd(rate, s)
    if parts is None or parts[0] != 0:
        return []
    _, slope, c = parts  # rate ds = −slope dc
    below = sp.denom(slope)
    factors = [factor for factor, _ in sp.factor_list(below)[1] if factor.has(c)]
    roots = [
        -factor.subs(c, 0) / sp.diff(factor, c) for factor in factors if not sp.diff(factor, c, c)
    ]
    residues = [-(sp.numer(slope) / sp.diff(below, c)).subs(c, root) for root in roots]
    return [power for r in residues if (power := sp.cancel(r)).has(kappa)]


def _constant_off_r(question: _Question) -> _Shape | str | None:
    """Two coordinates, g⊥ = eᵣᵀ, Γ = Γₐₐ(q_r), s = s(qₐ): bₐ = c and (bᵣ²)′ = 4c²Γₐₐ."""
    row, r = question.row, question.row.r
    if question.model.k != 2:
        return None
    (a,) = question.others
    q_r, q_a = question.q_r, question.model.q[a]
    plain = row.s.free_symbols <= {q_a} and row.gamma.free_symbols <= {q_r}
    if not plain or row.g_perp[a] != 0 or row.gamma[r, r] != 0 or row.gamma[r, a] != 0:
        return None
    rising = sign(question.at_target(sp.diff(row.s, q_a)))
    if rising not in (1, -1):
        return f"the force on {q_r} does not change with {q_a} at the target"
    square = quadrature(4 * row.gamma[a, a], q_r, sp.Integer(0))
    if square is None:
        return "no quadrature in closed form was found"
    length = 1 / question.size(a)
    square = sp.factor(square + question.at_target(sp.diff(square, q_r, q_r)) / 2 * length**2)
    if sign(question.at_target(square)) != 1:
        return f"b vanishes along {q_r}"
    c, root = rising * question.unit / length, sp.sqrt(square)
    b_r = sp.Abs(c) * root
    V_d = quadrature(row.s / c, q_a, question.x_star[q_a])
    part = question.integral(-rising / root)
    if V_d is None or part is None:
        return "no quadrature in closed form was found"
    M_d, slopes = sp.zeros(2), sp.zeros(2, 1)
    M_d[r, r], M_d[r, a], M_d[a, r], M_d[a, a] = b_r, c, c, 2 * c**2 / b_r
    slopes[r], slopes[a] = -rising / root, 1
    return _Shape(M_d, M_d.inv(), V_d, (q_a + part,), slopes)


def _integrated(
    question: _Question, M_d: sp.Matrix, inverse: sp.Matrix, b: sp.Matrix
) -> _Shape | str:
    """V_d and γ of a b that depends on q_r alone."""
    row, r = question.row, question.row.r
    V_d = question.integral(row.s / b[r])
    if V_d is None:
        return "no closed form of V_d was found"
    slopes, gammas = sp.zeros(question.model.k, len(question.others)), []
    for j, a in enumerate(question.others):
        slopes[r, j] = short(-b[a] / b[r])
        slopes[a, j] = 1
        part = question.integral(slopes[r, j])
        if part is None:
            return "no closed form of γ was found"
        gammas.append(question.model.q[a] + part)
    return _Shape(M_d, inverse, V_d, tuple(gammas), slopes)


#: The family that is tried first where g⊥ is constant.
_STEADY = "constant M_d"

#: What builds a structure, or None where the row g⊥v̇ = −s + vᵀΓv does not have this form.
_FAMILIES: dict[str, tuple[Callable[[_Question], _Shape | str | None], str]] = {
    "M_d of one coordinate": (
        _one_coordinate,
        "g⊥, s and Γ of one coordinate and another entry in g⊥",
    ),
    _STEADY: (_constant_inertia, "g⊥ and s of one coordinate and Γ = 0"),
    "M_d constant off one coordinate": (
        _constant_off_r,
        "one entry in g⊥, s of the other of two coordinates and Γ of its velocity alone",
    ),
}


def _matching(question: _Question, shape: _Shape) -> Matching:
    """The structure in the plant's states (q, p), and the input that gives it."""
    model, plant = question.model, question.model.plant
    k, mass, M_d, inverse = model.k, model.mass, shape.M_d, shape.inverse
    J2 = _gyroscopic(question, shape)
    L = (mass * sp.Matrix(model.v)).jacobian(model.q)
    turning = L * M_d * mass - mass * M_d * L.T + mass * J2 * mass
    cross = (M_d * mass).applyfunc(short)
    J = sp.zeros(2 * k)
    J[:k, k:], J[k:, :k] = cross, -cross.T
    for i, j in combinations(range(k), 2):
        J[k + i, k + j] = _in_momenta(turning[i, j], model)
        J[k + j, k + i] = -J[k + i, k + j]
    v = sp.Matrix(model.v)
    kinetic = (v.T * inverse * v)[0] / 2
    H = _in_momenta(kinetic, model) + shape.V_d
    free = (mass * M_d * shape.slopes).applyfunc(short)
    rows = list(question.row.input_rows)
    solve = sp.Matrix(plant.G[k:, :]).extract(rows, list(range(k - 1))).inv().applyfunc(short)
    u0 = solve * _force(question, shape, J2).extract(rows, [0])
    A = (solve * free.extract(rows, list(range(k - 1)))).applyfunc(short)
    ahead = Preliminary(
        plant.flow,
        plant.G,
        sp.ImmutableMatrix([_in_momenta(entry, model) for entry in u0]),
        sp.ImmutableMatrix(A),
    )
    structure = make_plant(
        plant.x,
        J,
        sp.zeros(2 * k),
        sp.Matrix.vstack(sp.zeros(k, k - 1), free),
        H,
        name=plant.name,
        units=plant.units,
        domain=plant.domain,
    )
    return Matching(ahead, structure, shape.gammas)


def _gyroscopic(question: _Question, shape: _Shape) -> sp.Matrix:
    """J₂, linear in p̃ = M_d⁻¹v, with g⊥J₂p̃ = p̃ᵀQp̃ and Q = M_dΓM_d − ½ b·∇M_d.

    Q vanishes along g⊥ᵀ by the kinetic equation, so that p̃ᵀQp̃ = d·l with dₐ = p̃ₐ − g⊥ₐp̃ᵣ.
    """
    row, r, q, M_d = question.row, question.row.r, question.model.q, shape.M_d
    e = sp.Matrix(row.g_perp).T
    b = M_d * e
    along = sum((b[i] * M_d.diff(s) for i, s in enumerate(q)), sp.zeros(len(q)))
    Q = (M_d * row.gamma * M_d - along / 2).applyfunc(short)
    momentum = shape.inverse * sp.Matrix(question.model.v)
    J2 = sp.zeros(len(q))
    d = momentum - e * momentum[r]
    for a in question.others:
        J2[r, a] = 2 * momentum[r] * (Q * e)[a] + (Q * d)[a]
        J2[a, r] = -J2[r, a]
    return J2


def _force(question: _Question, shape: _Shape, J2: sp.Matrix) -> sp.ImmutableMatrix:
    """B u₀ = Mv̇ + c + ∇V + Dv, of q and v, for the accelerations of the target structure."""
    model, row = question.model, question.row
    v = sp.Matrix(model.v)
    H = (v.T * shape.inverse * v)[0] / 2 + shape.V_d
    wanted = J2 * shape.inverse * v - shape.M_d * gradient(H, model.q)
    rate = sp.Matrix(wanted)
    rate[row.r] = -row.s + (v.T * row.gamma * v)[0]
    rate[row.r] -= sum((row.g_perp[a] * wanted[a] for a in question.others), sp.Integer(0))
    return (
        model.mass * rate + model.coriolis + gradient(model.potential, model.q) + model.damping * v
    )


def _in_momenta(expr: sp.Expr, model: MechanicalModel) -> sp.Expr:
    """A quadratic polynomial in v, with v = M⁻¹p, as one in p with short coefficients."""
    expr, rest = sp.sympify(expr), dict.fromkeys(model.v, 0)
    p, inverse = sp.Matrix(model.p), model.inverse_mass
    linear = inverse * gradient(expr, model.v).subs(rest)
    quadratic = inverse * sp.hessian(expr, model.v).applyfunc(short) * inverse / 2
    terms = [short(expr.subs(rest)), *(short(a) * s for a, s in zip(linear, p, strict=True))]
    for i, j in combinations_with_replacement(range(model.k), 2):
        entry = quadratic[i, j] * (1 if i == j else 2)
        terms.append(short(entry) * p[i] * p[j])
    return sp.Add(*terms)


def _near(value: sp.Expr) -> sp.Expr:
    """A positive constant as it is where it is rational, else to three digits."""
    return value if value.is_Rational else sp.Rational(f"{to_float(value):.3g}")
