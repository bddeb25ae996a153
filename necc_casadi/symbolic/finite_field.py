"""Expressions evaluated at random points of a finite field: fast, exact rank and relations.

A rational function that vanishes identically vanishes at every point of GF(p), so a rank found
there bounds the generic rank from below, and a relation sought there cannot be missed. Functions
are specialised so that their own identities survive: (cos, sin) is a point of the unit circle,
exp of a sum is a product, log of a product is a sum, a^(1/2) is the one square root that is a
square itself. Answers are candidates: whoever uses one proves it (`zero.is_zero`, or Arb balls
at a real point, `arb.real_rank`).

References
----------
Schwartz (1980).
"""

from __future__ import annotations

import random
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import sympy as sp

from necc_casadi.errors import NeccError
from necc_casadi.symbolic.expressions import is_finite

__all__ = ["PRIMES", "NoFiniteFieldValue", "Residues", "values"]


Residues = npt.NDArray[np.int64]


#: Safe primes p = 2q + 1 below 2^31 with p ≡ 7 mod 8 for which 2, 3, 5 and 7 are squares: then
#: the squares form a group of prime order q in which every rational power is well defined. All of
#: them together tell fractions up to 2¹⁸⁵, as coefficients are in unlike units.
PRIMES = (
    2147471759, 2147466359, 2147454839, 2147441519, 2147441159, 2147407799,
    2147403719, 2147388479, 2147372639, 2147365919, 2147364959, 2147364239,
)  # fmt: skip


_FRACTION = 12  # sin(a/d) and exp(a/d) are consistent for every d that divides this


_BATCHES = 12


class NoFiniteFieldValue(NeccError):
    """An expression has no value over the finite field, or no usable point was found."""


class _FieldPoint:
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
        if isinstance(expr, sp.Rational):
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
        if isinstance(exponent, sp.Rational):
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
            if split != expr and is_finite(split):
                return self(split)
        return self._random()  # a symbol, pi, ln, atan, …: nothing algebraic is known about it


def values(
    expressions: Sequence[sp.Expr], points: int, seed: int = 0, prime: int = PRIMES[0]
) -> Residues:
    """Values of `expressions` at random common points of GF(prime), points × len(expressions).

    Raises
    ------
    NoFiniteFieldValue
        When too few points are free of poles.
    """
    rng = random.Random(seed)
    rows: list[Residues] = []
    found = 0
    for _ in range(_BATCHES):
        sample = _FieldPoint(points + 2, prime, rng)
        columns = [sample(sp.sympify(e)) for e in expressions]
        table = np.stack(columns, axis=1) if columns else np.zeros((points + 2, 0), dtype=np.int64)
        rows.append(table[sample.good])
        found += int(sample.good.sum())
        if found >= points:
            return np.concatenate(rows)[:points]
    raise NoFiniteFieldValue(f"{found} of {points} points found")
