"""Exact decisions on symbolic scalars and matrices: zero, sign, rank, definiteness.

Each answer is True (proved), False (refuted) or None (not decided); None is
never turned into a yes. Refutations come from exact values or from Arb balls
that exclude zero, proofs from symbolic algebra.
"""

from __future__ import annotations

import math
import random
from collections.abc import Iterable, Mapping
from functools import lru_cache

import sympy as sp

from necc_casadi.errors import NeccError
from necc_casadi.symbolic.arb import certain_sign, excludes_zero
from necc_casadi.symbolic.constants import vanishes
from necc_casadi.symbolic.expressions import is_finite, split_logarithms

__all__ = ["PROBES", "Undecided", "is_zero", "normal_form", "random_point", "sign"]


PROBES = 3


#: Binary digits of a first look, and of the last one after algebra has failed.
_QUICK, _LONG = 256, 4096


#: Characters of an expression that a message shows.
_SHOWN = 80


class Undecided(NeccError):
    """Whether an expression is zero had to be known, and no proof was found either way."""

    def __init__(self, expr: sp.Expr) -> None:
        text = str(expr)
        super().__init__(text if len(text) <= _SHOWN else text[: _SHOWN - 1] + "…")


def random_point(
    symbols: Iterable[sp.Symbol],
    seed: int = 0,
    box: Mapping[sp.Symbol, tuple[sp.Expr, sp.Expr]] | None = None,
) -> dict[sp.Symbol, sp.Rational]:
    """Rational values, one per symbol: inside `box` where it names the symbol, else in [-2, 2].

    Symbols that are declared positive stay positive.
    Denominators are primes near 1000, so that a generic property holds there unless unlucky.
    """
    rng = random.Random(seed)
    point = {}
    for symbol in sorted(symbols, key=str):
        lowest = sp.Rational(1, 8) if symbol.is_positive else sp.Integer(-2)
        lo, hi = (box or {}).get(symbol, (lowest, sp.Integer(2)))
        lo, hi = sp.Rational(str(sp.N(lo, 17))), sp.Rational(str(sp.N(hi, 17)))
        fraction = sp.Rational(rng.randrange(1, 1009), 1009)
        point[symbol] = sp.Rational(str(sp.N(lo + (hi - lo) * fraction, 8)))
    return point


@lru_cache(maxsize=65536)
def sign(expr: sp.Expr) -> int | None:
    """Sign of a real constant, proved: -1, 0 or 1; None where no proof was found.

    A sign other than 0 is that of an Arb ball without 0; 0 takes exact algebra.
    """
    expr = sp.sympify(expr)
    if expr.is_Rational:
        return int(sp.sign(expr))
    if not expr.is_number or not is_finite(expr):
        return None
    soon = certain_sign(expr, _QUICK)
    if soon is not None:
        return soon
    return 0 if vanishes(expr) or normal_form(expr) == 0 else certain_sign(expr)


@lru_cache(maxsize=65536)
def is_zero(expr: sp.Expr) -> bool | None:
    """Whether `expr` vanishes identically in its symbols."""
    expr = sp.sympify(expr)
    if expr == 0:
        return True
    if not expr.free_symbols:
        value = sign(expr)
        return None if value is None else value == 0
    if _differs(expr, _QUICK):
        return False
    attempts = (sp.expand, normal_form, sp.trigsimp, sp.simplify)
    if any(attempt(expr) == 0 for attempt in attempts):
        return True
    return False if _differs(expr, _LONG) else None


def _differs(expr: sp.Expr, bits: int) -> bool:
    """Whether `expr` has a value that is certainly not 0 at one of a few real points."""
    return any(
        excludes_zero(expr, random_point(expr.free_symbols, seed), bits) is True
        for seed in range(PROBES)
    )


def normal_form(expr: sp.Expr) -> sp.Expr:
    """A numerator of `expr` in which sin² + cos² = 1, exp(a + b) and powers of roots are resolved.

    It is 0 for every rational function of the states, of sines and cosines of their rational
    combinations and of exponentials that vanishes identically, and with roots of such functions
    for most.
    """
    expr = split_logarithms(expr)
    roots = _roots(expr)
    if not roots:
        return _resolved(expr)
    names = dict[sp.Expr, sp.Expr]()
    relations = []
    for base, degree in roots.items():  # the innermost first
        root = sp.Dummy("r")
        inside = base.xreplace(names)
        relations.append((root, degree, sp.fraction(sp.together(inside))))
        names |= {e: root ** (e.exp * degree) for e in expr.atoms(sp.Pow) if e.base == base}
    result = sp.expand(sp.numer(sp.together(expr.xreplace(names))))
    for root, degree, (numerator, denominator) in reversed(relations):
        if result.is_polynomial(root):
            result = sp.expand(sp.prem(result, denominator * root**degree - numerator, root))
    return _resolved(result)


def _roots(expr: sp.Expr) -> dict[sp.Expr, int]:
    """Bases under fractional powers with the common denominator of those, the innermost first."""
    roots = dict[sp.Expr, int]()
    for power in sorted(expr.atoms(sp.Pow), key=lambda power: power.count_ops()):
        base, exponent = power.base, power.exp
        if base.free_symbols and isinstance(exponent, sp.Rational) and not exponent.is_Integer:
            roots[base] = math.lcm(roots.get(base, 1), int(exponent.q))
    return roots


def _resolved(expr: sp.Expr) -> sp.Expr:
    expr = expr.replace(
        lambda e: isinstance(e, (sp.sinh, sp.cosh, sp.tanh)), lambda e: e.rewrite(sp.exp)
    )
    expr = expr.replace(
        lambda e: isinstance(e, sp.tan), lambda e: sp.sin(*e.args) / sp.cos(*e.args)
    )
    expr = expr.replace(sp.acos, lambda a: sp.pi / 2 - sp.asin(a))
    expr = _whole_angles(expr)
    expr = sp.expand_trig(expr) if expr.has(sp.sin, sp.cos) else expr
    expr = sp.expand_power_exp(expr) if expr.has(sp.exp) else expr
    angles = {f.args[0] for f in expr.atoms(sp.sin, sp.cos)}
    pairs = {a: (sp.Dummy("c"), sp.Dummy("s")) for a in angles}
    expr = expr.xreplace(
        {f: pairs[f.args[0]][int(isinstance(f, sp.sin))] for f in expr.atoms(sp.sin, sp.cos)}
    )
    result = sp.expand(sp.numer(sp.together(expr)))
    for cosine, sine in pairs.values():
        if result.has(sine) and result.is_polynomial(sine):
            result = sp.rem(result, sine**2 + cosine**2 - 1, sine)
            result = sp.expand(result)
    return result


def _whole_angles(expr: sp.Expr) -> sp.Expr:
    """`expr` with every symbol scaled so that angles and exponents have integer coefficients."""
    arguments = [f.args[0] for f in expr.atoms(sp.sin, sp.cos, sp.exp)]
    terms = [t for a in arguments for t in sp.Add.make_args(sp.expand(a))]
    factors = [t.as_coeff_Mul()[0] for t in terms]
    scale = math.lcm(*[int(f.q) for f in factors if isinstance(f, sp.Rational)])
    if scale == 1:
        return expr.replace(
            lambda e: isinstance(e, (sp.sin, sp.cos, sp.exp)),
            lambda e: e.func(sp.expand(e.args[0])),
        )
    units = {t.as_coeff_Mul()[1] for t in terms if t.free_symbols}
    scaled = {u: scale * sp.Dummy(real=True) for u in units}
    return expr.replace(
        lambda e: isinstance(e, (sp.sin, sp.cos, sp.exp)),
        lambda e: e.func(sp.expand(sp.expand(e.args[0]).subs(scaled))),
    )
