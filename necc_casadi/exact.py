"""Exact decisions on symbolic scalars and matrices: zero, sign, rank, definiteness.

Each answer is True (proved), False (refuted) or None (not decided); None is
never turned into a yes. Refutations come from exact values or from
high-precision values far from zero, proofs from symbolic algebra.
"""

from __future__ import annotations

import random
from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache

import sympy as sp
from sympy.polys.matrices import DomainMatrix

__all__ = [
    "blocks",
    "generic_rank",
    "is_positive_semidefinite",
    "is_zero",
    "kernel",
    "random_point",
    "sign",
]

_DIGITS = 40
_PROBES = 3


def random_point(
    symbols: Iterable[sp.Symbol],
    seed: int = 0,
    box: Mapping[sp.Symbol, tuple[sp.Expr, sp.Expr]] | None = None,
) -> dict[sp.Symbol, sp.Rational]:
    """Rational values, one per symbol: inside `box` where it names the symbol, else in [-2, 2].

    Denominators are primes near 1000, so that a generic property holds there unless unlucky.
    """
    rng = random.Random(seed)
    point = {}
    for symbol in sorted(symbols, key=str):
        lo, hi = (box or {}).get(symbol, (sp.Integer(-2), sp.Integer(2)))
        lo, hi = sp.Rational(str(sp.N(lo, 17))), sp.Rational(str(sp.N(hi, 17)))
        fraction = sp.Rational(rng.randrange(1, 1009), 1009)
        point[symbol] = sp.Rational(str(sp.N(lo + (hi - lo) * fraction, 8)))
    return point


@lru_cache(maxsize=65536)
def sign(expr: sp.Expr) -> int | None:
    """Sign of a real constant, exactly: -1, 0 or 1; None where it is not a finite real number."""
    expr = sp.sympify(expr)
    if expr.is_Rational:
        return int(sp.sign(expr))
    if not expr.is_number or expr.has(sp.zoo, sp.nan, sp.oo, -sp.oo):
        return None
    value = _probe(expr)
    if value is None or abs(sp.im(value)) > sp.Float(10) ** (-_DIGITS // 2):
        return None
    if abs(value) > sp.Float(10) ** (-_DIGITS // 2):
        return 1 if sp.re(value) > 0 else -1
    if sp.simplify(expr) == 0 or expr.equals(0):
        return 0
    value = sp.re(expr.evalf(1000, maxn=5000))  # a very small number that is not zero?
    if value.is_comparable and value != 0 and abs(value) > sp.Float(10) ** -900:
        return 1 if value > 0 else -1
    return None


def _probe(expr: sp.Expr) -> sp.Expr | None:
    value = expr.evalf(_DIGITS, maxn=4 * _DIGITS)
    return value if value.is_number and value.is_finite is not False and value != sp.nan else None


@lru_cache(maxsize=65536)
def is_zero(expr: sp.Expr) -> bool | None:
    """Whether `expr` vanishes identically in its symbols."""
    expr = sp.sympify(expr)
    if expr == 0:
        return True
    if not expr.free_symbols:
        value = sign(expr)
        return None if value is None else value == 0
    for seed in range(_PROBES):
        value = _probe(expr.subs(random_point(expr.free_symbols, seed)))
        if value is not None and abs(value) > sp.Float(10) ** (-_DIGITS // 2):
            return False
    for attempt in (sp.expand, sp.together, sp.trigsimp, sp.simplify, _over_exponentials):
        if attempt(expr) == 0:
            return True
    return None


def _over_exponentials(expr: sp.Expr) -> sp.Expr:
    """Sines and cosines as exponentials over a common denominator: a normal form for them."""
    numerator, _ = sp.fraction(sp.together(expr.rewrite(sp.exp)))
    return sp.powsimp(sp.expand(sp.powsimp(sp.expand(numerator))))


def generic_rank(matrix: sp.Matrix, tries: int = _PROBES) -> int:
    """Rank of `matrix` at generic points: the largest found at random rational points.

    A rank found at one point is a proved lower bound of the generic rank.
    """
    symbols = matrix.free_symbols
    if not symbols:
        return _rank(matrix)
    best = 0
    for seed in range(tries):
        value = matrix.subs(random_point(symbols, seed))
        if not value.has(sp.zoo, sp.nan, sp.oo):
            best = max(best, _rank(value))
        if best == min(matrix.shape):
            break
    return best


def _rank(matrix: sp.Matrix) -> int:
    """Rank of a constant matrix; over the rationals where they suffice, else to 40 digits."""
    if all(entry.is_Rational for entry in matrix):
        return int(DomainMatrix.from_Matrix(matrix).to_field().rank())
    return int(
        matrix.evalf(_DIGITS).rank(
            iszerofunc=lambda v: bool(abs(v) < sp.Float(10) ** (-_DIGITS // 2))
        )
    )


def kernel(matrix: sp.Matrix) -> sp.Matrix:
    """Basis of {v : matrix·v = 0} as columns, over the field that the entries generate.

    For rational entries: the reduced-echelon basis of the kernel itself, scaled to primitive
    integers, first nonzero coefficient positive.
    """
    rows, columns = matrix.shape
    if rows == 0:
        return sp.eye(columns)
    basis = DomainMatrix.from_Matrix(matrix).to_field().nullspace()
    if basis.shape[0] == 0:
        return sp.zeros(columns, 0)
    reduced, _ = basis.rref()
    return sp.Matrix([_primitive(row) for row in reduced.to_Matrix().tolist()]).T


def _primitive(row: Sequence[sp.Expr]) -> list[sp.Expr]:
    if not all(entry.is_Rational for entry in row):
        return list(row)
    scale = sp.ilcm(1, *[entry.q for entry in row])
    integers = [entry * scale for entry in row]
    divisor = sp.igcd(*integers) or 1
    first = next((entry for entry in integers if entry != 0), sp.Integer(1))
    return [entry / divisor * (1 if first > 0 else -1) for entry in integers]


def blocks(matrix: sp.Matrix) -> list[list[int]]:
    """Indices of the diagonal blocks of a symmetric sparsity pattern, each sorted."""
    size = matrix.rows
    unseen, result = set(range(size)), []
    while unseen:
        stack, block = [min(unseen)], set()
        while stack:
            i = stack.pop()
            if i in unseen:
                unseen.remove(i)
                block.add(i)
                stack.extend(j for j in unseen if matrix[i, j] != 0 or matrix[j, i] != 0)
        result.append(sorted(block))
    return result


def is_positive_semidefinite(matrix: sp.Matrix) -> bool | None:
    """Whether a symmetric matrix is positive semidefinite for all real values of its symbols."""
    verdicts = [_block_psd(matrix.extract(block, block)) for block in blocks(matrix)]
    if False in verdicts:
        return False
    return None if None in verdicts else True


def _block_psd(block: sp.Matrix) -> bool | None:
    """Symmetric elimination with pivots of known sign, then principal minors."""
    remaining = sp.Matrix(block)
    while remaining.rows:
        signs = [_sign_everywhere(remaining[i, i]) for i in range(remaining.rows)]
        if "-" in signs:
            return False
        if "+" in signs:
            pivot = signs.index("+")
        elif "0" in signs:
            zero = signs.index("0")
            others = [_is_zero_row(remaining, zero, j) for j in range(remaining.rows) if j != zero]
            if False in others:
                return False
            if None in others:
                return None
            remaining = _without(remaining, zero)
            continue
        else:
            return _minors_psd(remaining)
        column = _without(remaining, pivot, rows_only=True)[:, pivot]
        schur = _without(remaining, pivot) - column * column.T / remaining[pivot, pivot]
        remaining = schur.applyfunc(sp.cancel if schur.free_symbols else sp.nsimplify)
    return True


def _is_zero_row(matrix: sp.Matrix, i: int, j: int) -> bool | None:
    return is_zero(matrix[i, j])


def _without(matrix: sp.Matrix, index: int, rows_only: bool = False) -> sp.Matrix:
    keep = [i for i in range(matrix.rows) if i != index]
    return matrix.extract(keep, list(range(matrix.cols)) if rows_only else keep)


def _sign_everywhere(expr: sp.Expr) -> str:
    """``+`` positive, ``0`` zero, ``>`` nonnegative, ``-`` negative, ``?`` unknown."""
    if not expr.free_symbols:
        return {1: "+", 0: "0", -1: "-", None: "?"}[sign(expr)]
    simplified = sp.factor(expr)
    for candidate in (expr, simplified):
        if candidate.is_positive:
            return "+"
        if candidate.is_negative:
            return "-"
        if candidate.is_nonnegative:
            return ">"
    return "0" if is_zero(expr) else "?"


def _minors_psd(matrix: sp.Matrix, limit: int = 5) -> bool | None:
    """All principal minors nonnegative; only for small matrices."""
    if matrix.rows > limit:
        return None
    for mask in range(1, 2**matrix.rows):
        chosen = [i for i in range(matrix.rows) if mask >> i & 1]
        kind = _sign_everywhere(sp.expand(matrix.extract(chosen, chosen).det()))
        if kind == "-":
            return False
        if kind == "?":
            return None
    return True
