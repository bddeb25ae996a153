"""Analytic pieces: boxes on which expressions are smooth, and what roots and arcs are there.

sqrt((q² − 1)²) + q² − 1 is one polynomial for |q| < 1 and another one outside. What is proved of
one piece, a rank, a kernel or a count, says nothing of the next.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import flint
import sympy as sp

from necc_casadi.symbolic.arb import ball, enclosure, hull
from necc_casadi.symbolic.smoothness import Condition, conditions

__all__ = ["Box", "Piece", "branches", "piece_around"]


#: Rational ends for each symbol.
Box = Mapping[sp.Symbol, tuple[sp.Expr, sp.Expr]]


#: How often a box is halved before it is given up, and how finely a box is cut for a proof.
_HALVINGS, _DEPTH = 120, 5


_BITS = 128


@dataclass(frozen=True, eq=False)
class Piece:
    """A box around a point on which expressions are smooth, and what limited it."""

    box: Box
    limits: tuple[Condition, ...]  # conditions that made the box smaller

    def rewritten(self, expr: sp.Expr) -> sp.Expr:
        """The same function on this piece, with roots of squares and arcs of angles resolved."""
        return sp.sympify(expr).replace(_resolvable, self._resolved)

    def _resolved(self, part: sp.Expr) -> sp.Expr:
        resolve = _RESOLVED.get(type(part), Piece._root)
        result = resolve(self, part)
        return part if result is None else result

    def sign(self, expr: sp.Expr) -> int | None:
        """The one sign that an expression has on the whole box, or None."""
        for positive in (expr, -expr):
            if _holds(Condition(positive, True), self.box, _DEPTH):
                return 1 if positive is expr else -1
        return None

    def _factors(self, expr: sp.Expr) -> list[tuple[sp.Expr, sp.Expr]] | None:
        """(fᵢ, kᵢ) with fᵢ > 0 on the box and expr = Π fᵢ^kᵢ, where it is a product at all."""
        product = sp.factor(sp.trigsimp(expr))
        if product.is_Add:
            return None
        result = []
        for factor in sp.Mul.make_args(product):
            base, k = factor.as_base_exp()
            if not k.is_Integer:
                base, k = factor, sp.Integer(1)
            kind = self.sign(base)
            if kind is None:
                return None
            result.append((kind * base, k))
        return result

    def _root(self, part: sp.Expr) -> sp.Expr | None:
        if not isinstance(part, sp.Pow):
            return None
        factors = self._factors(part.base)
        if factors is None or self.sign(part.base) != 1:
            return None
        return sp.Mul(*[f ** (k * part.exp) for f, k in factors])

    def _log(self, part: sp.Expr) -> sp.Expr | None:
        factors = self._factors(part.args[0])
        if factors is None or self.sign(part.args[0]) != 1:
            return None
        return sp.Add(*[k * sp.log(f) for f, k in factors])

    def _atan(self, part: sp.Expr) -> sp.Expr | None:
        argument = sp.trigsimp(part.args[0])
        if isinstance(argument, sp.tan):
            return self._turned_back(argument.args[0], sp.cos(argument.args[0]), sp.pi)
        numerator, denominator = argument.as_numer_denom()
        kind = self.sign(argument)
        if numerator.free_symbols or not denominator.free_symbols or kind is None:
            return None
        return kind * sp.pi / 2 - sp.atan(denominator / numerator)

    def _asin(self, part: sp.Expr) -> sp.Expr | None:
        argument = sp.trigsimp(part.args[0])
        if isinstance(argument, sp.cos):
            angle = sp.pi / 2 - argument.args[0]
        elif isinstance(argument, sp.sin):
            angle = argument.args[0]
        else:
            return None
        kind = self.sign(sp.cos(angle))
        if kind == -1:
            angle = sp.pi - angle
        return None if kind is None else self._turned_back(angle, sp.cos(angle), 2 * sp.pi)

    def _acos(self, part: sp.Expr) -> sp.Expr | None:
        arc = self._asin(sp.asin(part.args[0], evaluate=False))
        return None if arc is None else sp.pi / 2 - arc

    def _acosh(self, part: sp.Expr) -> sp.Expr | None:
        argument = part.args[0]
        if not isinstance(argument, sp.cosh):
            return None
        kind = self.sign(argument.args[0])
        return None if kind is None else kind * argument.args[0]

    def _atanh(self, part: sp.Expr) -> sp.Expr | None:
        argument = part.args[0]
        return argument.args[0] if isinstance(argument, sp.tanh) else None

    def _turned_back(self, angle: sp.Expr, cosine: sp.Expr, period: sp.Expr) -> sp.Expr | None:
        """`angle` less the periods that bring it into ±π/2; the cosine must keep its sign."""
        if self.sign(cosine) is None:
            return None
        middle = {s: (lo + hi) / 2 for s, (lo, hi) in self.box.items()}
        with flint.ctx.workprec(_BITS):
            turns = (enclosure(angle / period, middle) + ball(sp.Rational(1, 2), {})).floor()
            count = turns.unique_fmpz()
        return None if count is None else angle - int(count) * period


_RESOLVED: dict[type[sp.Expr], Callable[[Piece, sp.Expr], sp.Expr | None]] = {
    sp.log: Piece._log, sp.atan: Piece._atan, sp.asin: Piece._asin, sp.acos: Piece._acos,
    sp.acosh: Piece._acosh, sp.atanh: Piece._atanh,
}  # fmt: skip


def _resolvable(part: sp.Expr) -> bool:
    return (
        isinstance(part, sp.Pow) and not part.exp.is_Integer and bool(part.base.free_symbols)
    ) or (type(part) in _RESOLVED and bool(part.free_symbols))


def branches(expressions: Iterable[sp.Expr]) -> bool:
    """Whether a root, a logarithm or an arc function of the symbols occurs."""
    kinds = {sp.asinh, *_RESOLVED}
    return any(
        _resolvable(part) or (type(part) in kinds and bool(part.free_symbols))
        for expr in expressions
        for part in sp.preorder_traversal(expr)
    )


def piece_around(
    expressions: Sequence[sp.Expr],
    middle: Mapping[sp.Symbol, sp.Expr],
    half_widths: Mapping[sp.Symbol, sp.Expr],
) -> Piece | None:
    """The largest box of a halving sequence around a point on which all expressions are smooth.

    Only sides of coordinates that occur in a condition that fails are halved. None where the
    expressions are not proved to be smooth at the point itself.
    """
    demands = conditions(expressions)
    if demands is None:
        return None
    centre = {s: _rational(v) for s, v in middle.items()}
    widths = {s: _rational(half_widths[s]) for s in centre}
    limits: dict[Condition, None] = {}
    for _ in range(_HALVINGS):
        box = {s: (c - widths[s], c + widths[s]) for s, c in centre.items()}
        failing = next((d for d in demands if not _holds(d, box, _DEPTH)), None)
        if failing is None:
            return Piece(box, tuple(limits))
        limits[failing] = None
        shared = failing.part.free_symbols & centre.keys()
        if not shared:
            return None
        for s in shared:
            widths[s] = widths[s] / 2
    return None


def _rational(value: sp.Expr) -> sp.Expr:
    value = sp.sympify(value)
    return value if value.is_Rational else sp.Rational(str(sp.N(value, 30)))


def _holds(condition: Condition, box: Box, depth: int) -> bool:
    """Whether a condition holds on a box, proved on pieces of it."""
    used = {s: box[s] for s in condition.part.free_symbols if s in box}
    with flint.ctx.workprec(_BITS):
        value = ball(condition.part, {s: hull(*ends) for s, ends in used.items()})
    if value > 0 or (value < 0 and not condition.positive):
        return True
    if value < 0 or depth == 0 or not used:
        return False
    widest = max(used, key=lambda s: used[s][1] - used[s][0])
    lo, hi = used[widest]
    middle = (lo + hi) / 2
    return all(
        _holds(condition, {**used, widest: half}, depth - 1)
        for half in ((lo, middle), (middle, hi))
    )
