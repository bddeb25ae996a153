"""Casimirs by integration: kernel vectors that are, up to a factor, gradients.

The separable form of eq. CasimirConditionFunctionCase is v = F with Fᵢ a function of zᵢ alone.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import sympy as sp

from necc_casadi.model.closed_loop import ClosedLoop
from necc_casadi.symbolic.expressions import is_finite
from necc_casadi.symbolic.linear_algebra import kernel
from necc_casadi.symbolic.primitive import MOST_OPERATIONS, primitive
from necc_casadi.symbolic.zero import is_zero

__all__ = ["integrated_kernel"]


_MOST_STATES = 20


def integrated_kernel(loop: ClosedLoop) -> list[sp.Expr]:
    """Functions whose gradient is parallel to a vector of the kernel's reduced basis."""
    if loop.n > _MOST_STATES or sum(e.count_ops() for e in loop.M) > MOST_OPERATIONS // 2:
        return []
    basis = kernel(sp.Matrix(loop.M).T)
    found = []
    for k in range(basis.cols):
        v = list(basis[:, k])
        if sum(e.count_ops() for e in v) > MOST_OPERATIONS:
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
                if slice_ != 0 and is_finite(slice_):
                    yield [sp.cancel(e / slice_) if e != 0 else e for e in scaled]


def _single_variable_factor(v: Sequence[sp.Expr], z: Sequence[sp.Symbol], i: int) -> sp.Expr | None:
    """μ(zᵢ) with μv closed: (∂ⱼvᵢ − ∂ᵢvⱼ)/vⱼ is one function of zᵢ for all j."""
    rate: sp.Expr | None = None
    for j, other in enumerate(v):
        if j == i or other == 0:
            continue
        value = sp.cancel((sp.diff(v[i], z[j]) - sp.diff(other, z[i])) / other)
        if not value.free_symbols <= {z[i]} or (
            rate is not None and is_zero(value - rate) is not True
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
            if is_zero(sp.diff(w[i], z[j]) - sp.diff(w[j], z[i])) is not True:
                return None
    c: sp.Expr = sp.Integer(0)
    for s, slope in zip(z, w, strict=True):
        rest = slope - sp.diff(c, s)
        if rest == 0:
            continue
        part = primitive(sp.cancel(rest), s)
        if part is None:
            return None
        c += part
    return sp.expand(c) if c.count_ops() < MOST_OPERATIONS else c
