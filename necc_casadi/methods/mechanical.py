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
from itertools import combinations, combinations_with_replacement

import sympy as sp

from necc_casadi.errors import ModelError
from necc_casadi.methods.linear_target import Weigh
from necc_casadi.methods.mechanical_model import MechanicalModel, mechanical_model, short
from necc_casadi.methods.mechanical_question import Question, Shape
from necc_casadi.methods.mechanical_shapes import constant_inertia, constant_off_r, one_coordinate
from necc_casadi.methods.no_structure import NoStructure
from necc_casadi.model.control_affine import Preliminary
from necc_casadi.model.cost import bryson
from necc_casadi.model.matching import Matching
from necc_casadi.model.plant import Plant, make_plant
from necc_casadi.symbolic.derivatives import gradient
from necc_casadi.symbolic.zero import Undecided, is_zero, sign

__all__ = ["mechanical_structures"]


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
    questions = [Question(model, row, x_star, weigh) for row in model.free_rows(x_star)]
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
            if isinstance(shape, Shape):
                matching = _matching(question, shape)
                if matching.holds:
                    yield matching
                    break
                shape = "the matching equations could not be proved"
            if isinstance(shape, str):
                missing = NoStructure(family, shape, False)
        else:
            yield missing


def _other_form(questions: Sequence[Question], form: str) -> str:
    """Which form a family integrates, and the row that comes nearest to it."""

    def others(question: Question) -> int:
        row = question.row
        return sum(len(e.free_symbols - {question.q_r}) for e in (row.g_perp, row.s, row.gamma))

    nearest = min(questions, key=others)
    depends = nearest.row.dependence(nearest.model.q)
    return (
        f"it takes {form} in the row that no input enters; there, divided by the entry of "
        f"{nearest.q_r}, {depends}"
    )


def _obstacle(
    questions: Sequence[Question], x_star: Mapping[sp.Symbol, sp.Expr]
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


def _of_curvature(question: Question) -> NoStructure | None:
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


def _of_friction(question: Question) -> NoStructure:
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


#: The family that is tried first where g⊥ is constant.
_STEADY = "constant M_d"

#: What builds a structure, or None where the row g⊥v̇ = −s + vᵀΓv does not have this form.
_FAMILIES: dict[str, tuple[Callable[[Question], Shape | str | None], str]] = {
    "M_d of one coordinate": (
        one_coordinate,
        "g⊥, s and Γ of one coordinate and another entry in g⊥",
    ),
    _STEADY: (constant_inertia, "g⊥ and s of one coordinate and Γ = 0"),
    "M_d constant off one coordinate": (
        constant_off_r,
        "one entry in g⊥, s of the other of two coordinates and Γ of its velocity alone",
    ),
}


def _matching(question: Question, shape: Shape) -> Matching:
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


def _gyroscopic(question: Question, shape: Shape) -> sp.Matrix:
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


def _force(question: Question, shape: Shape, J2: sp.Matrix) -> sp.ImmutableMatrix:
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
