"""Where expressions of a model have no pole, in balls: what they divide by is proved off 0."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import sympy as sp
from flint import arb

from necc_casadi.certificate.checker.arithmetic.balls import Box, ball, by_bisection, ends, evaluate
from necc_casadi.symbolic.zero import is_zero

__all__ = ["Surroundings"]

#: How often an interval, and a box, may be halved.
_DEPTH = 40
_BOX_DEPTH = 16
#: Entire functions, and those that are smooth on all of ℝ.
_SMOOTH = {"sin", "cos", "exp", "sinh", "cosh", "tanh", "atan", "asinh"}


@dataclass(frozen=True)
class Surroundings:
    """A set of states: open between exact ends, closed in boxes, all around in those that turn."""

    between: Mapping[sp.Symbol, tuple[sp.Expr, sp.Expr]]
    within: Mapping[sp.Symbol, tuple[float, float]]  # a period for those that turn
    turning: Sequence[sp.Symbol]

    def without_pole(self, entries: Iterable[sp.Expr]) -> bool:
        """Whether expressions are smooth in the set."""
        divisors: set[sp.Expr] = set()
        for entry in entries:
            for divisor in _divisors(sp.sympify(entry)):
                if divisor is None:
                    return False
                divisors.add(divisor)
        return all(self.off_zero(d) for d in sorted(divisors, key=str))

    def off_zero(self, expr: sp.Expr) -> bool:
        """Whether an expression without poles keeps off 0 in the set, by its factors."""
        factors = [factor for factor, _ in sp.factor_list(expr)[1]] or [expr]
        return all(self._factor_off_zero(f) for f in factors)

    def _factor_off_zero(self, factor: sp.Expr) -> bool:
        symbols = sorted(factor.free_symbols, key=str)
        if not symbols:
            return is_zero(factor) is False
        for v in (s for s in symbols if s in self.turning):
            turned = factor.subs(v, v + 2 * sp.pi)
            if not any(is_zero(turned + sign * factor) is True for sign in (1, -1)):
                return False
        if len(symbols) == 1 and symbols[0] in self.between:
            return _between(factor, symbols[0], *self.between[symbols[0]])
        if not all(s in self.within for s in symbols):
            return False

        def test(box: Box) -> bool:
            value = evaluate(factor, {s: ball(*b) for s, b in zip(symbols, box, strict=True)})
            return bool(value > 0) or bool(value < 0)

        depth = _DEPTH if len(symbols) == 1 else _BOX_DEPTH
        return by_bisection(tuple(self.within[s] for s in symbols), test, depth)


def _divisors(expr: sp.Expr) -> Iterator[sp.Expr | None]:
    """What an expression divides by; None for what is smooth on a part of ℝ alone."""
    for part in sp.preorder_traversal(expr):
        if isinstance(part, sp.Pow) and part.base.free_symbols | part.exp.free_symbols:
            if not part.exp.is_Integer:
                yield None
            elif part.exp < 0:
                yield from _as_quotient(part.base)
        elif isinstance(part, sp.Function):
            name = part.func.__name__
            if name == "tan":
                yield from _as_quotient(sp.cos(part.args[0]))
            elif name not in _SMOOTH and part.free_symbols:
                yield None


def _as_quotient(base: sp.Expr) -> Iterator[sp.Expr]:
    """1/base is smooth where the numerator and the denominator of `base` keep off 0."""
    yield from (e for e in sp.fraction(sp.together(base)) if e.free_symbols)


def _between(factor: sp.Expr, v: sp.Symbol, lo: sp.Expr, hi: sp.Expr) -> bool:
    """Whether a factor keeps off 0 strictly between two numbers.

    Where it and its first k − 1 slopes vanish at an end, it does as long as the k-th does not.
    """
    sides = (ends(evaluate(lo, {}))[0], ends(evaluate(hi, {}))[1])
    slopes = [factor, sp.diff(factor, v), sp.diff(factor, v, v)]

    def order(end: sp.Expr) -> int | None:
        return next((k for k, s in enumerate(slopes) if is_zero(s.subs(v, end)) is not True), None)

    orders = (order(lo), order(hi))
    if None in orders:
        return False

    def has_sign(expr: sp.Expr, x: arb) -> bool:
        value = evaluate(expr, {v: x})
        return bool(value > 0) or bool(value < 0)

    def test(box: Box) -> bool:
        x = ball(*box[0])
        at_end = [k for k in (0, 1) if box[0][k] == sides[k]]
        return has_sign(factor, x) or any(
            orders[k] != 0 and has_sign(slopes[orders[k] or 0], x) for k in at_end
        )

    return by_bisection((sides,), test, _DEPTH)
