"""Arb balls for the checker alone: intervals, closed forms over boxes, tests on pieces of a box.

Nothing here is shared with the maker of certificates, whose intervals are pairs of doubles.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import reduce

import sympy as sp
from flint import arb, fmpq

__all__ = ["Box", "ball", "by_bisection", "ends", "evaluate", "meet", "times", "widths"]


#: A box: one (lo, hi) of doubles per coordinate.
Box = tuple[tuple[float, float], ...]


def _wave(v: arb, f: Callable[[arb], arb], phase: float) -> arb:
    """Sine or cosine, with extrema at (k + phase)π, of a ball: sharp also where it is wide."""
    if not (v.is_finite() and v.rad() > 1e-6 and v.abs_upper() < 1e5):
        return f(v)
    lower, upper = v.lower(), v.upper()
    slack = 1e-6  # in half periods: an extremum this close counts as inside
    first = math.ceil(float((lower / arb.pi()).mid()) - phase - slack)
    last = math.floor(float((upper / arb.pi()).mid()) - phase + slack)
    if last > first:
        return ball(-1.0, 1.0)
    image = f(lower).union(f(upper))
    return image if last < first else image.union(arb(-1 if first % 2 else 1))


def _monotone(f: Callable[[arb], arb]) -> Callable[[arb], arb]:
    """A monotone function from its values at the ends of a wide ball, which are sharper."""

    def image(v: arb) -> arb:
        if not (v.is_finite() and v.rad() > 1e-6):
            return f(v)
        return f(v.lower()).union(f(v.upper()))

    return image


def _tan(v: arb) -> arb:
    """Between poles it rises."""
    return _RISING_TAN(v) if bool(v.cos() > 0) or bool(v.cos() < 0) else arb.tan(v)


def _reciprocal(v: arb) -> arb:
    return _FALLING(v) if bool(v > 0) or bool(v < 0) else 1 / v


_RISING_TAN, _FALLING = _monotone(arb.tan), _monotone(lambda v: 1 / v)


_FUNCTIONS = {
    "sin": lambda v: _wave(v, arb.sin, 0.5), "cos": lambda v: _wave(v, arb.cos, 0.0),
    "tan": _tan, "asin": _monotone(arb.asin), "acos": _monotone(arb.acos),
    "atan": _monotone(arb.atan), "sinh": _monotone(arb.sinh), "cosh": arb.cosh,
    "tanh": _monotone(arb.tanh), "asinh": _monotone(arb.asinh), "acosh": _monotone(arb.acosh),
    "atanh": _monotone(arb.atanh), "exp": _monotone(arb.exp), "log": _monotone(arb.log),
}  # fmt: skip


def times(a: arb, b: arb) -> arb:
    """A product; of two wide balls by their ends, which is sharper than middle and radius."""
    if a.rad() < 1e-6 or b.rad() < 1e-6 or not (a.is_finite() and b.is_finite()):
        return a * b
    low, high = a.lower(), a.upper()
    first, last = b.lower(), b.upper()
    return (low * first).union(low * last).union(high * first).union(high * last)


def ball(lo: float, hi: float) -> arb:
    """The ball over [lo, hi]."""
    return arb(lo) if lo == hi else arb(lo).union(arb(hi))


def evaluate(expr: sp.Expr, values: Mapping[sp.Symbol, arb]) -> arb:
    """An expression with balls for its symbols."""
    if isinstance(expr, sp.Symbol):
        return values[expr]
    if isinstance(expr, sp.Rational):
        return arb(fmpq(int(expr.p), int(expr.q)))
    if expr == sp.pi:
        return arb.pi()
    if expr == sp.E:
        return arb.const_e()
    if isinstance(expr, sp.Pow):
        return _power(evaluate(expr.base, values), expr.exp, values)
    parts = [evaluate(a, values) for a in expr.args]
    if expr.is_Add:
        return sum(parts[1:], parts[0])
    if expr.is_Mul:
        return reduce(times, parts)
    return _FUNCTIONS[expr.func.__name__](parts[0])


def _power(base: arb, exponent: sp.Expr, values: Mapping[sp.Symbol, arb]) -> arb:
    if exponent.is_Integer:
        power = _integer_power(base, abs(int(exponent)))
        return power if exponent > 0 else _reciprocal(power)
    if exponent == sp.Rational(1, 2):
        return base.sqrt()
    return (base.log() * evaluate(exponent, values)).exp()


def _integer_power(base: arb, exponent: int) -> arb:
    """Repeated squaring: flint's ** takes logarithms, which a ball around 0 has not."""
    if exponent <= 1:
        return base if exponent else arb(1)
    half = _integer_power(base, exponent // 2)
    return half * half * base if exponent % 2 else half * half


def ends(v: arb) -> tuple[float, float]:
    """Doubles around a ball."""
    lo, hi = float(v.lower()), float(v.upper())
    if not arb(lo) <= v.lower():
        lo = math.nextafter(lo, -math.inf)
    if not arb(hi) >= v.upper():
        hi = math.nextafter(hi, math.inf)
    return lo, hi


def meet(a: arb, b: arb) -> arb:
    """What two enclosures of one number have in common."""
    return a.intersection(b) if a.is_finite() and b.is_finite() and a.overlaps(b) else b


def by_bisection(
    box: Box,
    test: Callable[[Box], bool],
    depth: int,
    counts: Sequence[bool] | None = None,
    sizes: Sequence[float] | None = None,
) -> bool:
    """Whether `test` holds on pieces that cover a box; only sides that count are halved.

    The longest side is, by `sizes` where the sides are in different units.
    """
    if test(box):
        return True
    sides = widths(box)
    if sizes is not None:
        sides = [w / s if s > 0 else 0.0 for w, s in zip(sides, sizes, strict=True)]
    if counts is not None:
        sides = [w if c else 0.0 for w, c in zip(sides, counts, strict=True)]
    k = max(range(len(box)), key=sides.__getitem__, default=-1)
    if depth == 0 or k < 0 or sides[k] <= 0:
        return False
    lo, hi = box[k]
    middle = lo / 2 + hi / 2
    halves = ((*box[:k], side, *box[k + 1 :]) for side in ((lo, middle), (middle, hi)))
    return all(by_bisection(half, test, depth - 1, counts, sizes) for half in halves)


def widths(box: Box) -> list[float]:
    """The lengths of the sides, as sizes of its pieces."""
    return [hi - lo for lo, hi in box]
