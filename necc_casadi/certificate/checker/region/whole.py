"""The whole space: one critical point of V, in a box that holds them all, and V radially unbounded.

V(y) = ½yᵀQy + lᵀy + b(y), Q ≻ 0, |∂b| ≤ β: a critical point has Qy = −l − ∇b(y), and is enclosed
by solving that system in balls.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise, product

import numpy as np
import sympy as sp
from flint import arb, arb_mat

from necc_casadi.certificate.checker.arithmetic.balls import Box, ball, by_bisection, ends, evaluate
from necc_casadi.certificate.checker.arithmetic.definite import positive
from necc_casadi.certificate.checker.arithmetic.networks import Net
from necc_casadi.certificate.checker.arithmetic.potential import Energy
from necc_casadi.certificate.checker.region.floor import evaluated, is_periodic
from necc_casadi.certificate.checker.region.reduced import Cover, Reduced

__all__ = ["critical_box", "is_unique", "repeats_positively"]

#: Half a period, a little more than π; how often a box of angles, and a cell, may be halved.
_HALF_PERIOD, _ANGLES, _DEPTH = 3.15, 14, 16


def critical_box(energy: Energy) -> Box | None:
    """A box of the active states that holds every critical point of V; None where none is proved.

    Where there is one, V is radially unbounded in these states.
    """
    model, d = energy.model, energy.d
    y, form = energy.variables, model.form
    of_k, of_hc = energy.k.quadratic, energy.hc.quadratic
    if form["phi"] is not None or form["betas"] or of_k is None or of_hc is None:
        return None
    at_rest = {s: 0 for i, s in enumerate(model.z) if i not in energy.active}
    slopes = sp.Matrix([[sp.diff(c, v) for v in y] for c in model.casimirs])
    if slopes.free_symbols:
        return None
    low, rest = _by_degree(model.H.subs(at_rest), y)
    bounds = _slopes_of_rest(rest, y)
    if bounds is None:
        return None
    zero = dict.fromkeys(y, 0)
    N = _numbers(slopes)
    E = arb_mat([[int(j == d - model.nc + i) for j in range(d)] for i in range(model.nc)])
    kappa_k, kappa_h = energy.k.quadratic_curvature(), energy.hc.quadratic_curvature()
    Q = _numbers(sp.hessian(low, y)) + N.transpose() * kappa_k * N + E.transpose() * kappa_h * E
    if not positive(Q, 0):
        return None
    offset = _numbers(sp.Matrix([[c.subs(zero)] for c in model.casimirs]))
    centres = [arb_mat([[v] for v in centre]) for _, centre in (of_k, of_hc)]
    linear = _numbers(sp.Matrix([[sp.diff(low, v).subs(zero)] for v in y]))
    linear = linear + N.transpose() * kappa_k * (offset - centres[0])
    linear = linear - E.transpose() * kappa_h * centres[1]
    swing = _both_signs(N.transpose(), _steepest(energy.k))
    swing = swing + _both_signs(E.transpose(), _steepest(energy.hc))
    swing = swing + arb_mat([[b * ball(-1.0, 1.0)] for b in bounds])
    try:
        solved = Q.solve(-linear - swing)
    except ZeroDivisionError:
        return None
    box = tuple(ends(row[0]) for row in solved.tolist())
    return box if np.isfinite(np.array(box)).all() else None


def is_unique(reduced: Reduced, box: Box, core: Box) -> bool:
    """Whether w has exactly one critical point in a box of s that holds all of them."""
    inside = all(lo < hi for lo, hi in core)

    def settled(cell: Box) -> bool:
        if all(a <= lo and hi <= b for (lo, hi), (a, b) in zip(cell, core, strict=True)):
            return True
        cover: Cover | None = reduced.cover(cell)
        return cover is not None and cover.regular

    def bent(cell: Box) -> bool:
        cover = reduced.cover(cell)
        return cover is not None and cover.convex

    return (
        inside
        and by_bisection(core, bent, _DEPTH)
        and all(by_bisection(piece, settled, _DEPTH) for piece in _around(box, core))
    )


def _around(box: Box, core: Box) -> list[Box]:
    """Boxes that cover the box outside of the core."""
    pieces, left = [], list(box)
    for k, ((lo, hi), (a, b)) in enumerate(zip(box, core, strict=True)):
        for side in ((lo, min(a, hi)), (max(b, lo), hi)):
            if side[0] < side[1]:
                pieces.append((*left[:k], side, *left[k + 1 :]))
        left[k] = (max(lo, a), min(hi, b))
    return pieces


def repeats_positively(matrix: sp.Matrix) -> bool:
    """Whether a matrix that repeats in each of its symbols is ≻ 0 for all of their values."""
    symbols = sorted(matrix.free_symbols, key=str)
    if not all(is_periodic(e, v) for v in symbols for e in matrix if e.has(v)):
        return False

    def test(box: Box) -> bool:
        values = {v: ball(*side) for v, side in zip(symbols, box, strict=True)}
        return positive(evaluated(matrix, values), 0)

    return by_bisection(tuple((-_HALF_PERIOD, _HALF_PERIOD) for _ in symbols), test, _ANGLES)


def _by_degree(energy: sp.Expr, y: Sequence[sp.Symbol]) -> tuple[sp.Expr, sp.Expr]:
    """Terms up to the second degree, and what is left."""
    terms = sp.Add.make_args(sp.expand(energy))
    low = [t for t in terms if t.is_polynomial(*y) and sp.Poly(t, *y).total_degree() <= 2]
    return sp.Add(*low), sp.Add(*[t for t in terms if t not in low])


def _slopes_of_rest(rest: sp.Expr, y: Sequence[sp.Symbol]) -> list[arb] | None:
    """|∂rest/∂yᵢ| is at most this, for all states."""
    result = []
    for v in y:
        slope = sp.diff(rest, v)
        used = sorted(slope.free_symbols, key=str)
        if not all(is_periodic(slope, s) for s in used):
            return None
        most, steps = arb(0), [_HALF_PERIOD * (k / 16 - 1) for k in range(33)]
        for cell in product(pairwise(steps), repeat=len(used)):
            value = evaluate(slope, {s: ball(*side) for s, side in zip(used, cell, strict=True)})
            if not value.is_finite():
                return None
            most = most.max(value.abs_upper())
        result.append(most)
    return result


def _steepest(net: Net) -> list[arb]:
    """|∂f/∂vⱼ| of the layers is at most this for every v."""
    reach = net.layers[-1][0]
    bound = arb_mat([[abs(v) for v in row] for row in reach.tolist()])
    for W, _ in reversed(net.layers[:-1]):
        bound = bound * arb_mat([[abs(v) for v in row] for row in W.tolist()])
    return [v.upper() for v in bound.tolist()[0]]


def _both_signs(A: arb_mat, bounds: Sequence[arb]) -> arb_mat:
    return A * arb_mat([[b * ball(-1.0, 1.0)] for b in bounds])


def _numbers(matrix: sp.Matrix) -> arb_mat:
    return arb_mat([[evaluate(sp.sympify(e), {}) for e in row] for row in matrix.tolist()])
