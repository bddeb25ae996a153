"""Target inertias and potentials by linear algebra and by quadratures."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import sympy as sp

from necc_casadi.methods.mechanical_model import short
from necc_casadi.methods.mechanical_question import Question, Shape, near
from necc_casadi.methods.mechanical_response import MechanicalResponse
from necc_casadi.symbolic.derivatives import at
from necc_casadi.symbolic.floats import float_matrix
from necc_casadi.symbolic.quadrature import even_and_odd, quadrature
from necc_casadi.symbolic.zero import sign

__all__ = ["constant_inertia", "constant_off_r", "one_coordinate"]


#: With b_r = m − μ cos q_r and m : μ = 7 : 25 the roots in the quadratures are rational.
_OWN, _COUPLED, _OTHER = sp.Rational(7, 25), sp.Integer(1), sp.Integer(4)


#: The largest power of a cosine by which β falls off, and how many of them are compared by cost.
_MOST_POWER, _TRIED = 16, 5


#: Costs below this multiple of LQR's are alike.
_ALIKE = 1.5


def constant_inertia(question: Question) -> Shape | str | None:
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


def _least_direction(question: Question) -> tuple[sp.Matrix, list[sp.Expr]] | None:
    """K = b/bᵣ of the least cost, in three digits, and the sizes of the other coordinates."""
    response, r = question.response, question.row.r
    best = None if response is None else response.best
    if response is None or best is None:
        return None
    units = response.units / response.units[r]
    K = sp.Matrix(
        [
            near(sp.Float(v)) * sp.Rational(u)
            for v, u in zip(best[0] / best[0][r], units, strict=True)
        ]
    )
    priced = _priced(question, response, K)
    return None if priced is None else (K, priced[1])


def _priced(
    question: Question, response: MechanicalResponse, K: sp.Matrix
) -> tuple[float, list[sp.Expr]] | None:
    """The cost that K(q*) allows, and the sizes of the other coordinates with which it does."""
    units = response.units / response.units[question.row.r]
    b = float_matrix(at(K, question.x_star)).ravel() / units * np.sign(response.slope)
    found = response.best_beside(b)
    if found is None:
        return None
    squares = units[list(question.others)] ** 2
    sizes = [
        near(sp.Float(share)) * sp.Rational(square)
        for share, square in zip(found[0].tolist(), squares.tolist(), strict=True)
    ]
    return found[1], sizes


def _usual_inertia(question: Question, slope: int) -> sp.Matrix:
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


def one_coordinate(question: Question) -> Shape | str | None:
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
        if isinstance(shape, Shape):
            return shape
    return "no quadrature in closed form was found"


def _directions(
    question: Question, coupled: Sequence[int]
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
    question: Question, K: sp.Matrix, beta: sp.Expr, sizes: Sequence[sp.Expr]
) -> Shape | str:
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


def _direction(question: Question, coupled: Sequence[int], kappa: sp.Expr) -> sp.Matrix:
    K = sp.zeros(question.model.k, 1)
    K[question.row.r] = 1
    for a in coupled:
        K[a] = kappa / (len(coupled) * question.row.g_perp[a])
    return K


def _rate(question: Question, K: sp.Matrix) -> sp.Expr:
    """β′/β = 2(g⊥′K + KᵀΓK)/μ with μ = g⊥K constant."""
    row = question.row
    turning = (sp.Matrix(row.g_perp).diff(question.q_r) * K)[0] + (K.T * row.gamma * K)[0]
    return short(2 * turning / (row.g_perp * K)[0])


def _kappas(question: Question, coupled: Sequence[int]) -> Iterator[sp.Expr]:
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


def constant_off_r(question: Question) -> Shape | str | None:
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
    return Shape(M_d, M_d.inv(), V_d, (q_a + part,), slopes)


def _integrated(
    question: Question, M_d: sp.Matrix, inverse: sp.Matrix, b: sp.Matrix
) -> Shape | str:
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
    return Shape(M_d, inverse, V_d, tuple(gammas), slopes)
