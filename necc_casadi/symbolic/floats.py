"""Exact constants in floating point."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager

import mpmath
import numpy as np
import sympy as sp

from necc_casadi.arrays import Vector

__all__ = ["float_matrix", "steady_precision", "to_float", "to_floats"]


_DIGITS = 20  # more than a double holds, so that the last of its digits is right


@contextmanager
def steady_precision() -> Iterator[None]:
    """Within this, sympy may give up on a number of any size.

    Where it asks mpmath for a precision beyond all floats, mpmath raises and keeps that precision:
    every number that is evaluated afterwards would fail.
    """
    before = mpmath.mp.prec
    try:
        yield
    finally:
        mpmath.mp.prec = before


@steady_precision()
def to_float(value: sp.Expr) -> float:
    """A real constant, rounded once."""
    return float(sp.N(value, _DIGITS))


def to_floats(values: Iterable[sp.Expr]) -> Vector:
    """Real constants as one vector."""
    return np.array([to_float(value) for value in values], dtype=float)


def float_matrix(matrix: sp.MatrixBase) -> Vector:
    """A constant matrix, rows × columns; NaN where an entry is not real or not finite."""
    result = np.zeros(matrix.shape)
    for (i, j), entry in matrix.todok().items():
        value = sp.N(entry, _DIGITS)
        result[i, j] = float(value) if value.is_real and value.is_finite else np.nan
    return result
