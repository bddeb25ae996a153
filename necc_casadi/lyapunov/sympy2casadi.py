"""sympy to CasADi: the only place where the two meet."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import casadi as ca
import sympy as sp

__all__ = ["casadi_function", "to_casadi"]


_CALLS: dict[type[sp.Basic], Any] = {
    sp.sin: ca.sin, sp.cos: ca.cos, sp.tan: ca.tan,
    sp.asin: ca.asin, sp.acos: ca.acos, sp.atan: ca.atan,
    sp.sinh: ca.sinh, sp.cosh: ca.cosh, sp.tanh: ca.tanh,
    sp.asinh: ca.asinh, sp.acosh: ca.acosh, sp.atanh: ca.atanh,
    sp.exp: ca.exp, sp.log: ca.log,
}  # fmt: skip


def to_casadi(expr: sp.Expr, values: dict[sp.Symbol, Any], cache: dict[sp.Expr, Any]) -> Any:
    """Translate `expr` with symbols looked up in `values`; common subexpressions once."""
    if isinstance(expr, sp.Symbol):
        return values[expr]
    if expr not in cache:
        cache[expr] = _translate(expr, values, cache)
    return cache[expr]


def _translate(expr: sp.Expr, values: dict[sp.Symbol, Any], cache: dict[sp.Expr, Any]) -> Any:
    if expr.is_number:
        return float(sp.N(expr, 20))
    arguments = [to_casadi(a, values, cache) for a in expr.args]
    if expr.is_Add:
        return sum(arguments[1:], arguments[0])
    if expr.is_Mul:
        return _product(expr, arguments)
    if isinstance(expr, sp.Pow):
        return _power(expr, arguments)
    return _CALLS[type(expr)](*arguments)


def _product(expr: sp.Expr, arguments: list[Any]) -> Any:
    result = arguments[0]
    for factor in arguments[1:]:
        result = result * factor
    return result


def _power(expr: sp.Pow, arguments: list[Any]) -> Any:
    base, exponent = arguments
    if expr.exp == sp.Rational(1, 2):
        return ca.sqrt(base)
    if expr.exp == sp.Rational(-1, 2):
        return 1 / ca.sqrt(base)
    if expr.exp.is_Integer and 0 < -expr.exp <= 8:
        return 1 / _integer_power(base, int(-expr.exp))
    if expr.exp.is_Integer and 0 < expr.exp <= 8:
        return _integer_power(base, int(expr.exp))
    return base**exponent


def _integer_power(base: Any, exponent: int) -> Any:
    """base^exponent by multiplication: no call of pow() in the generated C."""
    if exponent == 1:
        return base
    half = _integer_power(base, exponent // 2)
    square = half * half
    return square * base if exponent % 2 else square


def casadi_function(
    name: str, symbols: Sequence[sp.Symbol], matrix: sp.MatrixBase | Sequence[sp.Expr]
) -> ca.Function:
    """The CasADi Function  symbols (one vector) → matrix, scalar operations (SX) inside."""
    matrix = sp.Matrix(matrix)
    z = ca.SX.sym("z", len(symbols))
    values = {symbol: z[i] for i, symbol in enumerate(symbols)}
    cache: dict[sp.Expr, Any] = {}
    result = ca.SX(matrix.rows, matrix.cols)
    for (i, j), entry in matrix.todok().items():
        result[i, j] = to_casadi(entry, values, cache)
    return ca.Function(name, [z], [result], ["z"], ["f"])
