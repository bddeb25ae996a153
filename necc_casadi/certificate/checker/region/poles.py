"""Where expressions of a model have no pole, in balls: what they divide by is proved off 0."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import sympy as sp
from flint import arb

from necc_casadi.certificate.checker.arithmetic.balls import Box, ball, by_bisection, ends, evaluate
from necc_casadi.certificate.checker.invariant_sets import OverBox
from necc_casadi.symbolic.smoothness import conditions
from necc_casadi.symbolic.zero import is_zero

__all__ = ["BetweenFaces", "Surroundings"]

#: How often an interval, and a box, may be halved.
_DEPTH = 40
_BOX_DEPTH = 16


@dataclass(frozen=True)
class Surroundings:
    """A set of states: open between exact ends, closed in boxes, all around in those that turn."""

    between: Mapping[sp.Symbol, tuple[sp.Expr, sp.Expr]]
    within: Mapping[sp.Symbol, tuple[float, float]]  # a period for those that turn
    turning: Sequence[sp.Symbol]

    def is_smooth(self, expressions: Iterable[sp.Expr], at: Mapping[sp.Symbol, arb]) -> bool:
        """Whether every part of expressions, as written, is smooth in the set.

        The set is connected: what keeps off 0 in it is positive if it is in one state, `at`.
        """
        demands = conditions(expressions)
        if demands is None:
            return False
        for demand in sorted(demands, key=str):
            parts = sp.fraction(sp.together(demand.part))
            if not all(map(self.off_zero, parts)):
                return False
            if demand.positive and not bool(evaluate(demand.part, at) > 0):
                return False
        return True

    def off_zero(self, expr: sp.Expr) -> bool:
        """Whether an expression without poles keeps off 0 in the set, by its factors."""
        if not expr.free_symbols:
            return is_zero(expr) is False
        factors = [factor for factor, _ in sp.factor_list(expr)[1]] or [expr]
        return all(self._factor_off_zero(f) for f in factors)

    def is_regular(self, block: sp.Matrix) -> bool:
        """Whether a square matrix that is defined in the set is regular there."""
        det = block.det(method="berkowitz")
        short = sp.trigsimp(sp.factor(det))
        det = short if is_zero(short - det) is True else det
        return self.off_zero(sp.fraction(sp.together(det))[0])

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


class BetweenFaces(OverBox):
    """Matrices over a box of all states, some of them strictly between exact ends."""

    def __init__(self, z: Sequence[sp.Symbol], box: Box, surroundings: Surroundings) -> None:
        super().__init__(z, box)
        self.surroundings = surroundings

    def defined(self, matrix: sp.Matrix) -> bool:
        """Whether every entry is smooth where Ω is."""
        at = {v: ball(*side).mid() for v, side in zip(self.z, self.box, strict=True)}
        return self.surroundings.is_smooth(list(matrix), at)

    def regular(self, matrix: sp.Matrix) -> bool:
        """Whether a matrix is square and regular where Ω is."""
        return matrix.rows == matrix.cols > 0 and self.surroundings.is_regular(matrix)


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
