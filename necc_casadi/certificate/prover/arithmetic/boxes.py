"""Boxes cut into boxes, and matrices of expressions over them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import sympy as sp

from necc_casadi.certificate.prover.arithmetic.intervals import Interval, point, stack
from necc_casadi.certificate.prover.arithmetic.jets import Jet, coordinates, expression_jets

__all__ = ["hull", "matrix_enclosure", "subdivide"]


def subdivide(box: Interval, parts: int) -> Interval:
    """A box (d,) cut into parts^d boxes, (parts^d, d)."""
    d = box.shape[0]
    if d == 0:
        empty = np.zeros((1, 0))
        return Interval(empty, empty)
    edges = [np.linspace(box.lo[i], box.hi[i], parts + 1) for i in range(d)]
    lows = np.meshgrid(*[e[:-1] for e in edges], indexing="ij")
    highs = np.meshgrid(*[e[1:] for e in edges], indexing="ij")
    return Interval(
        np.stack([v.ravel() for v in lows], -1), np.stack([v.ravel() for v in highs], -1)
    )


def hull(parts: Interval, boxes: int) -> Interval:
    """Hulls of boxes that were cut into equally many parts, (boxes, …)."""
    shape = (boxes, -1, *parts.shape[1:])
    return Interval(parts.lo.reshape(shape).min(1), parts.hi.reshape(shape).max(1))


def matrix_enclosure(matrix: sp.MatrixBase, symbols: Sequence[sp.Symbol], Z: Interval) -> Interval:
    """A matrix of expressions over boxes (B, symbols), (B, rows, columns)."""
    if not matrix:
        return point(np.zeros((Z.shape[0], *matrix.shape)))
    variables = dict(zip(symbols, coordinates(Z), strict=True))
    with np.errstate(all="ignore"):
        jets = expression_jets(list(matrix), variables)
    boxes = point(np.zeros(Z.shape[0]))  # gives constant entries their shape
    entries = [boxes + (j.value if isinstance(j, Jet) else j) for j in jets]
    return stack(entries).reshape(Z.shape[0], *matrix.shape)
