"""Definiteness of constant matrices, exactly.

Floating point proposes a direction; exact arithmetic or Arb balls decide.
"""

from __future__ import annotations

from fractions import Fraction
from typing import Final, Literal

import flint
import numpy as np
import sympy as sp

from necc_casadi.arrays import Vector
from necc_casadi.symbolic.arb import ball, certain_sign
from necc_casadi.symbolic.floats import float_matrix
from necc_casadi.symbolic.linear_algebra import tidy
from necc_casadi.symbolic.semidefinite import blocks
from necc_casadi.symbolic.zero import sign

__all__ = ["UNDECIDED", "Definiteness", "definiteness", "rational"]


UNDECIDED: Final = "undecided"


_BITS = 256


#: ``positive`` (definite), ``flat`` (⪰ 0 and singular), ``negative`` (indefinite or worse).
Definiteness = Literal["positive", "flat", "negative", "undecided"]


_WORST_FIRST: tuple[Definiteness, ...] = ("negative", UNDECIDED, "flat", "positive")


def definiteness(matrix: sp.Matrix) -> tuple[Definiteness, sp.ImmutableMatrix | None]:
    """Kind of a constant symmetric matrix Q, and a direction that shows it.

    For ``flat`` that is a vector of the kernel, for ``negative`` a w with wᵀQw < 0.
    """
    results: list[tuple[Definiteness, sp.ImmutableMatrix | None]] = []
    for block in blocks(matrix):
        kind, part = _block_definiteness(matrix.extract(block, block))
        vector = None
        if part is not None:
            full = sp.zeros(matrix.rows, 1)
            for k, i in enumerate(block):
                full[i] = part[k]
            vector = sp.ImmutableMatrix(full)
        results.append((kind, vector))
    return min(
        results, key=lambda result: _WORST_FIRST.index(result[0]), default=("positive", None)
    )


def _block_definiteness(block: sp.Matrix) -> tuple[Definiteness, sp.Matrix | None]:
    for i in range(block.rows):
        if sign(block[i, i]) == -1:
            return "negative", sp.Matrix([int(k == i) for k in range(block.rows)])
    if _balls_positive(block):
        return "positive", None
    proposed = _proposed_negative(block)
    return _eliminated(block) if proposed is None else ("negative", proposed)


def _eliminated(block: sp.Matrix) -> tuple[Definiteness, sp.Matrix | None]:
    """Symmetric elimination with exact signs: Q = L D Lᵀ, and the direction of the worst pivot.

    `basis` holds, as columns, the vectors in which the part of Q that remains is written.
    """
    remaining, basis = sp.Matrix(block), sp.eye(block.rows)
    while remaining.rows:
        signs = [sign(remaining[i, i]) for i in range(remaining.rows)]
        if -1 in signs:
            return "negative", basis[:, signs.index(-1)]
        if None in signs:
            return UNDECIDED, None
        if 1 not in signs:
            return _of_zero_diagonal(remaining, basis)
        k = signs.index(1)
        rest = [i for i in range(remaining.rows) if i != k]
        row = remaining.extract([k], rest) / remaining[k, k]
        schur = remaining.extract(rest, rest) - row.T * remaining.extract([k], rest)
        basis = basis.extract(list(range(block.rows)), rest) - basis[:, k] * row
        remaining = schur.applyfunc(tidy)
    return "positive", None


def _of_zero_diagonal(
    remaining: sp.Matrix, basis: sp.Matrix
) -> tuple[Definiteness, sp.Matrix | None]:
    """0 with 0 around it is flat; with b ≠ 0 beside it, (1, ∓1) has the curvature ∓2b."""
    zeros = True
    for i in range(remaining.rows):
        for j in range(i):
            kind = sign(remaining[i, j])
            if kind in (1, -1):
                return "negative", basis[:, i] - kind * basis[:, j]
            zeros = zeros and kind == 0
    return ("flat", basis[:, 0]) if zeros else (UNDECIDED, None)


def _proposed_negative(block: sp.Matrix) -> sp.Matrix | None:
    """A vector along which balls find the block negative; floating point proposes it."""
    numeric = float_matrix(block)
    if not np.all(np.isfinite(numeric)):
        return None
    # by congruence with powers of two: units of the coordinates do not matter
    size = np.sqrt(np.abs(np.diag(numeric)))
    scale = np.exp2(-np.round(np.log2(np.where(size > 0, size, 1.0))))
    vector = scale * np.linalg.eigh(scale[:, None] * numeric * scale)[1][:, 0]
    exact = sp.Matrix([sp.Rational(float(v)) for v in vector / np.abs(vector).max()])
    simple = _rational_vector(vector)
    for candidate in (simple, exact):
        if certain_sign((candidate.T * block * candidate)[0], _BITS) == -1:
            return candidate
    return None


def _rational_vector(vector: Vector) -> sp.Matrix:
    """A nearby rational vector, as simple as 1 % of its largest entry allows."""
    scaled = vector / vector[np.argmax(np.abs(vector))]
    return sp.Matrix([rational(float(v), 1000) for v in scaled])


def rational(value: float, denominator: int) -> sp.Rational:
    """The nearest fraction with at most this denominator."""
    fraction = Fraction(float(value)).limit_denominator(denominator)
    return sp.Rational(fraction.numerator, fraction.denominator)


def _balls_positive(block: sp.Matrix) -> bool:
    """Whether an Arb LDLᵀ has certainly positive pivots."""
    with flint.ctx.workprec(_BITS):
        known: dict[sp.Expr, flint.arb] = {}
        rows = [[ball(e, known) for e in row] for row in block.tolist()]
        for i in range(len(rows)):
            if not rows[i][i] > 0:
                return False
            for j in range(i + 1, len(rows)):
                if not rows[j][i].is_zero():
                    factor = rows[j][i] / rows[i][i]
                    for k in range(i, len(rows)):
                        rows[j][k] = rows[j][k] - factor * rows[i][k]
    return True
