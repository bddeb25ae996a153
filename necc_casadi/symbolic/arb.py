"""Closed expressions and matrices in ball arithmetic: certain enclosures, to growing precision.

References
----------
Johansson (2017).
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterable, Mapping

import flint
import sympy as sp

from necc_casadi.symbolic.fold import Algebra, fold

__all__ = [
    "ball",
    "beyond",
    "certain_sign",
    "enclosure",
    "excludes_zero",
    "hull",
    "independent_rows",
    "not_real",
    "real_rank",
]


_BITS = 333


#: Precisions at which a sign is sought. Beyond the last one a number is not told from zero.
_GROWING = (64, 256, 1024, 4096)


def certain_sign(expr: sp.Expr, bits: int = _GROWING[-1]) -> int | None:
    """-1 or 1 where a ball of at most `bits` digits around a real constant excludes 0."""
    for digits in _GROWING:
        if digits > bits:
            break
        with flint.ctx.workprec(digits):
            value = _real(expr)
            if value is None:
                return None
            if value > 0 or value < 0:
                return 1 if value > 0 else -1
    return None


def beyond(expr: sp.Expr, bound: int) -> bool:
    """Whether a real constant is certainly larger than `bound` in size; cheap, however large."""
    for digits in _GROWING:
        with flint.ctx.workprec(digits):
            value = _real(expr)
            if value is not None:
                return bool(abs(value) > bound)
    return False


def excludes_zero(expr: sp.Expr, point: Mapping[sp.Symbol, sp.Expr], bits: int) -> bool | None:
    """Whether `expr` is certainly not 0 at a rational point; None where it has no real value."""
    with flint.ctx.workprec(bits):
        value = enclosure(expr, point)
        if not value.is_finite():
            return None
        return not value.contains(0)


def enclosure(expr: sp.Expr, point: Mapping[sp.Symbol, sp.Expr]) -> flint.arb:
    """A ball around the value at a rational point, to the precision that is set."""
    known: dict[sp.Expr, flint.arb] = {s: ball(sp.sympify(v), {}) for s, v in point.items()}
    return ball(expr, known)


def not_real(expr: sp.Expr) -> bool:
    """Whether a constant is certainly not a real number: its imaginary part is not 0."""
    if expr.is_real is False:
        return True
    with flint.ctx.workprec(_BITS):
        imaginary = _complex(expr).imag
        return bool(imaginary.is_finite()) and not imaginary.contains(0)


def hull(lo: sp.Expr, hi: sp.Expr) -> flint.arb:
    """The ball over an interval with rational ends."""
    return ball(lo, {}).union(ball(hi, {}))


def _real(expr: sp.Expr) -> flint.arb | None:
    """A ball around a real constant, through complex parts where they cancel, or None."""
    value = ball(expr, {})
    if value.is_finite():
        return value
    if expr.is_extended_real is not True:
        return None
    value = _complex(expr).real
    return value if value.is_finite() else None


def real_rank(
    matrix: sp.Matrix,
    symbols: Iterable[sp.Symbol],
    wanted: int,
    tries: int = 6,
    box: Mapping[sp.Symbol, tuple[sp.Expr, sp.Expr]] | None = None,
) -> bool:
    """Whether `matrix` is proved to have at least rank `wanted` at a real rational point.

    Balls of Arb at a random point, of `box` where it names the symbol; pivots are entries whose
    balls exclude zero.
    """
    rng = random.Random(1)
    names = sorted(symbols, key=str)
    with flint.ctx.workprec(_BITS):
        for attempt in range(tries):
            lo, hi = (-1500, 1500) if attempt % 2 == 0 else (200, 1300)
            known: dict[sp.Expr, flint.arb] = {}
            for s in names:
                step = rng.randint(lo, hi)
                if box is not None and s in box:
                    low, high = box[s]
                    value = low + (high - low) * sp.Rational(step - lo, hi - lo)
                else:
                    value = sp.Rational(step, 1009)
                known[s] = ball(value, {})
            table = [[ball(e, known) for e in matrix.row(i)] for i in range(matrix.rows)]
            if all(e.is_finite() for row in table for e in row) and _pivoted(table) >= wanted:
                return True
    return False


def independent_rows(matrix: sp.Matrix, points: Iterable[Mapping[sp.Symbol, sp.Expr]]) -> bool:
    """Whether a·matrix ≡ 0 is proved to have no constant solution a ≠ 0.

    The values at those rational points at which they are real stand side by side.
    """
    with flint.ctx.workprec(_BITS):
        rows: list[list[flint.arb]] = [[] for _ in range(matrix.rows)]
        for point in points:
            known: dict[sp.Expr, flint.arb] = {s: ball(v, {}) for s, v in point.items()}
            table = [[ball(e, known) for e in matrix.row(i)] for i in range(matrix.rows)]
            if all(e.is_finite() for row in table for e in row):
                rows = [left + right for left, right in zip(rows, table, strict=True)]
        return bool(rows and rows[0]) and _pivoted(rows) >= matrix.rows


def ball(expr: sp.Expr, known: dict[sp.Expr, flint.arb]) -> flint.arb:
    """An Arb ball that contains the value of `expr`; `known` holds the symbols and the cache."""
    return fold(expr, _BALLS, known)


_FUNCTIONS: dict[str, Callable[[flint.arb], flint.arb]] = {
    "sin": flint.arb.sin, "cos": flint.arb.cos, "tan": flint.arb.tan,
    "asin": flint.arb.asin, "acos": flint.arb.acos, "atan": flint.arb.atan,
    "sinh": flint.arb.sinh, "cosh": flint.arb.cosh, "tanh": flint.arb.tanh,
    "asinh": flint.arb.asinh, "acosh": flint.arb.acosh, "atanh": flint.arb.atanh,
    "exp": flint.arb.exp, "log": flint.arb.log,
}  # fmt: skip


def _number(expr: sp.Expr) -> flint.arb | None:
    if isinstance(expr, sp.Rational):
        return flint.arb(flint.fmpq(int(expr.p), int(expr.q)))
    if expr is sp.pi:
        return flint.arb.pi()
    return flint.arb(1).exp() if expr is sp.E else None


def _power(expr: sp.Pow, walk: Callable[[sp.Expr], flint.arb]) -> flint.arb:
    base, exponent = walk(expr.base), expr.exp
    if exponent.is_Integer:
        # Arb's ** takes logarithms of a base that may be negative
        power = flint.arb(1)
        for bit in bin(abs(int(exponent)))[2:]:
            power = power * power * base if bit == "1" else power * power
        return power if exponent > 0 else 1 / power
    if exponent == sp.Rational(1, 2):
        return base.sqrt()
    return (base.log() * walk(exponent)).exp() if base > 0 else flint.arb("nan")


def _other(expr: sp.Expr) -> flint.arb:
    """Constants that solutions of equations bring in; of anything else nothing is known."""
    if isinstance(expr, sp.CRootOf) and expr.is_real:
        return _root(expr)
    if isinstance(expr, sp.LambertW) and len(expr.args) == 1 and expr.is_number:
        return ball(expr.args[0], {}).lambertw()
    return flint.arb("nan")


def _root(expr: sp.CRootOf) -> flint.arb:
    """A real root of a polynomial, between the ends of an isolating interval."""
    width = sp.Rational(1, 2**flint.ctx.prec)
    middle = expr.eval_rational(width)
    return flint.arb(
        flint.fmpq(int(middle.p), int(middle.q)), flint.fmpq(int(width.p), int(width.q))
    )


def _complex(expr: sp.Expr) -> flint.acb:
    """A complex constant of radicals and logarithms, on sympy's principal branches."""
    if expr is sp.I:
        return flint.acb(0, 1)
    if expr.is_Add or expr.is_Mul:
        total = _complex(expr.args[0])
        for part in map(_complex, expr.args[1:]):
            total = total + part if expr.is_Add else total * part
        return total
    if isinstance(expr, sp.Pow):
        return _complex(expr.base) ** _complex(expr.exp)
    name = type(expr).__name__
    if name in _FUNCTIONS:
        value: flint.acb = getattr(_complex(expr.args[0]), name)()
        return value
    return flint.acb(ball(expr, {}))


_BALLS: Algebra[flint.arb] = Algebra(_FUNCTIONS, number=_number, power=_power, other=_other)


def _pivoted(table: list[list[flint.arb]]) -> int:
    """Number of certain pivots in a Gaussian elimination over balls."""
    found, rows = 0, [list(row) for row in table]
    for column in range(len(rows[0]) if rows else 0):
        candidates = [row for row in rows if not row[column].contains(0)]
        if not candidates:
            continue
        pivot = max(candidates, key=lambda row: _size(row[column]))
        rows = [row for row in rows if row is not pivot]
        found += 1
        for row in rows:
            if not row[column].is_zero():
                factor = row[column] / pivot[column]
                for j in range(column, len(row)):
                    row[j] = row[j] - factor * pivot[j]
    return found


def _size(value: flint.arb) -> float:
    """Logarithm of a number that is not zero: of any size, where a double would overflow."""
    return float(abs(value).mid().log().mid())
