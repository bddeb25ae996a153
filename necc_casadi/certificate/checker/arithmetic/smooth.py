"""Where expressions are defined and smooth, part by part as they were written, in Arb balls.

A derivative may hide a pole or a kink of what was differentiated (d/dq atan(tan q) = 1).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import reduce
from itertools import product

import sympy as sp
from flint import arb

from necc_casadi.certificate.checker.arithmetic.balls import Box, ball, by_bisection, evaluate
from necc_casadi.symbolic.smoothness import Condition, conditions, periodic

__all__ = ["ends_within", "is_smooth_everywhere", "is_smooth_on"]


#: How often a box may be halved before a condition on it counts as failed; symbols of a condition
#: that is looked at in the corners of a box.
_DEPTH, _CORNERS = 14, 8

#: Both ends of an interval; an end may be infinite.
Range = tuple[arb, arb]

_LINE: Range = (arb("-inf"), arb("inf"))
_UNKNOWN: Range = (arb("nan"), arb("nan"))

#: A little more than one period of sine and cosine.
_PERIOD = (0.0, 6.2832)


def is_smooth_on(expressions: Iterable[sp.Expr], symbols: Sequence[sp.Symbol], box: Box) -> bool:
    """Whether every part of the expressions is proved to be smooth on a box of the symbols."""
    demands = conditions(expressions)
    if demands is None:
        return False
    return all(_holds_on(demand, symbols, box) for demand in demands)


def _holds_on(demand: Condition, symbols: Sequence[sp.Symbol], box: Box) -> bool:
    used = [i for i, s in enumerate(symbols) if demand.part.has(s)]
    names, sides = [symbols[i] for i in used], tuple(box[i] for i in used)

    def test(part: Box) -> bool:
        values = {s: ball(*side) for s, side in zip(names, part, strict=True)}
        value = evaluate(demand.part, values)
        return bool(value > 0) or (not demand.positive and bool(value < 0))

    return by_bisection(sides, test, _DEPTH)


def ends_within(expressions: Iterable[sp.Expr], symbols: Sequence[sp.Symbol], box: Box) -> bool:
    """Whether some part of the expressions is proved to have a pole or a kink in a box.

    In corners, what must not vanish has both signs, or what must be positive is negative.
    """
    return any(_fails_in(demand, symbols, box) for demand in conditions(expressions) or ())


def _fails_in(demand: Condition, symbols: Sequence[sp.Symbol], box: Box) -> bool:
    used = [(s, side) for s, side in zip(symbols, box, strict=True) if demand.part.has(s)]
    if len(used) > _CORNERS:
        return False
    corners = product(*(side for _, side in used))
    values = [
        evaluate(demand.part, {s: arb(v) for (s, _), v in zip(used, corner, strict=True)})
        for corner in corners
    ]
    above, below = any(bool(v > 0) for v in values), any(bool(v < 0) for v in values)
    return below and (demand.positive or above)


def is_smooth_everywhere(
    expressions: Iterable[sp.Expr],
    symbols: Sequence[sp.Symbol],
    within: Mapping[sp.Symbol, tuple[float, float]] | None = None,
) -> bool:
    """Whether every part of the expressions is proved to be smooth for all real values.

    What else than the symbols they contain stays `within` its range.
    """
    demands = conditions(expressions)
    if demands is None:
        return False
    return all(_holds_everywhere(demand, symbols, within or {}) for demand in demands)


def _holds_everywhere(
    demand: Condition,
    symbols: Sequence[sp.Symbol],
    within: Mapping[sp.Symbol, tuple[float, float]],
) -> bool:
    """One period stands for the symbols of which only sines and cosines occur."""
    turning = sorted(periodic([demand], symbols), key=str)
    ranges = [s for s in within if demand.part.has(s)]
    cut = [*turning, *ranges]

    def test(part: Box) -> bool:
        sides = {s: (arb(lo), arb(hi)) for s, (lo, hi) in zip(cut, part, strict=True)}
        lo, hi = _range(demand.part, sides)
        return bool(lo > 0) or (not demand.positive and bool(hi < 0))

    whole = (*(_PERIOD for _ in turning), *(within[s] for s in ranges))
    return by_bisection(whole, test, _DEPTH)


def _range(expr: sp.Expr, sides: Mapping[sp.Symbol, Range]) -> Range:
    """Bounds of an expression; symbols without sides take every real value."""
    if not expr.free_symbols:
        value = evaluate(expr, {})
        return value, value
    if isinstance(expr, sp.Symbol):
        return sides.get(expr, _LINE)
    if isinstance(expr, sp.Pow):
        return _power(_range(expr.base, sides), expr.exp)
    parts = [_range(a, sides) for a in expr.args]
    if expr.is_Add:
        return reduce(lambda a, b: (a[0] + b[0], a[1] + b[1]), parts)
    if expr.is_Mul:
        return reduce(_times, parts)
    return _function(expr, parts[0])


def _times(a: Range, b: Range) -> Range:
    products = [_product(u, v) for u in a for v in b]
    return reduce(arb.min, products), reduce(arb.max, products)


def _product(u: arb, v: arb) -> arb:
    """0·∞ is 0: an infinite end is never reached."""
    return arb(0) if u.is_zero() or v.is_zero() else u * v


def _power(base: Range, exponent: sp.Expr) -> Range:
    lo, hi = base
    if exponent.is_Integer:
        result = _whole_power(base, abs(int(exponent)))
        return result if exponent > 0 else _reciprocal(result)
    if exponent == sp.Rational(1, 2) and bool(lo >= 0):
        return lo.sqrt(), hi.sqrt()
    return _UNKNOWN


def _whole_power(base: Range, k: int) -> Range:
    lo, hi = base
    if k % 2 or bool(lo >= 0):
        return _raised(lo, k), _raised(hi, k)
    if bool(hi <= 0):
        return _raised(hi, k), _raised(lo, k)
    return arb(0), _raised(lo, k).max(_raised(hi, k))


def _raised(v: arb, k: int) -> arb:
    return reduce(arb.__mul__, [v] * k, arb(1))


def _reciprocal(v: Range) -> Range:
    free = bool(v[0] > 0) or bool(v[1] < 0)
    return (1 / v[1], 1 / v[0]) if free else _UNKNOWN


_RISING: dict[type[sp.Expr], Callable[[arb], arb]] = {
    sp.exp: arb.exp, sp.tanh: arb.tanh, sp.sinh: arb.sinh, sp.atan: arb.atan,
    sp.asinh: arb.asinh, sp.log: arb.log,
}  # fmt: skip


def _function(expr: sp.Expr, v: Range) -> Range:
    if isinstance(expr, (sp.sin, sp.cos)):
        if not (v[0].is_finite() and v[1].is_finite()):
            return arb(-1), arb(1)
        wave = sp.sin if isinstance(expr, sp.sin) else sp.cos
        value = evaluate(wave(_ARGUMENT), {_ARGUMENT: v[0].union(v[1])})
        return value.lower(), value.upper()
    if isinstance(expr, sp.cosh):
        return arb(1), v[0].cosh().max(v[1].cosh())
    rising = _RISING.get(type(expr))
    return _UNKNOWN if rising is None else (rising(v[0]), rising(v[1]))


_ARGUMENT = sp.Dummy(real=True)
