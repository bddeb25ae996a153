"""Formulas to be read: numbers of many digits rounded, factors gathered."""

from __future__ import annotations

import re

import sympy as sp

from necc_casadi.symbolic.expressions import to_text
from necc_casadi.symbolic.floats import to_float

__all__ = ["readable"]


#: Numbers with more digits than this are rounded, to so many.
_EXACT, _DIGITS = 6, 5


def readable(expr: sp.Expr) -> tuple[str, bool]:
    """A formula as text, and whether its numbers are rounded, all of them where any has to be."""
    if not _has_long(expr):
        return to_text(expr), False
    text = to_text(_times(*_short(expr)))
    return re.sub(r"(\d)\.(?!\d)", r"\1", text), True  # 47319 for 47319.


def _has_long(expr: sp.Expr) -> bool:
    return any(_is_long(number) for number in expr.atoms(sp.Rational))


def _is_long(number: sp.Expr) -> bool:
    if not isinstance(number, sp.Rational):
        return False
    return bool(max(abs(int(number.p)), int(number.q)) >= 10**_EXACT)


def _short(expr: sp.Expr) -> tuple[sp.Expr, sp.Expr]:
    """A number and an expression of short numbers, whose product `expr` nearly is."""
    one = sp.Integer(1)
    if not expr.free_symbols:
        return expr.evalf(_DIGITS), one
    if expr.is_Add:
        terms = [_short(term) for term in expr.args]
        largest = max((factor for factor, _ in terms), key=lambda factor: abs(to_float(factor)))
        return largest, sp.Add(*[_times(factor / largest, rest) for factor, rest in terms])
    if expr.is_Mul:
        parts = [_short(part) for part in expr.args]
        return sp.Mul(*[number for number, _ in parts]), sp.Mul(*[rest for _, rest in parts])
    if isinstance(expr, sp.Pow) and expr.exp.is_Integer:
        factor, rest = _short(expr.base)
        return factor**expr.exp, rest**expr.exp
    if expr.args:
        inner = [_times(*_short(part)) if _has_long(part) else part for part in expr.args]
        return one, expr.func(*inner)
    return one, expr


def _times(factor: sp.Expr, rest: sp.Expr) -> sp.Expr:
    """The product, without a factor of 1."""
    if abs(to_float(factor)) == 1:
        return rest if to_float(factor) > 0 else -rest
    return factor.evalf(_DIGITS) * rest
