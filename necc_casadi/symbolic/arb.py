"""Closed expressions and matrices in ball arithmetic."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterable

import flint
import sympy as sp

__all__ = ["ball", "real_rank"]


_BITS = 333


_DIGITS = 100


def real_rank(matrix: sp.Matrix, symbols: Iterable[sp.Symbol], wanted: int, tries: int = 6) -> bool:
    """Whether `matrix` is proved to have at least rank `wanted` at a real rational point.

    Balls of Arb at a random point; pivots are entries whose balls exclude zero.
    """
    rng = random.Random(1)
    names = sorted(symbols, key=str)
    previous, flint.ctx.prec = flint.ctx.prec, _BITS
    try:
        for attempt in range(tries):
            lo, hi = (-1500, 1500) if attempt % 2 == 0 else (200, 1300)
            point = {s: flint.arb(flint.fmpq(rng.randint(lo, hi), 1009)) for s in names}
            known: dict[sp.Expr, flint.arb] = dict(point.items())
            table = [[ball(e, known) for e in matrix.row(i)] for i in range(matrix.rows)]
            if all(e.is_finite() for row in table for e in row) and _pivoted(table) >= wanted:
                return True
    finally:
        flint.ctx.prec = previous
    return False


def ball(expr: sp.Expr, known: dict[sp.Expr, flint.arb]) -> flint.arb:
    """An Arb ball that contains the value of `expr`; `known` holds the symbols and the cache."""
    if expr not in known:
        known[expr] = _ball(sp.sympify(expr), known)
    return known[expr]


_ARB: dict[type[sp.Expr], Callable[[flint.arb], flint.arb]] = {
    sp.sin: flint.arb.sin, sp.cos: flint.arb.cos, sp.tan: flint.arb.tan,
    sp.asin: flint.arb.asin, sp.acos: flint.arb.acos, sp.atan: flint.arb.atan,
    sp.sinh: flint.arb.sinh, sp.cosh: flint.arb.cosh, sp.tanh: flint.arb.tanh,
    sp.asinh: flint.arb.asinh, sp.acosh: flint.arb.acosh, sp.atanh: flint.arb.atanh,
    sp.exp: flint.arb.exp, sp.log: flint.arb.log,
}  # fmt: skip


def _ball(expr: sp.Expr, known: dict[sp.Expr, flint.arb]) -> flint.arb:
    if isinstance(expr, sp.Rational):
        return flint.arb(flint.fmpq(int(expr.p), int(expr.q)))
    if expr is sp.pi:
        return flint.arb.pi()
    if expr is sp.E:
        return flint.arb(1).exp()
    if type(expr) in _ARB:
        return _ARB[type(expr)](ball(expr.args[0], known))
    if expr.is_Pow:
        base = ball(expr.args[0], known)
        exponent = expr.args[1]
        if exponent.is_Integer:
            return base ** int(exponent)
        if exponent == sp.Rational(1, 2):
            return base.sqrt()
        return base ** ball(exponent, known)
    if expr.is_Add or expr.is_Mul:
        parts = [ball(a, known) for a in expr.args]
        total = parts[0]
        for part in parts[1:]:
            total = total + part if expr.is_Add else total * part
        return total
    return _measured(expr)


def _measured(expr: sp.Expr) -> flint.arb:
    """A ball around a constant of another kind, e.g. a root of a polynomial, from its digits."""
    if not expr.is_number:
        return flint.arb("nan")
    value = expr.evalf(_DIGITS)
    if not (value.is_Float or value.is_Rational):
        return flint.arb("nan")
    return flint.arb(flint.arb(str(value)).mid(), abs(flint.arb(str(value))) * 10 ** (5 - _DIGITS))


def _pivoted(table: list[list[flint.arb]]) -> int:
    """Number of certain pivots in a Gaussian elimination over balls."""
    found, rows = 0, [list(row) for row in table]
    for column in range(len(rows[0]) if rows else 0):
        candidates = [row for row in rows if not row[column].contains(0)]
        if not candidates:
            continue
        pivot = max(candidates, key=lambda row: float(abs(row[column]).mid()))
        rows = [row for row in rows if row is not pivot]
        found += 1
        for row in rows:
            if not row[column].is_zero():
                factor = row[column] / pivot[column]
                for j in range(column, len(row)):
                    row[j] = row[j] - factor * pivot[j]
    return found
