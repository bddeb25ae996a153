"""The words from which closed forms of Casimirs are composed."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import combinations_with_replacement, product

import sympy as sp

from necc_casadi.symbolic.expressions import complexity
from necc_casadi.symbolic.primitive import primitive

__all__ = [
    "MOST_WORDS",
    "angles",
    "occurring",
    "products",
    "rotation_angles",
    "times",
    "trig_products",
    "unique",
]


MOST_WORDS = 1100


def unique(words: Iterable[sp.Expr]) -> list[sp.Expr]:
    """Words that contain a state, each once."""
    return [w for w in dict.fromkeys(words) if w.free_symbols]


def products(words: Sequence[sp.Expr], degrees: Sequence[int]) -> list[sp.Expr] | None:
    """Products of as many words as each of `degrees` says; None where there are too many."""
    if len(words) ** max(degrees) > 40 * MOST_WORDS:
        return None
    return [sp.Mul(*c) for d in degrees for c in combinations_with_replacement(words, d)]


def times(left: Sequence[sp.Expr], right: Sequence[sp.Expr]) -> list[sp.Expr]:
    """Every product of a word on the left and one on the right."""
    return [a * b for a in left for b in right]


def angles(functions: Sequence[sp.Expr]) -> list[sp.Expr]:
    """Arguments of sines and cosines, each once."""
    return list(dict.fromkeys(f.args[0] for f in functions if isinstance(f, (sp.sin, sp.cos))))


def trig_products(angles: Sequence[sp.Expr]) -> list[sp.Expr]:
    """Products with at most one sine or cosine of each angle, fewest factors first."""
    if not angles or 3 ** len(angles) > MOST_WORDS:
        return []
    choices = [(sp.Integer(1), sp.cos(a), sp.sin(a)) for a in angles]
    words = [sp.Mul(*choice) for choice in product(*choices)]
    return sorted((w for w in words if w != 1), key=lambda w: (len(sp.Mul.make_args(w)), str(w)))


def rotation_angles(M: sp.MatrixBase, z: Sequence[sp.Symbol]) -> list[sp.Expr]:
    """atan(y/x) for the pairs (x, y) that a column of M rotates: ẋ ~ −y, ẏ ~ x, each affine.

    Such as the fluxes of a machine in the frame of its rotor.
    """
    found: list[sp.Expr] = []
    for k in range(M.cols):
        turning = {i: M[i, k] for i in range(M.rows) if M[i, k].free_symbols}
        for i, along in turning.items():
            for j, across in turning.items():
                slopes = sp.diff(along, z[j]), sp.diff(across, z[i])
                alone = along.free_symbols == {z[j]} and across.free_symbols == {z[i]}
                if i < j and alone and slopes[0].is_number and slopes[1].is_number:
                    ratio = (along / slopes[0]) / (across / slopes[1])
                    if (slopes[0] * slopes[1]).is_negative:
                        found += [sp.atan(ratio), sp.atan(1 / ratio)]
    return unique(found)


def occurring(entries: Iterable[sp.Expr], support: Sequence[sp.Symbol]) -> list[sp.Expr]:
    """Parts of entries that contain no state but those in `support`."""
    allowed, found = set(support), {}
    for entry in dict.fromkeys(entries):
        for f in _parts(sp.sympify(entry)):
            if f.free_symbols and f.free_symbols <= allowed and not f.is_Symbol:
                found[f] = complexity(f)
    return sorted(found, key=lambda f: (found[f], str(f)))


def _parts(entry: sp.Expr) -> Iterable[sp.Expr]:
    for f in entry.atoms(sp.Function):
        yield f
        if isinstance(f, (sp.sin, sp.cos, sp.tan)):
            yield from (sp.cos(f.args[0]), sp.sin(f.args[0]))
        if isinstance(f, sp.exp):
            yield 1 / f
    numerator, denominator = sp.fraction(sp.together(entry))
    for part in (numerator, denominator):
        for factor in sp.Mul.make_args(sp.factor_terms(part)):
            base, exponent = factor.as_base_exp()
            if not base.free_symbols or base.is_Function:
                continue
            yield sp.log(base)
            yield base
            if part is denominator:
                yield from (1 / base, base**-2)
            if exponent.is_Rational and not exponent.is_Integer:
                yield from (base ** (exponent + k) for k in (-1, 0, 1))
    if len(entry.free_symbols) == 1:
        (s,) = entry.free_symbols
        antiderivative = primitive(entry, s)
        if antiderivative is not None:
            yield antiderivative.as_independent(s, as_Add=True)[1].as_independent(s, as_Add=False)[
                1
            ]
