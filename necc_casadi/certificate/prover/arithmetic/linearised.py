"""Matrices of expressions to the first order in their variables, over boxes.

    F(m + δ) = F(m) + Σ Fₖ(m) δₖ + ½ δᵀF″δ,   F″ enclosed over all m + δ,

with δ = hε + d: numbers |εₖ| ≤ 1 that are the box, and a drift d from there.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import reduce

import numpy as np
import sympy as sp

from necc_casadi.arrays import Vector
from necc_casadi.certificate.prover.arithmetic.affine import Affine
from necc_casadi.certificate.prover.arithmetic.boxes import hull
from necc_casadi.certificate.prover.arithmetic.intervals import UNIT, Interval, point
from necc_casadi.certificate.prover.arithmetic.jets import Jet, coordinates, expression_jets

__all__ = ["linearised"]


#: More than the relative error of the few hundred roundings in an error term.
_ROUND = 1 + 1e-12
#: Pieces of a box on which F″ is enclosed, along one or two variables of denominators.
_PIECES = {1: 8, 2: 3}


def linearised(
    matrix: sp.MatrixBase,
    symbols: Sequence[sp.Symbol],
    Z: Interval,
    drift: Interval,
    share: float = 1.0,
) -> tuple[Affine, Vector]:
    """A matrix over boxes Z (B, d) and wherever drifts (B, d) lead from there: F(m) + Σ Fₖ(m)hₖεₖ.

    Besides the rest of each entry (B, r, c), of which a mean of values has no more. `share` is how
    much of a drift that may be 0 the mean of the places has at most.
    """
    boxes, d = Z.shape
    rows, columns = matrix.shape
    center, rest = np.zeros((boxes, rows, columns)), np.zeros((boxes, rows, columns))
    parts, error = np.zeros((boxes, d, rows, columns)), np.zeros((boxes, rows, columns))
    reached, half, mean = Z + drift, Z.rad, drift * share
    middle = Z.mid + mean.mid
    reach = (reached - middle).magnitude
    over = (Z + mean - middle).magnitude
    moved = np.maximum(over * _ROUND - half, 0.0) + 8 * UNIT * (np.abs(middle) + reach)
    entries = list(dict.fromkeys(matrix))
    firsts = _jets(entries, symbols, point(middle))
    bends = _bends(entries, symbols, reached)
    known = dict(zip(entries, zip(firsts, *bends, strict=True), strict=True))
    for i in range(rows):
        for j in range(columns):
            first, whole, bend = known[matrix[i, j]]
            if not isinstance(first, Jet):
                center[:, i, j], error[:, i, j] = first.mid, first.rad
                continue
            slope = first.grad
            second = (bend * reach[:, None] * reach[:, :, None]).sum((-1, -2)) / 2
            left = ((slope.magnitude * moved).sum(-1) + second) * _ROUND
            straight = ~(left > whole.rad / 2)
            center[:, i, j] = np.where(straight, first.value.mid, whole.mid)
            parts[:, :, i, j] = np.where(straight[:, None], slope.mid * half, 0.0)
            apart = slope.rad + 2 * UNIT * np.abs(slope.mid)
            error[:, i, j] = (first.value.rad + (apart * half).sum(-1)) * _ROUND
            rest[:, i, j] = np.where(straight, left, whole.rad)
    return Affine(center, parts, error), rest


def _jets(
    entries: list[sp.Expr], symbols: Sequence[sp.Symbol], Y: Interval
) -> list[Jet | Interval]:
    return expression_jets(entries, dict(zip(symbols, coordinates(Y), strict=True)))


def _bends(
    entries: list[sp.Expr], symbols: Sequence[sp.Symbol], Y: Interval
) -> tuple[list[Interval], list[Vector]]:
    """Each entry over boxes (B, d), and upper bounds of |F″| there, (B, d, d)."""
    boxes, d = Y.shape
    below = _denominators(entries)
    places = [k for k, s in enumerate(symbols) if s in below]
    lo, hi = Y.lo[:, None], Y.hi[:, None]
    for k in places if len(places) in _PIECES else ():
        count = _PIECES[len(places)]
        ends = Y.lo[:, k, None] + (Y.hi - Y.lo)[:, k, None] * (np.arange(count + 1) / count)
        ends[:, -1] = Y.hi[:, k]
        lo, hi = np.repeat(lo, count, 1), np.repeat(hi, count, 1)
        times = lo.shape[1] // count
        lo[:, :, k], hi[:, :, k] = np.tile(ends[:, :-1], times), np.tile(ends[:, 1:], times)
    jets = _jets(entries, symbols, Interval(lo.reshape(-1, d), hi.reshape(-1, d)))
    values = [hull(j.value, boxes) if isinstance(j, Jet) else j for j in jets]
    bends = [
        j.hess.magnitude.reshape(boxes, -1, d, d).max(1) if isinstance(j, Jet) else np.zeros(0)
        for j in jets
    ]
    return values, bends


def _denominators(entries: Iterable[sp.Expr]) -> set[sp.Basic]:
    """Symbols that something is divided by."""
    powers = (p for e in entries for p in e.atoms(sp.Pow) if p.exp.is_negative)
    return reduce(lambda a, b: a | b, (p.base.free_symbols for p in powers), set())
