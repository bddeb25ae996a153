"""The energy of a constant target structure: H₀ with B∇H₀ = s, and a minimum."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import sympy as sp

from necc_casadi.arrays import Vector
from necc_casadi.methods.constant_question import (
    DIGITS,
    Question,
    power_of_two,
    rounded,
)
from necc_casadi.symbolic.definiteness import definiteness
from necc_casadi.symbolic.derivatives import at, gradient, sparse_hessian, value_at
from necc_casadi.symbolic.floats import float_matrix, to_float
from necc_casadi.symbolic.linear_algebra import reduced_rows, tidy
from necc_casadi.symbolic.primitive import primitive

__all__ = ["energy_of", "with_minimum", "written"]


def written(expr: sp.Expr) -> sp.Expr:
    """An expression as it is printed: expanded, or over one denominator."""
    return sp.expand(expr) if expr.is_polynomial() else sp.factor_terms(sp.cancel(expr))


def energy_of(question: Question, B: sp.Matrix) -> sp.Expr | None:
    """H₀ with B∇H₀ = s: along x = Bᵀw + Vc, with units V off the pivots of B, ∂H₀/∂wᵢ = sᵢ."""
    r, n = B.shape
    pivots = reduced_rows(B)[1]
    rest = [j for j in range(n) if j not in pivots]
    w = [sp.Dummy(f"w{i}", real=True) for i in range(r)]
    c = [sp.Dummy(f"c{j}", real=True) for j in rest]
    V = sp.eye(n).extract(list(range(n)), rest)
    inside = B.T * sp.Matrix(w) + (V * sp.Matrix(c) if rest else sp.zeros(n, 1))
    forward = dict(zip(question.x, inside, strict=True))
    total: sp.Expr = sp.Integer(0)
    back = B.extract(list(range(r)), pivots).T.inv() * sp.Matrix(question.x).extract(pivots, [0])
    off = sp.Matrix(question.x) - B.T * back
    values = dict(zip([*w, *c], [*back, *(off[j] for j in rest)], strict=True))
    there = {symbol: value_at(value, question.x_star) for symbol, value in values.items()}
    for i, s in enumerate(w):
        missing = question.s[i].subs(forward, simultaneous=True) - sp.diff(total, s)
        # equal for all w₁ … wᵢ₋₁, even where that does not show
        missing = missing.subs({w[k]: value_at(back[k], question.x_star) for k in range(i)})
        part = _integral(missing, s)
        if part is None:
            return None
        total += _of_real_logarithms(part, there)
    return _in_partial_fractions(total.subs(values, simultaneous=True), question.x)


def _in_partial_fractions(H: sp.Expr, x: Sequence[sp.Symbol]) -> sp.Expr:
    """The same sum with short numerators: over one denominator, enclosures of it are wide."""
    names = {e: sp.Dummy() for e in H.atoms(sp.Function) if e.free_symbols}
    total: sp.Expr = sp.Integer(0)
    for term in sp.Add.make_args(H.xreplace(names)):
        below = sp.denom(sp.together(term)).free_symbols & set(x)
        total += sp.apart(term, below.pop()) if len(below) == 1 else written(term)
    return total.xreplace({name: e for e, name in names.items()})


def _of_real_logarithms(expr: sp.Expr, there: Mapping[Any, sp.Expr]) -> sp.Expr:
    """A primitive whose logarithms are real there: log(−e), as good as log(e), where e < 0."""
    negative = {e for e in expr.atoms(sp.log) if value_at(e.args[0], there).is_negative is True}
    return expr.xreplace({e: sp.log(sp.expand(-e.args[0])) for e in negative})


def _integral(f: sp.Expr, s: sp.Symbol) -> sp.Expr | None:
    """A primitive, term by term."""
    total: sp.Expr = sp.Integer(0)
    for term in sp.Add.make_args(_flat(f)):
        part = _of_linear_argument(term, s) or primitive(term, s)
        if part is None:
            return None
        total += part
    return total


def _flat(f: sp.Expr) -> sp.Expr:
    """A sum whose functions keep their arguments in one piece."""
    names = {e: sp.Dummy() for e in f.atoms(sp.Function)}
    return sp.expand(f.xreplace(names)).xreplace({name: e for e, name in names.items()})


def _of_linear_argument(f: sp.Expr, s: sp.Symbol) -> sp.Expr | None:
    """∫g(as + b)ds for one function g, which sympy's rules take long for with symbols in b."""
    coefficient, g = f.as_independent(s, as_Add=False)
    if not g.is_Function:
        return None
    slope = sp.diff(g.args[0], s)
    if slope == 0 or slope.has(s):
        return None
    u = sp.Dummy("u", real=True)
    inner = primitive(g.subs(g.args[0], u), u)
    return None if inner is None else coefficient / slope * inner.subs(u, g.args[0])


def with_minimum(
    question: Question, B: sp.Matrix, N: sp.Matrix, energy: sp.Expr, P: Vector | None
) -> sp.Expr | None:
    """H₀ with ∇H₀(x*) = 0 and ∇²H₀(x*) ≻ 0: what depends on Nᵀx is free, since BN = 0.

    In natural units, with Q = ∇²H₀, the free block is NᵀQN = CᵀS⁻¹C + σNᵀN, C = BQN, or with the
    Schur complement of P⁻¹ in place of σNᵀN.
    """
    x_star, x = question.x_star, question.x
    slope = N.T * sp.Matrix(at(gradient(energy, x), x_star))
    away = N.T * sp.Matrix([v - x_star[v] for v in x])
    gram = (N.T * N).inv()
    energy = _gathered(energy - (away.T * gram * slope)[0], x)
    Q0 = sp.Matrix(at(sparse_hessian(energy, x), x_star))
    size = np.diag(float_matrix(question.T))
    Q, rows, free = (
        float_matrix(Q0) * np.outer(size, size),
        float_matrix(B) / size,
        float_matrix(N) * size[:, None],
    )
    S, C, squares = rows @ Q @ rows.T, rows @ Q @ free, free.T @ free
    sigma, r = np.trace(S) / np.trace(rows @ rows.T), len(rows)
    beyond = sigma * squares
    if P is not None:  # the Schur complement of its inverse
        frame = np.hstack([rows.T, free])
        beyond = np.linalg.inv(np.linalg.inv(frame.T @ np.linalg.solve(P, frame))[r:, r:])
    wanted = C.T @ np.linalg.solve(S, C) + beyond - free.T @ Q @ free
    theta = np.linalg.solve(squares, np.linalg.solve(squares, wanted).T)
    scale = float(np.abs(theta).max()) or 1.0
    if not np.isfinite(scale):
        return None
    unit = power_of_two(scale)
    shares = (theta + theta.T) / (2 * to_float(unit))
    for digits in DIGITS:
        exact = unit * rounded(shares, digits)
        if definiteness(Q0 + N * exact * N.T)[0] == "positive":
            return _gathered(energy + (away.T * exact * away)[0] / 2, x)
    return None


def _gathered(H: sp.Expr, x: Sequence[sp.Symbol]) -> sp.Expr:
    """`H` with one coefficient for each product of states and functions of them."""
    names = {e: sp.Dummy() for e in H.atoms(sp.Function) if e.free_symbols}
    flat = H.xreplace(names)
    variables = [*x, *names.values()]
    if not flat.is_polynomial(*variables):
        return sp.expand(H)
    terms = sp.Poly(flat, *variables).terms()
    products = [
        sp.Mul(*[v**k for v, k in zip(variables, powers, strict=True)]) for powers, _ in terms
    ]
    total = sp.Add(*[tidy(a) * p for (_, a), p in zip(terms, products, strict=True) if p != 1])
    return total.xreplace({name: e for e, name in names.items()})
