"""Definiteness of constant matrices, exactly."""

from __future__ import annotations

from fractions import Fraction

import flint
import numpy as np
import sympy as sp

from necc_casadi.arrays import Vector
from necc_casadi.symbolic.arb import ball
from necc_casadi.symbolic.linear_algebra import kernel
from necc_casadi.symbolic.semidefinite import blocks, is_positive_semidefinite
from necc_casadi.symbolic.zero import sign

__all__ = ["definiteness", "rational", "to_float"]


def definiteness(matrix: sp.Matrix) -> tuple[str, sp.ImmutableMatrix | None]:
    """Kind of a constant symmetric matrix, and a direction that shows it.

    ``positive`` (definite), ``flat`` (⪰ 0, singular; a kernel vector), ``negative`` (indefinite
    or worse; a vector w with wᵀQw < 0) or ``undecided``.
    """
    results: list[tuple[str, sp.ImmutableMatrix | None]] = []
    for block in blocks(matrix):
        kind, part = _block_definiteness(matrix.extract(block, block))
        vector = None
        if part is not None:
            full = sp.zeros(matrix.rows, 1)
            for k, i in enumerate(block):
                full[i] = part[k]
            vector = sp.ImmutableMatrix(full)
        results.append((kind, vector))
    for kind in ("negative", "undecided", "flat"):
        for result in results:
            if result[0] == kind:
                return result
    return "positive", None


def _block_definiteness(block: sp.Matrix) -> tuple[str, sp.Matrix | None]:
    for i in range(block.rows):
        if sign(block[i, i]) == -1:
            return "negative", sp.Matrix([int(k == i) for k in range(block.rows)])
    if _balls_positive(block):
        return "positive", None
    numeric = to_float(block)
    if not np.all(np.isfinite(numeric)):
        return "undecided", None
    eigenvalues, vectors = np.linalg.eigh(numeric)
    scale = max(1.0, float(np.abs(eigenvalues).max()))
    if eigenvalues[0] < -1e-9 * scale:
        vector = _rational_vector(vectors[:, 0])
        if sign((vector.T * block * vector)[0]) == -1:
            return "negative", vector
    if eigenvalues[0] < 1e-9 * scale:
        return _semidefinite(block)
    return "undecided", None


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


def _semidefinite(block: sp.Matrix) -> tuple[str, sp.Matrix | None]:
    """Exact symmetric elimination of a block whose least eigenvalue is close to zero."""
    null = kernel(block)
    if null.cols == 0:
        return "undecided", None
    verdict = is_positive_semidefinite(block)
    return ("flat", null[:, 0]) if verdict is True else ("undecided", None)


def to_float(matrix: sp.MatrixBase) -> Vector:
    """A constant matrix in floating point; NaN where an entry is not finite."""
    result = np.zeros(matrix.shape)
    for (i, j), entry in matrix.todok().items():
        value = sp.N(entry, 17)
        result[i, j] = float(value) if value.is_real and value.is_finite else np.nan
    return result
