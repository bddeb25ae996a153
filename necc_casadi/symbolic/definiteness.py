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
from necc_casadi.symbolic.arb import ball
from necc_casadi.symbolic.floats import float_matrix
from necc_casadi.symbolic.linear_algebra import kernel
from necc_casadi.symbolic.semidefinite import blocks, is_positive_semidefinite
from necc_casadi.symbolic.zero import sign

__all__ = ["UNDECIDED", "Definiteness", "definiteness", "rational"]


UNDECIDED: Final = "undecided"


#: ``positive`` (definite), ``flat`` (⪰ 0 and singular), ``negative`` (indefinite or worse).
Definiteness = Literal["positive", "flat", "negative", "undecided"]


_CLOSE = 1e-9  # an eigenvalue this small beside the largest may be zero


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
    numeric = float_matrix(block)
    if not np.all(np.isfinite(numeric)):
        return UNDECIDED, None
    eigenvalues, vectors = np.linalg.eigh(numeric)
    close = _CLOSE * float(np.abs(eigenvalues).max())
    if eigenvalues[0] < -close:
        vector = _rational_vector(vectors[:, 0])
        if sign((vector.T * block * vector)[0]) == -1:
            return "negative", vector
    if eigenvalues[0] <= close:
        return _semidefinite(block)
    return UNDECIDED, None


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
    previous, flint.ctx.prec = flint.ctx.prec, 256
    try:
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
    finally:
        flint.ctx.prec = previous
    return True


def _semidefinite(block: sp.Matrix) -> tuple[Definiteness, sp.Matrix | None]:
    """Exact symmetric elimination of a block whose least eigenvalue is close to zero."""
    null = kernel(block)
    if null.cols == 0:
        return UNDECIDED, None
    verdict = is_positive_semidefinite(block)
    return ("flat", null[:, 0]) if verdict is True else (UNDECIDED, None)
