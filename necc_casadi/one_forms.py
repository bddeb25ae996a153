"""Casimirs by integration: kernel vectors that are, up to a factor, gradients.

The separable form of the paper is the special case v = F with Fᵢ a function of zᵢ alone.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import lru_cache

import sympy as sp
from sympy.integrals.manualintegrate import manualintegrate
from sympy.integrals.rationaltools import ratint

from necc_casadi import exact as ex
from necc_casadi.expressions import exact, non_smooth_part
from necc_casadi.loop import ClosedLoop

__all__ = ["integrated_kernel", "primitive"]

_MOST_STATES = 20
_MOST_OPERATIONS = 400


def primitive(f: sp.Expr, s: sp.Symbol) -> sp.Expr | None:
    """A closed-form antiderivative of `f` in `s`, or None."""
    coefficient, integrand = f.as_independent(s, as_Add=False)
    if integrand == 1:
        return f * s
    result = _antiderivative(integrand, s)
    return None if result is None else coefficient * result


@lru_cache(maxsize=512)
def _antiderivative(f: sp.Expr, s: sp.Symbol) -> sp.Expr | None:
    if f.count_ops() > _MOST_OPERATIONS or _rarely_elementary(f, s):
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
        f = f.replace(
            lambda e, function=function: (
                e.is_Pow and isinstance(e.base, function) and e.exp.is_Integer and e.exp < 0
            ),
            lambda e, reciprocal=reciprocal: reciprocal(e.base.args[0]) ** -e.exp,
        )
    return f


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


def integrated_kernel(loop: ClosedLoop) -> list[sp.Expr]:
    """Functions whose gradient is parallel to a vector of the kernel's reduced basis."""
    if loop.n > _MOST_STATES or sum(e.count_ops() for e in loop.M) > _MOST_OPERATIONS // 2:
        return []
    basis = ex.kernel(sp.Matrix(loop.M).T)
    found = []
    for k in range(basis.cols):
        v = list(basis[:, k])
        if sum(e.count_ops() for e in v) > _MOST_OPERATIONS:
            continue
        for w in _scalings(v, loop.z):
            c = potential(w, loop.z)
            if c is not None:
                found.append(c)
                break
    return found


def _scalings(v: Sequence[sp.Expr], z: Sequence[sp.Symbol]) -> Iterable[list[sp.Expr]]:
    """V times simple integrating factors."""
    yield list(v)
    yield from _separated(v, z)
    for entry in v:
        if entry.free_symbols:
            yield [sp.cancel(e / entry) if e != 0 else e for e in v]
            yield [sp.cancel(e * entry) if e != 0 else e for e in v]
    for i, s in enumerate(z):
        factor = _single_variable_factor(v, z, i)
        if factor is not None and factor.free_symbols <= {s}:
            yield [sp.cancel(factor * e) for e in v]


def _separated(v: Sequence[sp.Expr], z: Sequence[sp.Symbol]) -> Iterable[list[sp.Expr]]:
    """The separable form of the paper: αv = F with Fᵢ a function of zᵢ alone.

    If αvⱼ = Fⱼ(zⱼ) with α a function of zᵢ, then 1/α is vⱼ at any fixed zⱼ, up to a constant.
    """
    for i, s in enumerate(z):
        if v[i] == 0:
            continue
        scaled = [sp.cancel(e / v[i]) if e != 0 else e for e in v]
        for entry in scaled:
            others = entry.free_symbols - {s}
            for value in (0, 1) if s in entry.free_symbols and others else ():
                slice_ = entry.subs(dict.fromkeys(others, value))
                if slice_ != 0 and not slice_.has(sp.zoo, sp.nan, sp.oo):
                    yield [sp.cancel(e / slice_) if e != 0 else e for e in scaled]


def _single_variable_factor(v: Sequence[sp.Expr], z: Sequence[sp.Symbol], i: int) -> sp.Expr | None:
    """μ(zᵢ) with μv closed: (∂ⱼvᵢ − ∂ᵢvⱼ)/vⱼ is one function of zᵢ for all j."""
    rate: sp.Expr | None = None
    for j, other in enumerate(v):
        if j == i or other == 0:
            continue
        value = sp.cancel((sp.diff(v[i], z[j]) - sp.diff(other, z[i])) / other)
        if not value.free_symbols <= {z[i]} or (
            rate is not None and ex.is_zero(value - rate) is not True
        ):
            return None
        rate = value
    if rate is None or rate == 0:
        return None
    exponent = primitive(rate, z[i])
    return None if exponent is None else sp.simplify(sp.exp(exponent))


def potential(w: Sequence[sp.Expr], z: Sequence[sp.Symbol]) -> sp.Expr | None:
    """C with ∇C = w where w is closed and integrates in closed form, else None."""
    for i in range(len(z)):
        for j in range(i):
            if ex.is_zero(sp.diff(w[i], z[j]) - sp.diff(w[j], z[i])) is not True:
                return None
    c = sp.Integer(0)
    for s, slope in zip(z, w, strict=True):
        rest = slope - sp.diff(c, s)
        if rest == 0:
            continue
        part = primitive(sp.cancel(rest), s)
        if part is None:
            return None
        c += part
    return sp.expand(c) if c.count_ops() < _MOST_OPERATIONS else c
