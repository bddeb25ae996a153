"""Text to exact sympy expressions and back, without ``eval``.

One grammar serves targets, parameters and stored designs: numbers (decimals
are exact rationals), ``+ - * / **``, names, and the smooth functions of
:data:`FUNCTIONS`.
"""

from __future__ import annotations

import ast
import math
import re
from collections.abc import Callable, Mapping

import sympy as sp

from necc_casadi.errors import InputError
from necc_casadi.symbolic.arb import beyond
from necc_casadi.symbolic.floats import steady_precision, to_float

__all__ = [
    "CONSTANTS",
    "FUNCTIONS",
    "complexity",
    "exact",
    "is_finite",
    "non_smooth_part",
    "parse",
    "parse_number",
    "split_logarithms",
    "to_text",
]


#: Smooth functions that a model may use; each has a CasADi and an Arb counterpart.
FUNCTIONS: dict[str, Callable[..., sp.Expr]] = {
    "sin": sp.sin, "cos": sp.cos, "tan": sp.tan,
    "asin": sp.asin, "acos": sp.acos, "atan": sp.atan,
    "sinh": sp.sinh, "cosh": sp.cosh, "tanh": sp.tanh,
    "asinh": sp.asinh, "acosh": sp.acosh, "atanh": sp.atanh,
    "exp": sp.exp, "log": sp.log, "sqrt": sp.sqrt,
}  # fmt: skip


CONSTANTS = {"pi": sp.pi, "E": sp.E, "e": sp.E}


#: Functions that are rewritten on entry in terms of the ones above.
_REWRITTEN = {
    sp.cot: lambda a: sp.cos(a) / sp.sin(a),
    sp.sec: lambda a: 1 / sp.cos(a),
    sp.csc: lambda a: 1 / sp.sin(a),
    sp.coth: lambda a: sp.cosh(a) / sp.sinh(a),
    sp.sech: lambda a: 1 / sp.cosh(a),
    sp.csch: lambda a: 1 / sp.sinh(a),
    sp.acot: lambda a: sp.atan(1 / a),
}


_MAX_EXPONENT = 1000


_MAX_BITS = 50_000


_MAX_LENGTH = 2_000_000


_LARGEST_PRIME = 10_000  # that is taken out of a logarithm


_DECIMAL = re.compile(r"(?:\d+\.?\d*|\.\d+)(?:[eE](?P<exponent>[+-]?\d+))?", re.ASCII)


@steady_precision()
def parse(text: str, symbols: Mapping[str, sp.Symbol] | None = None) -> sp.Expr:
    """Parse `text` into an exact expression over `symbols`.

    Raises
    ------
    ValueError
        With one line that names the piece that could not be read.
    """
    if len(text) > _MAX_LENGTH:
        raise ValueError(f"the expression is longer than {_MAX_LENGTH} characters")
    source = text.strip()
    if "#" in source or not source.isprintable():  # a comment could say anything beside a number
        raise ValueError(f"{_shown(source)} is not an expression")
    try:
        tree = ast.parse(source, mode="eval")
    except (SyntaxError, ValueError, MemoryError, RecursionError):
        raise ValueError(f"{_shown(source)} is not an expression") from None
    try:
        result: sp.Expr = _convert(tree.body, source, symbols or {})
        finite = is_finite(result)
    except RecursionError:
        raise ValueError("the expression is nested too deeply") from None
    except (ArithmeticError, TypeError):
        raise ValueError(f"{_shown(source)} cannot be evaluated") from None
    if not finite:
        raise ValueError(f"{_shown(source)} is not finite")
    return result


def _shown(text: str, limit: int = 60) -> str:
    return repr(text if len(text) <= limit else text[: limit - 1] + "…")


def _convert(node: ast.expr, source: str, symbols: Mapping[str, sp.Symbol]) -> sp.Expr:
    match node:
        case ast.Constant():
            return _literal(ast.get_source_segment(source, node) or "")
        case ast.Name(id=name):
            if name in symbols:
                return symbols[name]
            if name in CONSTANTS:
                return CONSTANTS[name]
            raise ValueError(f"the name {_shown(name)} is unknown here")
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            return -_convert(operand, source, symbols)
        case ast.UnaryOp(op=ast.UAdd(), operand=operand):
            return _convert(operand, source, symbols)
        case ast.BinOp(op=ast.BitXor()):
            raise ValueError(f"{_piece(node, source)} uses '^'; a power is written '**'")
        case ast.BinOp(left=left, op=op, right=right):
            return _binary(
                op,
                _convert(left, source, symbols),
                _convert(right, source, symbols),
                _piece(node, source),
            )
        case ast.Call(func=ast.Name(id=name), args=[argument], keywords=[]) if name in FUNCTIONS:
            inner = _convert(argument, source, symbols)
            if inner.is_number and is_finite(inner) and beyond(inner, 10**_MAX_EXPONENT):
                raise ValueError(
                    f"the argument of {_piece(node, source)} exceeds 1e{_MAX_EXPONENT}"
                )
            return FUNCTIONS[name](inner)
    raise ValueError(f"{_piece(node, source)} is not allowed in an expression")


def _literal(text: str) -> sp.Rational:
    """A decimal literal as the rational that it displays."""
    digits = _DECIMAL.fullmatch(text.replace("_", ""))
    if digits is None:
        raise ValueError(f"{_shown(text)} is not a decimal number")
    if len(text) > _MAX_EXPONENT or abs(int(digits["exponent"] or 0)) > _MAX_EXPONENT:
        raise ValueError(f"{_shown(text)} has too many digits")
    return sp.Rational(digits[0])


def _piece(node: ast.expr, source: str) -> str:
    return _shown(ast.get_source_segment(source, node) or source)


def _binary(op: ast.operator, left: sp.Expr, right: sp.Expr, piece: str) -> sp.Expr:
    match op:
        case ast.Add():
            return left + right
        case ast.Sub():
            return left - right
        case ast.Mult():
            return left * right
        case ast.Div():
            if right == 0:
                raise ValueError(f"{piece} divides by zero")
            return left / right
        case ast.Pow():
            if right.is_number and abs(right) > _MAX_EXPONENT:
                raise ValueError(f"the exponent in {piece} is larger than {_MAX_EXPONENT}")
            if right.is_number and abs(right) * _bits(left) > _MAX_BITS:
                raise ValueError(f"the numbers in {piece} grow too long")
            return left**right
    raise ValueError(f"{piece} uses an operator that is not allowed")


def _bits(expr: sp.Expr) -> int:
    """Length of the longest number in `expr`, which a power multiplies."""
    numbers = expr.atoms(sp.Rational)
    return max((int(part).bit_length() for v in numbers for part in (v.p, v.q)), default=0)


def to_text(expr: sp.Expr) -> str:
    """Text that :func:`parse` reads back to the same expression."""
    return str(sp.sstr(expr, full_prec=True))


def exact(expr: sp.Expr) -> sp.Expr:
    """`expr` with decimals as the rationals they display, and cot, sec, … rewritten."""
    expr = sp.sympify(expr)
    if not isinstance(expr, sp.Basic):
        raise TypeError(f"{expr!r} is not an expression")
    floats = {f: sp.Rational(repr(float(f))) for f in expr.atoms(sp.Float)}
    if floats:
        expr = expr.xreplace(floats)
    for function, rewritten in _REWRITTEN.items():
        if expr.has(function):
            expr = expr.replace(function, rewritten)
    return expr


def non_smooth_part(expr: sp.Expr) -> sp.Basic | None:
    """The first part of `expr` that is not one of the smooth functions, or None."""
    allowed = {f for f in FUNCTIONS.values() if isinstance(f, type)}
    for part in sp.preorder_traversal(expr):
        if part.is_Atom or part.is_Add or part.is_Mul or part.is_Pow:
            continue
        if type(part) not in allowed:
            return part
    return None


@steady_precision()
def parse_number(text: str, what: str, code: str, error: type[InputError]) -> sp.Expr:
    """A real constant such as ``pi/4`` or ``-0.25``, exact.

    Raises
    ------
    InputError
        Of the given class and code when `text` is not a finite real constant.
    """
    remedy = "Constant expressions work: pi/4, -sqrt(2)/2, 3/8, 0.25."
    try:
        value = parse(text)
    except ValueError as problem:
        raise error(code, f"{what}: {problem}", remedy) from None
    if not value.is_number or value.is_real is not True:
        raise error(code, f"{what}: {_shown(text.strip())} is not a real number", remedy)
    if not _fits_double(value):
        raise error(code, f"{what}: {_shown(text.strip())} is too large for a double", remedy)
    return value


def _fits_double(value: sp.Expr) -> bool:
    try:
        return math.isfinite(to_float(value))
    except (ArithmeticError, TypeError, ValueError):
        return False


def split_logarithms(expr: sp.Expr) -> sp.Expr:
    """log(6 + 6x) as log 2 + log 3 + log(1 + x): equal logarithms then look equal."""
    return expr.replace(sp.log, _split_logarithm)


def _split_logarithm(argument: sp.Expr) -> sp.Expr:
    content, part = sp.together(argument).primitive()
    if not isinstance(content, sp.Rational) or not content > 0:
        return sp.log(argument)
    factors = [(prime, k) for prime, k in sp.factorint(content.p, limit=_LARGEST_PRIME).items()]
    factors += [(prime, -k) for prime, k in sp.factorint(content.q, limit=_LARGEST_PRIME).items()]
    return sp.Add(*[k * sp.log(prime) for prime, k in factors]) + sp.log(part)


def is_finite(expr: sp.Expr | sp.MatrixBase) -> bool:
    """Whether no infinity and no undefined value stands in an expression."""
    return not expr.has(sp.zoo, sp.nan, sp.oo, -sp.oo)


def complexity(expr: sp.Expr) -> int:
    """Symbols, powers and functions in an expression; in other units it has as many."""
    return sum(
        not (isinstance(part, sp.Number) or part.is_Add or part.is_Mul)
        for part in sp.preorder_traversal(expr)
    )
