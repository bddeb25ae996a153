"""sympy to CasADi: the only place where the two meet."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import casadi as ca
import sympy as sp

from necc_casadi.symbolic.floats import to_float
from necc_casadi.symbolic.fold import Algebra, fold

__all__ = ["casadi_function"]


_MOST_FACTORS = 8  # larger powers are calls of pow()


def _number(expr: sp.Expr) -> ca.SX | None:
    return ca.SX(to_float(expr)) if expr.is_number else None


def _power(expr: sp.Pow, walk: Callable[[sp.Expr], ca.SX]) -> ca.SX:
    base, exponent = walk(expr.base), expr.exp
    if exponent == sp.Rational(1, 2):
        return ca.sqrt(base)
    if exponent == sp.Rational(-1, 2):
        return 1 / ca.sqrt(base)
    if exponent.is_Integer and 0 < -exponent <= _MOST_FACTORS:
        return 1 / _integer_power(base, int(-exponent))
    if exponent.is_Integer and 0 < exponent <= _MOST_FACTORS:
        return _integer_power(base, int(exponent))
    return base ** walk(exponent)


def _integer_power(base: ca.SX, exponent: int) -> ca.SX:
    """base^exponent by multiplication: no call of pow() in the generated C."""
    if exponent == 1:
        return base
    half = _integer_power(base, exponent // 2)
    square = half * half
    return square * base if exponent % 2 else square


_CASADI: Algebra[ca.SX] = Algebra(
    {
        "sin": ca.sin, "cos": ca.cos, "tan": ca.tan,
        "asin": ca.asin, "acos": ca.acos, "atan": ca.atan,
        "sinh": ca.sinh, "cosh": ca.cosh, "tanh": ca.tanh,
        "asinh": ca.asinh, "acosh": ca.acosh, "atanh": ca.atanh,
        "exp": ca.exp, "log": ca.log,
    },
    number=_number,
    power=_power,
)  # fmt: skip


def casadi_function(
    name: str, symbols: Sequence[sp.Symbol], matrix: sp.MatrixBase | Sequence[sp.Expr]
) -> ca.Function:
    """The CasADi Function  symbols (one vector) → matrix, scalar operations (SX) inside.

    Raises
    ------
    NeccError
        For a function without a counterpart, and for a symbol that is not among `symbols`.
    """
    matrix = sp.Matrix(matrix)
    z = ca.SX.sym("z", len(symbols))
    known: dict[sp.Expr, ca.SX] = {symbol: z[i] for i, symbol in enumerate(symbols)}
    result = ca.SX(matrix.rows, matrix.cols)
    for (i, j), entry in matrix.todok().items():
        result[i, j] = fold(entry, _CASADI, known)
    return ca.Function(name, [z], [result], ["z"], ["f"])
