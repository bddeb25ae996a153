"""Primitives of one-variable functions."""

from __future__ import annotations

from functools import lru_cache

import sympy as sp
from sympy.integrals.manualintegrate import manualintegrate
from sympy.integrals.rationaltools import ratint

from necc_casadi.symbolic.expressions import exact, non_smooth_part

__all__ = ["MOST_OPERATIONS", "primitive"]


MOST_OPERATIONS = 400


def primitive(f: sp.Expr, s: sp.Symbol) -> sp.Expr | None:
    """A closed-form antiderivative of `f` in `s`, or None."""
    coefficient, integrand = f.as_independent(s, as_Add=False)
    if integrand == 1:
        return f * s
    result = _antiderivative(integrand, s)
    return None if result is None else coefficient * result


@lru_cache(maxsize=512)
def _antiderivative(f: sp.Expr, s: sp.Symbol) -> sp.Expr | None:
    if f.count_ops() > MOST_OPERATIONS or _rarely_elementary(f, s):
        return None
    try:
        result = _rational_primitive(f, s)
        if result is None:
            result = manualintegrate(_with_secants(f), s)
    except (RecursionError, NotImplementedError, ValueError, TypeError):
        return None  # sympy's rules do not cover this integrand
    result = exact(result.replace(sp.Abs, lambda a: a))
    unusable = result.has(sp.Integral, sp.I, sp.zoo, sp.nan) or non_smooth_part(result) is not None
    return None if unusable else result


def _rarely_elementary(f: sp.Expr, s: sp.Symbol) -> bool:
    """Mixtures such as s/sin(s) or sqrt(s)·exp(s), on which sympy's rules would search for long."""
    functions = [g for g in f.atoms(sp.Function) if g.has(s)]
    if not functions:
        return False
    rest = f.xreplace({g: sp.Dummy() for g in functions})
    powers = [e for e in f.atoms(sp.Pow) if e.base.has(s)]
    divided = any(e.exp.is_negative and e.base.atoms(sp.Function) for e in powers)
    return (divided and rest.has(s)) or any(not e.exp.is_Integer for e in powers)


def _with_secants(f: sp.Expr) -> sp.Expr:
    """1/cos and 1/sin as sec and csc, for which sympy has rules."""
    for function, reciprocal in ((sp.cos, sp.sec), (sp.sin, sp.csc)):
        f = _with_reciprocal(f, function, reciprocal)
    return f


def _with_reciprocal(
    f: sp.Expr, function: type[sp.Function], reciprocal: type[sp.Function]
) -> sp.Expr:
    def divides(e: sp.Expr) -> bool:
        if not (isinstance(e, sp.Pow) and isinstance(e.base, function)):
            return False
        return e.exp.is_Integer and bool(e.exp < 0)

    return f.replace(divides, lambda e: reciprocal(e.base.args[0]) ** -e.exp)


def _rational_primitive(f: sp.Expr, s: sp.Symbol) -> sp.Expr | None:
    if not f.is_rational_function(s):
        return None
    powers = sp.factor(f)
    coefficient, rest = powers.as_independent(s, as_Add=False)
    base, exponent = rest.as_base_exp()
    slope = sp.diff(base, s)
    if not slope.has(s) and slope != 0 and exponent != -1:
        return coefficient * base ** (exponent + 1) / (slope * (exponent + 1))
    return ratint(f, s)
