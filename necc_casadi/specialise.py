"""Expressions evaluated at random points of a finite field: fast, exact rank and relations.

A rational function that vanishes identically vanishes at every point of GF(p), so a rank found
there bounds the generic rank from below, and a relation sought there cannot be missed. Functions
are specialised so that their own identities survive: (cos, sin) is a point of the unit circle,
exp of a sum is a product, log of a product is a sum, a^(1/2) is the one square root that is a
square itself. Answers are candidates: whoever uses one proves it (`exact.is_zero`, or Arb
balls at a real point, :func:`real_rank`).
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import flint
import numpy as np
import numpy.typing as npt
import sympy as sp

from necc_casadi.errors import NeccError

__all__ = [
    "PRIMES",
    "Unspecialised",
    "null_basis",
    "nullspace",
    "pivots",
    "rank",
    "real_rank",
    "values",
]

Residues = npt.NDArray[np.int64]

#: Safe primes p = 2q + 1 below 2^31 with p ≡ 7 mod 8 for which 2, 3, 5 and 7 are squares: then
#: the squares form a group of prime order q in which every rational power is well defined.
PRIMES = (2147471759, 2147466359, 2147454839, 2147441519, 2147441159, 2147407799)

_FRACTION = 12  # sin(a/d) and exp(a/d) are consistent for every d that divides this
_BATCHES = 12
_BITS = 333
_DIGITS = 100


class Unspecialised(NeccError):
    """An expression has no value over the finite field, or no usable point was found."""


class _Sample:
    """Values of expressions at a batch of random points; points with a pole are masked out."""

    def __init__(self, size: int, prime: int, rng: random.Random) -> None:
        self.size, self.prime, self.rng = size, prime, rng
        self.good: npt.NDArray[np.bool_] = np.ones(size, dtype=bool)
        self.known: dict[Any, Any] = {}

    def __call__(self, expr: sp.Expr) -> Residues:
        if expr not in self.known:
            self.known[expr] = self._evaluate(expr)
        result: Residues = self.known[expr]
        return result

    def _random(self) -> Residues:
        return np.array([self.rng.randrange(2, self.prime - 1) for _ in range(self.size)])

    def _evaluate(self, expr: sp.Expr) -> Residues:
        p = self.prime
        if expr.is_Rational:
            value = int(expr.p) * pow(int(expr.q), -1, p) % p
            return np.full(self.size, value, dtype=np.int64)
        if expr.is_Add:
            total = np.zeros(self.size, dtype=np.int64)
            for term in expr.args:
                total = (total + self(term)) % p
            return total
        if expr.is_Mul:
            product = np.ones(self.size, dtype=np.int64)
            for factor in expr.args:
                product = product * self(factor) % p
            return product
        if isinstance(expr, sp.exp):
            return self._exponential(expr.args[0])
        if expr.is_Pow:
            return self._power_of(expr)
        return self._function(expr)

    def _power_of(self, expr: sp.Expr) -> Residues:
        base, exponent = expr.args
        if exponent.is_Integer:
            return self._power(self(base), int(exponent))
        if exponent.is_Rational:
            order = (self.prime - 1) // 2
            value = self(base)
            self.good &= self._raised(value, order) == 1
            reduced = int(exponent.p) * pow(int(exponent.q), -1, order) % order
            return self._raised(value, reduced)
        return self._exponential(exponent * sp.log(base))

    def _power(self, base: Residues, exponent: int) -> Residues:
        if exponent < 0:
            self.good &= base != 0
            exponent = -exponent * (self.prime - 2)
        return self._raised(base, exponent)

    def _raised(self, base: Residues, exponent: int) -> Residues:
        result, square = np.ones(self.size, dtype=np.int64), base % self.prime
        while exponent:
            if exponent & 1:
                result = result * square % self.prime
            square = square * square % self.prime
            exponent >>= 1
        return result

    def _terms(self, argument: sp.Expr) -> list[tuple[sp.Expr, int]]:
        """`argument` as Σ kᵢ·(uᵢ/12) with integers kᵢ."""
        result = []
        for term in sp.Add.make_args(sp.expand(argument)):
            coefficient, unit = term.as_coeff_Mul()
            count = coefficient * _FRACTION
            if not count.is_Integer:
                unit, count = term, sp.Integer(_FRACTION)
            result.append((unit, int(count)))
        return result

    def _exponential(self, argument: sp.Expr) -> Residues:
        result = np.ones(self.size, dtype=np.int64)
        for unit, count in self._terms(argument):
            if isinstance(unit, sp.log):
                base, exponent = unit.args[0], sp.Rational(count, _FRACTION)
                result = result * self._power_of(sp.Pow(base, exponent, evaluate=False))
                result %= self.prime
                continue
            key = ("exp", unit)
            if key not in self.known:
                self.known[key] = self._power(self._random(), 2)
            result = result * self._power(self.known[key], count) % self.prime
        return result

    def _circle(self, argument: sp.Expr) -> tuple[Residues, Residues]:
        """(cos, sin) of `argument`."""
        p = self.prime
        cosine, sine = np.ones(self.size, dtype=np.int64), np.zeros(self.size, dtype=np.int64)
        for unit, count in self._terms(argument):
            if unit.is_number and unit.has(sp.pi):
                angle = unit * count / _FRACTION
                c, s = self(sp.cos(angle)), self(sp.sin(angle))
            else:
                c, s = self._turned(unit, count)
            cosine, sine = (cosine * c - sine * s) % p, (cosine * s + sine * c) % p
        return cosine, sine

    def _turned(self, unit: sp.Expr, count: int) -> tuple[Residues, Residues]:
        p, key = self.prime, ("circle", unit)
        if key not in self.known:
            t = self._random()
            inverse = self._power((1 + t * t) % p, -1)
            self.known[key] = ((1 - t * t) % p * inverse % p, 2 * t % p * inverse % p)
        c, s = self.known[key]
        if count < 0:
            s, count = (-s) % p, -count
        cosine, sine = np.ones(self.size, dtype=np.int64), np.zeros(self.size, dtype=np.int64)
        while count:
            if count & 1:
                cosine, sine = (cosine * c - sine * s) % p, (cosine * s + sine * c) % p
            c, s = (c * c - s * s) % p, 2 * c % p * s % p
            count >>= 1
        return cosine, sine

    def _function(self, expr: sp.Expr) -> Residues:
        if isinstance(expr, (sp.cos, sp.sin)) and not (expr.is_number and expr.args[0].has(sp.pi)):
            return self._circle(expr.args[0])[int(isinstance(expr, sp.sin))]
        if isinstance(expr, sp.tan):
            cosine, sine = self._circle(expr.args[0])
            return sine * self._power(cosine, -1) % self.prime
        if isinstance(expr, (sp.sinh, sp.cosh, sp.tanh)):
            return self(expr.rewrite(sp.exp))
        if isinstance(expr, sp.log):
            split = sp.expand_log(sp.log(sp.factor(expr.args[0])), force=True)
            if split != expr and not split.has(sp.nan, sp.zoo):
                return self(split)
        return self._random()  # a symbol, pi, ln, atan, …: nothing algebraic is known about it


def values(
    expressions: Sequence[sp.Expr], points: int, seed: int = 0, prime: int = PRIMES[0]
) -> Residues:
    """Values of `expressions` at random common points of GF(prime), points × len(expressions).

    Raises
    ------
    Unspecialised
        When too few points are free of poles.
    """
    rng = random.Random(seed)
    rows: list[Residues] = []
    found = 0
    for _ in range(_BATCHES):
        sample = _Sample(points + 2, prime, rng)
        columns = [sample(sp.sympify(e)) for e in expressions]
        table = np.stack(columns, axis=1) if columns else np.zeros((points + 2, 0), dtype=np.int64)
        rows.append(table[sample.good])
        found += int(sample.good.sum())
        if found >= points:
            return np.concatenate(rows)[:points]
    raise Unspecialised(f"{found} of {points} points found")


def _table(matrix: Residues, prime: int) -> Any:
    rows, columns = matrix.shape
    return flint.nmod_mat(rows, columns, matrix.ravel().tolist(), prime)


def rank(matrix: Residues, prime: int = PRIMES[0]) -> int:
    """Rank of a matrix of residues."""
    return 0 if 0 in matrix.shape else int(_table(matrix, prime).rank())


def pivots(matrix: Residues, prime: int = PRIMES[0]) -> list[int]:
    """Columns of `matrix` that are independent of the columns before them."""
    if 0 in matrix.shape:
        return []
    reduced, size = _table(matrix, prime).rref()
    entries = [int(v) != 0 for v in reduced.entries()[: size * matrix.shape[1]]]
    return np.argmax(np.array(entries).reshape(size, -1), axis=1).tolist() if size else []


def null_basis(matrix: Residues, prime: int = PRIMES[0]) -> npt.NDArray[Any]:
    """Basis of {v : matrix·v = 0} over GF(prime), one vector per row."""
    return _modular_nullspace(matrix, prime)[1]


def _modular_nullspace(matrix: Residues, prime: int) -> tuple[list[int], npt.NDArray[Any]]:
    """(free columns, basis rows): row k has 1 at its free column and pivot entries before it."""
    columns = matrix.shape[1]
    reduced, size = _table(matrix, prime).rref()
    entries = [int(v) for v in reduced.entries()[: size * columns]]
    table = np.array(entries, dtype=np.int64).reshape(size, columns)
    leading = np.argmax(table != 0, axis=1) if size else np.zeros(0, dtype=np.int64)
    free = np.setdiff1d(np.arange(columns), leading)
    basis = np.zeros((len(free), columns), dtype=np.int64)
    basis[np.arange(len(free)), free] = 1
    basis[:, leading] = (-table[:, free] % prime).T
    return free.tolist(), basis.astype(object)


def nullspace(table: Callable[[int], Residues], primes: int) -> list[list[sp.Rational]]:
    """Rational vectors v with T·v = 0, from the residues `table(p)` of T for several primes p.

    Vector k has entry 1 at the k-th free column and is supported on columns before it. Entries
    are reconstructed from their residues; a vector that does not come out rational is dropped.
    """
    free, combined = _modular_nullspace(table(PRIMES[0]), PRIMES[0])
    modulus = PRIMES[0]
    for prime in PRIMES[1:primes] if free else ():
        same, basis = _modular_nullspace(table(prime), prime)
        if same == free:
            lift = (basis - combined) * pow(modulus, -1, prime) % prime
            combined, modulus = combined + modulus * lift, modulus * prime
    return rational_rows(combined, modulus)


def rational_rows(basis: npt.NDArray[Any], prime: int = PRIMES[0]) -> list[list[sp.Rational]]:
    """The rows whose residues are those of small fractions."""
    rows = [[_reconstruct(int(v), prime) for v in row] for row in basis]
    return [[v for v in row if v is not None] for row in rows if None not in row]


def _reconstruct(residue: int, modulus: int) -> sp.Rational | None:
    """The fraction a/b with a ≡ b·residue and |a|, b below sqrt(modulus/2), if there is one."""
    if residue == 0:
        return sp.Integer(0)
    bound = int(sp.integer_nthroot(modulus // 2, 2)[0])
    r0, r1, s0, s1 = modulus, residue, 0, 1
    while r1 > bound:
        quotient = r0 // r1
        r0, r1, s0, s1 = r1, r0 - quotient * r1, s1, s0 - quotient * s1
    return sp.Rational(r1, s1) if 0 < abs(s1) <= bound else None


def real_rank(matrix: sp.Matrix, symbols: Iterable[sp.Symbol], wanted: int, tries: int = 6) -> bool:
    """Whether `matrix` is proved to have at least rank `wanted` at a real rational point.

    Balls of Arb at a random point; pivots are entries whose balls exclude zero.
    """
    rng = random.Random(1)
    names = sorted(symbols, key=str)
    previous, flint.ctx.prec = flint.ctx.prec, _BITS
    try:
        for attempt in range(tries):
            lo, hi = (-1500, 1500) if attempt % 2 == 0 else (200, 1300)
            point = {s: flint.arb(flint.fmpq(rng.randint(lo, hi), 1009)) for s in names}
            known: dict[sp.Expr, Any] = dict(point)
            table = [[ball(e, known) for e in matrix.row(i)] for i in range(matrix.rows)]
            if all(e.is_finite() for row in table for e in row) and _pivoted(table) >= wanted:
                return True
    finally:
        flint.ctx.prec = previous
    return False


def ball(expr: sp.Expr, known: dict[sp.Expr, Any]) -> Any:
    """An Arb ball that contains the value of `expr`; `known` holds the symbols and the cache."""
    if expr not in known:
        known[expr] = _ball(sp.sympify(expr), known)
    return known[expr]


_ARB = {
    sp.sin: "sin", sp.cos: "cos", sp.tan: "tan", sp.asin: "asin", sp.acos: "acos",
    sp.atan: "atan", sp.sinh: "sinh", sp.cosh: "cosh", sp.tanh: "tanh", sp.asinh: "asinh",
    sp.acosh: "acosh", sp.atanh: "atanh", sp.exp: "exp", sp.log: "log",
}  # fmt: skip


def _ball(expr: sp.Expr, known: dict[sp.Expr, Any]) -> Any:
    if expr.is_Rational:
        return flint.arb(flint.fmpq(int(expr.p), int(expr.q)))
    if expr is sp.pi:
        return flint.arb.pi()
    if expr is sp.E:
        return flint.arb(1).exp()
    if type(expr) in _ARB:
        return getattr(ball(expr.args[0], known), _ARB[type(expr)])()
    if expr.is_Pow:
        base = ball(expr.args[0], known)
        exponent = expr.args[1]
        if exponent.is_Integer:
            return base ** int(exponent)
        if exponent == sp.Rational(1, 2):
            return base.sqrt()
        return base ** ball(exponent, known)
    if expr.is_Add or expr.is_Mul:
        parts = [ball(a, known) for a in expr.args]
        total = parts[0]
        for part in parts[1:]:
            total = total + part if expr.is_Add else total * part
        return total
    return _measured(expr)


def _measured(expr: sp.Expr) -> Any:
    """A ball around a constant of another kind, e.g. a root of a polynomial, from its digits."""
    if not expr.is_number:
        return flint.arb("nan")
    value = expr.evalf(_DIGITS)
    if not (value.is_Float or value.is_Rational):
        return flint.arb("nan")
    return flint.arb(flint.arb(str(value)).mid(), abs(flint.arb(str(value))) * 10 ** (5 - _DIGITS))


def _pivoted(table: list[list[Any]]) -> int:
    """Number of certain pivots in a Gaussian elimination over balls."""
    found, rows = 0, [list(row) for row in table]
    for column in range(len(rows[0]) if rows else 0):
        candidates = [row for row in rows if not row[column].contains(0)]
        if not candidates:
            continue
        pivot = max(candidates, key=lambda row: float(abs(row[column]).mid()))
        rows = [row for row in rows if row is not pivot]
        found += 1
        for row in rows:
            if not row[column].is_zero():
                factor = row[column] / pivot[column]
                for j in range(column, len(row)):
                    row[j] = row[j] - factor * pivot[j]
    return found
