"""Primitives of functions of one state that are regular at a point, each one proved."""

from __future__ import annotations

from functools import lru_cache

import sympy as sp
from sympy.integrals.rationaltools import ratint

from necc_casadi.symbolic.expressions import exact, is_finite, non_smooth_part
from necc_casadi.symbolic.floats import to_float
from necc_casadi.symbolic.linear_algebra import tidy
from necc_casadi.symbolic.primitive import primitive
from necc_casadi.symbolic.zero import is_zero, sign

__all__ = ["even_and_odd", "quadrature"]


#: Operations of an integrand beyond which sympy's rational integration takes minutes.
_MOST_OPERATIONS = 400


@lru_cache(maxsize=512)
def quadrature(f: sp.Expr, s: sp.Symbol, at: sp.Expr) -> sp.Expr | None:
    """F with dF/ds = f and F(at) = 0, smooth at `at`; None where no closed form was found.

    A rational function of cos s and sin s is split into A(cos s) + sin s B(cos s): the second
    part is an integral over cos s, the first one over tan(s/2).
    """
    if f == 0:
        return sp.Integer(0)
    if f.count_ops() > _MOST_OPERATIONS:
        return None
    for integral in (_of_cosine_and_sine, _elementary):
        raw = integral(f, s, at)
        result = None if raw is None else _regular(raw, s, at)
        if result is not None and is_zero(sp.diff(result, s) - f) is True:
            return result
    return None


def _elementary(f: sp.Expr, s: sp.Symbol, at: sp.Expr) -> sp.Expr | None:
    return primitive(f, s)


def _regular(F: sp.Expr, s: sp.Symbol, at: sp.Expr) -> sp.Expr | None:
    """`F` with real logarithms around a point and the value 0 there; None where it has a pole."""

    def positive(argument: sp.Expr) -> sp.Expr:
        negative = sign(argument.subs(s, at)) == -1
        return sp.log(-argument) if negative else sp.log(argument)

    F = exact(F).replace(sp.log, positive)
    if F.has(sp.I) or non_smooth_part(F) is not None:
        return None
    value = F.subs(s, at)
    if not is_finite(value):
        return None
    return F if sign(value) == 0 else F - value


def _of_cosine_and_sine(f: sp.Expr, s: sp.Symbol, at: sp.Expr) -> sp.Expr | None:
    parts = even_and_odd(f, s)
    if parts is None:
        return None
    even, odd, c = parts
    over_cosine = _rational(-odd, c)
    over_angle = _over_half_angle(even, c, s, at)
    if over_cosine is None or over_angle is None:
        return None
    return over_cosine.subs(c, sp.cos(s)) + over_angle


def even_and_odd(f: sp.Expr, s: sp.Symbol) -> tuple[sp.Expr, sp.Expr, sp.Symbol] | None:
    """A, B and c with f = A(c) + sin s · B(c), c = cos s; None where f is none of these."""
    c, d = sp.Dummy("c"), sp.Dummy("d")
    f = f.replace(sp.tan, lambda a: sp.sin(a) / sp.cos(a))
    f = sp.expand_trig(f).xreplace({sp.cos(s): c, sp.sin(s): d})
    if f.has(s) or not f.is_rational_function(c, d):
        return None
    numerator, denominator = sp.fraction(sp.together(f))
    mirrored = denominator.subs(d, -d)
    circle = c**2 + d**2 - 1
    numerator = sp.rem(sp.expand(numerator * mirrored), circle, d)
    denominator = sp.rem(sp.expand(denominator * mirrored), circle, d)
    even, odd = numerator.subs(d, 0), sp.diff(numerator, d)
    return sp.cancel(even / denominator), sp.cancel(odd / denominator), c


def _over_half_angle(A: sp.Expr, c: sp.Symbol, s: sp.Symbol, at: sp.Expr) -> sp.Expr | None:
    """∫A(cos s) ds by t = tan((s − kπ)/2), where kπ is the multiple nearest to `at`."""
    if A == 0:
        return sp.Integer(0)
    if A.is_polynomial(c):
        return primitive(sp.expand(A.subs(c, sp.cos(s))), s)
    coefficient, A = A.as_independent(c, as_Add=False)
    turns = round(to_float(at / sp.pi))
    t = sp.Dummy("t", real=True)
    cosine = (-1 if turns % 2 else 1) * (1 - t**2) / (1 + t**2)
    integral = _rational(sp.cancel(A.subs(c, cosine) * 2 / (1 + t**2)), t)
    if integral is None:
        return None
    half = (s - turns * sp.pi) / 2
    integral = integral.replace(sp.atan, lambda a: half if a == t else sp.atan(a))
    return sp.radsimp(coefficient) * integral.subs(t, sp.tan(half))


def _rational(f: sp.Expr, s: sp.Symbol) -> sp.Expr | None:
    """A primitive of a rational function; powers of one factor stay powers."""
    short = primitive(sp.factor(f), s)
    if short is not None and not short.has(sp.log, sp.atan):
        return short
    try:
        return ratint(tidy(f), s, real=True)
    except (NotImplementedError, ValueError, TypeError):
        return None  # sympy's rules do not cover this integrand
