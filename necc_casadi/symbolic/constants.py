"""Proofs that a real constant is zero; a number that no proof reaches is not called zero."""

from __future__ import annotations

import math
from functools import reduce

import flint
import sympy as sp

from necc_casadi.symbolic.arb import enclosure

__all__ = ["vanishes"]


#: A constant with more operations than this is not handed to sympy's slow rules.
_LONG = 100

#: Largest power that is formed when arc tangents and logarithms are joined.
_MOST = 4096

#: Binary digits to which a multiple of 2π or a sign is told from its neighbours.
_BITS = 512


def vanishes(expr: sp.Expr) -> bool:
    """Whether a real constant is proved to be 0, by exact algebra."""
    if sp.expand(expr) == 0 or sp.expand(sp.sqrtdenest(expr)) == 0 or _joined(expr):
        return True
    factored = sp.factor_terms(expr)
    if factored.is_Mul:
        return any(vanishes(f) for f in factored.args if not (f.is_Rational or f.is_Atom))
    if expr.count_ops() > _LONG:
        return False
    # minimal polynomials, which equals() looks at, are for algebraic numbers
    return bool(sp.simplify(expr) == 0 or (expr.is_algebraic and expr.equals(0)))


def _joined(expr: sp.Expr) -> bool:
    """Whether Σ rᵢ ln aᵢ and Σ rᵢ atan bᵢ + rπ both vanish, each by one exact power product.

    With the rᵢ made integers, Σ rᵢ ln aᵢ = 0 iff Π aᵢ^rᵢ = 1, and the angles sum to a multiple
    of 2π iff Π (1 + i bᵢ)^rᵢ (−1)^r is positive; which multiple, balls decide.
    """
    logs: list[tuple[sp.Expr, sp.Expr]] = []
    angles: list[tuple[sp.Expr, sp.Expr]] = []
    turns: sp.Expr = sp.Integer(0)
    expr = sp.expand(_in_logs_and_angles(expr))
    for term in sp.Add.make_args(expr) if expr != 0 else ():
        coefficient, unit = term.as_coeff_Mul()
        if unit is sp.pi:
            turns += coefficient
        elif isinstance(unit, sp.log) and _is_algebraic(unit.args[0]):
            logs.append((coefficient, unit.args[0]))
        elif isinstance(unit, sp.atan) and _is_algebraic(unit.args[0]):
            angles.append((coefficient, unit.args[0]))
        else:
            return False
    return _no_log(logs) and _no_angle(angles, turns)


def _in_logs_and_angles(expr: sp.Expr) -> sp.Expr:
    """`expr` with asin, acos as arc tangents and asinh, acosh, atanh as logarithms."""
    forms = {
        sp.asin: lambda a: sp.atan(a / sp.sqrt(1 - a**2)),
        sp.acos: lambda a: sp.pi / 2 - sp.atan(a / sp.sqrt(1 - a**2)),
        sp.asinh: lambda a: sp.log(a + sp.sqrt(a**2 + 1)),
        sp.acosh: lambda a: sp.log(a + sp.sqrt(a**2 - 1)),
        sp.atanh: lambda a: (sp.log(1 + a) - sp.log(1 - a)) / 2,
    }
    for function, form in forms.items():
        expr = expr.replace(function, form)
    return expr


def _is_algebraic(expr: sp.Expr) -> bool:
    """Whether a constant is built from rationals by field operations and roots alone."""
    return all(
        part.is_Rational
        or part.is_Add
        or part.is_Mul
        or (isinstance(part, sp.Pow) and part.exp.is_Rational)
        for part in sp.preorder_traversal(expr)
    )


def _no_log(terms: list[tuple[sp.Expr, sp.Expr]]) -> bool:
    scale, powers = _integers([r for r, _ in terms])
    if scale is None:
        return False
    above = sp.Mul(*[a**k for (_, a), k in zip(terms, powers, strict=True) if k > 0])
    below = sp.Mul(*[a**-k for (_, a), k in zip(terms, powers, strict=True) if k < 0])
    return _equal(above, below)


def _no_angle(terms: list[tuple[sp.Expr, sp.Expr]], turns: sp.Expr) -> bool:
    scale, powers = _integers([*[r for r, _ in terms], turns])
    if scale is None:
        return False
    half_turns = powers.pop()
    real: sp.Expr = sp.Integer((-1) ** (half_turns % 2))
    imaginary: sp.Expr = sp.Integer(0)
    for (_, b), k in zip(terms, powers, strict=True):
        # (1 − i b)^k turns as far as (1 + i b)^−k
        c, s = _power(b if k > 0 else -b, abs(k))
        real, imaginary = (
            sp.expand(real * c - imaginary * s),
            sp.expand(real * s + imaginary * c),
        )
    if not _equal(imaginary, sp.Integer(0)):
        return False
    total = sp.Add(half_turns * sp.pi, *[
        k * sp.atan(b) for (_, b), k in zip(terms, powers, strict=True)
    ])  # fmt: skip
    with flint.ctx.workprec(_BITS):
        # the sum is a multiple of π, and a ball this close to 0 holds no other
        return bool(abs(enclosure(total, {})) < 1)


def _power(b: sp.Expr, k: int) -> tuple[sp.Expr, sp.Expr]:
    """Real and imaginary part of (1 + i b)^k."""
    result: tuple[sp.Expr, sp.Expr] = (sp.Integer(1), sp.Integer(0))
    square: tuple[sp.Expr, sp.Expr] = (sp.Integer(1), b)
    while k:
        if k & 1:
            result = _times(result, square)
        square, k = _times(square, square), k >> 1
    return result


def _times(a: tuple[sp.Expr, sp.Expr], b: tuple[sp.Expr, sp.Expr]) -> tuple[sp.Expr, sp.Expr]:
    return sp.expand(a[0] * b[0] - a[1] * b[1]), sp.expand(a[0] * b[1] + a[1] * b[0])


def _integers(numbers: list[sp.Expr]) -> tuple[int | None, list[int]]:
    """A common multiple that makes the numbers integers; None where they are not rational."""
    if not all(r.is_Rational for r in numbers):
        return None, []
    scale = reduce(math.lcm, [int(r.as_numer_denom()[1]) for r in numbers], 1)
    scaled = [int(r * scale) for r in numbers]
    return (scale, scaled) if sum(map(abs, scaled)) <= _MOST else (None, [])


def _equal(a: sp.Expr, b: sp.Expr) -> bool:
    """Equality of algebraic constants."""
    difference = sp.expand(a - b)
    if difference.is_Rational:
        return bool(difference == 0)
    return bool(sp.simplify(difference) == 0)
