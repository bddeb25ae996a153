"""Closed expressions and matrices in ball arithmetic.

References
----------
Johansson (2017).
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterable

import flint
import sympy as sp

from necc_casadi.symbolic.fold import Algebra, fold

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
    return fold(expr, _BALLS, known)


def _number(expr: sp.Expr) -> flint.arb | None:
    if isinstance(expr, sp.Rational):
        return flint.arb(flint.fmpq(int(expr.p), int(expr.q)))
    if expr is sp.pi:
        return flint.arb.pi()
    return flint.arb(1).exp() if expr is sp.E else None


def _power(expr: sp.Pow, walk: Callable[[sp.Expr], flint.arb]) -> flint.arb:
    base, exponent = walk(expr.base), expr.exp
    if exponent.is_Integer:
        return base ** int(exponent)
    return base.sqrt() if exponent == sp.Rational(1, 2) else base ** walk(exponent)


def _measured(expr: sp.Expr) -> flint.arb:
    """A ball around a constant of another kind, e.g. a root of a polynomial, from its digits."""
    if not expr.is_number:
        return flint.arb("nan")
    value = expr.evalf(_DIGITS)
    if not (value.is_Float or value.is_Rational):
        return flint.arb("nan")
    return flint.arb(flint.arb(str(value)).mid(), abs(flint.arb(str(value))) * 10 ** (5 - _DIGITS))


_BALLS: Algebra[flint.arb] = Algebra(
    {
        "sin": flint.arb.sin, "cos": flint.arb.cos, "tan": flint.arb.tan,
        "asin": flint.arb.asin, "acos": flint.arb.acos, "atan": flint.arb.atan,
        "sinh": flint.arb.sinh, "cosh": flint.arb.cosh, "tanh": flint.arb.tanh,
        "asinh": flint.arb.asinh, "acosh": flint.arb.acosh, "atanh": flint.arb.atanh,
        "exp": flint.arb.exp, "log": flint.arb.log,
    },
    number=_number,
    power=_power,
    other=_measured,
)  # fmt: skip


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
