"""Where a model is defined: zeros of the denominators of its entries, and proofs that none is met.

Denominators are products of factors. A factor of one state bounds that state where it vanishes; on
an interval between two such ends it is proved to keep off 0.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
import sympy as sp

from necc_casadi.arrays import Truth
from necc_casadi.certificate.prover.arithmetic.boxes import matrix_enclosure, subdivide
from necc_casadi.certificate.prover.arithmetic.intervals import Interval, concatenate, point
from necc_casadi.certificate.prover.arithmetic.jets import constant, expression_values
from necc_casadi.certificate.prover.invariant_sets import OverBox
from necc_casadi.symbolic.smoothness import conditions
from necc_casadi.symbolic.zero import is_zero

__all__ = ["Between", "BetweenFaces", "denominators", "poles_around"]

#: Distances at which a factor is looked at for zeros: two turns closely, then further apart.
_DISTANCES = np.concatenate([np.linspace(0.0, 13.0, 2601)[1:], np.geomspace(13.0, 1e4, 1500)[1:]])
#: A zero is looked for among these multiples of π and numbers, else rounded towards the inside.
_LARGEST, _INSIDE = 24, 1e-9
#: Cells of several states, and halvings of an interval of one.
_CELLS, _HALVINGS = 4096, 40
#: Functions with poles or none, of which sums, products and quotients have poles at zeros alone.
_KNOWN = (sp.sin, sp.cos, sp.tan, sp.exp, sp.sinh, sp.cosh, sp.tanh, sp.atan, sp.asinh)


#: Cells of an interval that need not keep off 0 by their own values.
Excused = Callable[[Interval], Truth]


def denominators(entries: Iterable[sp.Expr]) -> list[sp.Expr] | None:
    """Factors off whose zeros all entries are defined; None where that is not all it takes."""
    found: dict[sp.Expr, None] = {}
    for entry in entries:
        plain = sp.sympify(entry).replace(sp.tan, lambda a: sp.sin(a) / sp.cos(a))
        plain = plain.replace(sp.tanh, lambda a: sp.sinh(a) / sp.cosh(a))
        for part in sp.preorder_traversal(plain):
            whole = isinstance(part, sp.Pow) and part.exp.is_Integer
            if not (
                part.is_Atom or part.is_Add or part.is_Mul or whole or isinstance(part, _KNOWN)
            ):
                return None
        # a quotient inside of a function is undefined wherever its own denominator vanishes
        inner = [a for f in plain.atoms(sp.Function) for a in f.args]
        for part in (plain, *inner):
            for factor, _ in sp.factor_list(sp.denom(sp.together(part)))[1]:
                if factor.free_symbols:
                    found[factor] = None
    return list(found)


def poles_around(
    factors: Sequence[sp.Expr], symbol: sp.Symbol, value: float
) -> tuple[sp.Expr | None, sp.Expr | None]:
    """The nearest zeros below and above a value of the factors in one state; None where none is."""
    mine = [f for f in factors if f.free_symbols == {symbol}]
    lower = [z for f in mine for z in [_nearest(f, symbol, value, -1)] if z is not None]
    upper = [z for f in mine for z in [_nearest(f, symbol, value, 1)] if z is not None]
    return max(lower, key=float, default=None), min(upper, key=float, default=None)


def _nearest(factor: sp.Expr, symbol: sp.Symbol, value: float, sign: int) -> sp.Expr | None:
    f = sp.lambdify([symbol], factor, "numpy")
    with np.errstate(all="ignore"):
        places = value + sign * _DISTANCES
        values = np.asarray(f(places) + 0.0 * places, float)
    for k in range(1, len(places) - 1):
        crosses = values[k - 1] * values[k] <= 0
        touches = abs(values[k]) <= min(abs(values[k - 1]), abs(values[k + 1]))
        if not (crosses or touches):
            continue
        root = _refined(factor, symbol, float(places[k]), crosses)
        if root is not None and sign * (root - value) > 0:
            return _exact(factor, symbol, root, sign)
    return None


def _refined(factor: sp.Expr, symbol: sp.Symbol, start: float, crosses: bool) -> float | None:
    """A zero near a start, of the factor or where it only touches 0, of its slope."""
    try:
        root = float(sp.nsolve(factor if crosses else sp.diff(factor, symbol), symbol, start))
    except (ValueError, ZeroDivisionError, TypeError):
        return None
    left = abs(float(factor.subs(symbol, root)))
    near = abs(float(factor.subs(symbol, root + 1e-3)))
    return root if left <= 1e-6 * near else None


def _exact(factor: sp.Expr, symbol: sp.Symbol, root: float, sign: int) -> sp.Expr:
    for unit in (sp.pi, sp.Integer(1)):
        near = Fraction(root / float(unit)).limit_denominator(_LARGEST)
        guess = unit * sp.Rational(near.numerator, near.denominator)
        close = abs(float(guess) - root) < 1e-6 * max(1.0, abs(root))
        if close and is_zero(factor.subs(symbol, guess)) is True:
            return guess
    inside = Fraction(root - sign * _INSIDE * max(1.0, abs(root)))
    return sp.Rational(inside.numerator, inside.denominator)


@dataclass(frozen=True, eq=False)
class Between:
    """A connected set: states strictly between exact ends, in intervals, or all around."""

    ends: Mapping[sp.Symbol, tuple[sp.Expr, sp.Expr]]
    sides: Mapping[sp.Symbol, Interval]  # of a state that turns, a period for all values
    turning: Sequence[sp.Symbol]

    def is_smooth(self, expressions: Iterable[sp.Expr], middle: dict[sp.Symbol, Interval]) -> bool:
        """Whether every part of expressions, as written, is smooth in the set.

        What keeps off 0 in a connected set is positive where it is at one point, `middle`.
        """
        demands = conditions(expressions)
        return demands is not None and all(
            self.off_zero(demand.part)
            and (not demand.positive or float(expression_values([demand.part], middle)[0].lo) > 0)
            for demand in demands
        )

    def off_zero(self, expr: sp.Expr) -> bool:
        """Whether an expression that is defined in the set keeps off 0 there, by its factors."""
        if not expr.free_symbols:
            return is_zero(expr) is False
        factors = denominators([1 / expr])
        return factors is not None and all(map(self._keeps_off_zero, factors))

    def _keeps_off_zero(self, factor: sp.Expr) -> bool:
        used = sorted(factor.free_symbols, key=str)
        for s in used:
            shifted = factor.subs(s, s + 2 * sp.pi)
            same = True in (is_zero(shifted - factor), is_zero(shifted + factor))
            if s in self.turning and not same:
                return False
        if len(used) == 1 and used[0] in self.ends:
            return _between(factor, used[0], *self.ends[used[0]])
        if not all(s in self.sides for s in used):
            return False
        sides = [self.sides[s] for s in used]
        box = Interval(np.array([v.lo for v in sides]), np.array([v.hi for v in sides]))
        if len(used) == 1:
            return _off_zero(factor, used[0], box, _none)
        cells = subdivide(box, max(4, int(_CELLS ** (1 / len(used)))))
        found = matrix_enclosure(sp.Matrix([[factor]]), used, cells)
        return bool(((found.lo > 0) | (found.hi < 0)).all())


def _none(cells: Interval) -> Truth:
    return np.zeros(cells.shape[0], dtype=bool)


class BetweenFaces(OverBox):
    """Matrices over a box (N,) in which some states stay strictly between exact ends."""

    def __init__(self, symbols: Sequence[sp.Symbol], box: Interval, between: Between) -> None:
        super().__init__(symbols, box)
        self.between = between

    @property
    def middle(self) -> dict[sp.Symbol, Interval]:
        """One state of the set."""
        return {s: point(v) for s, v in zip(self.symbols, self.box.mid, strict=True)}

    def finite(self, matrix: sp.Matrix) -> bool:
        """Whether every entry is finite wherever these states are."""
        return self.between.is_smooth(matrix, self.middle)

    def regular(self, matrix: sp.Matrix) -> bool:
        """Whether a square matrix is regular wherever these states are, by its determinant."""
        det = sp.Matrix(matrix).det()
        short = sp.simplify(det)
        det = short if is_zero(short - det) is True else det
        return self.between.off_zero(sp.numer(sp.together(det)))


def _between(factor: sp.Expr, symbol: sp.Symbol, lo: sp.Expr, hi: sp.Expr) -> bool:
    """Whether a factor keeps off 0 on an open interval, at an end of which it may vanish.

    Near a zero of order k at an end it does where its k-th derivative does not vanish.
    """
    first, last = constant(lo), constant(hi)
    slopes = [factor, sp.diff(factor, symbol), sp.diff(factor, symbol, symbol)]

    def order(end: sp.Expr) -> int:
        values = [is_zero(s.subs(symbol, end)) for s in slopes]
        return next((k for k, v in enumerate(values) if v is not True), 3)

    orders = order(lo), order(hi)

    def excused(cells: Interval) -> Truth:
        result = np.zeros(cells.shape[0], dtype=bool)
        for end, k in zip((first.lo, last.hi), orders, strict=True):
            if k in (1, 2):
                bent = matrix_enclosure(sp.Matrix([[slopes[k]]]), [symbol], cells)[:, 0, 0]
                touching = (cells.lo[:, 0] == end) | (cells.hi[:, 0] == end)
                result |= touching & ((bent.lo > 0) | (bent.hi < 0))
        return result

    box = Interval(np.array([first.lo]), np.array([last.hi]))
    return max(orders) < 3 and _off_zero(factor, symbol, box, excused)


def _off_zero(factor: sp.Expr, symbol: sp.Symbol, box: Interval, excused: Excused) -> bool:
    """Whether a factor keeps off 0 on an interval, or cells of it are excused."""
    cells = subdivide(box, 16)
    for _ in range(_HALVINGS):
        found = matrix_enclosure(sp.Matrix([[factor]]), [symbol], cells)[:, 0, 0]
        settled = (found.lo > 0) | (found.hi < 0) | excused(cells)
        left = cells[~settled]
        if left.shape[0] == 0:
            return True
        if left.shape[0] > _CELLS:
            return False
        middle = left.mid
        cells = concatenate(Interval(left.lo, middle), Interval(middle, left.hi))
    return False
