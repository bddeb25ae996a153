"""Momenta, judged anew: states that enter H as ½ sᵀA(y)s and no Casimir, and how far they go.

With Φ₁ ≥ δ, V(y, s) ≥ V(y, 0) + ½ δ sᵀA(y)s.
"""

from __future__ import annotations

from collections.abc import Sequence

import sympy as sp
from flint import arb, arb_mat

from necc_casadi.certificate.checker.arithmetic.balls import Box, ball, by_bisection, ends, evaluate
from necc_casadi.certificate.checker.arithmetic.definite import positive
from necc_casadi.certificate.checker.model import StoredDesign
from necc_casadi.symbolic.zero import is_zero

__all__ = ["are_momenta", "momentum_inside"]


#: How often a box may be halved before a test on it counts as failed.
_DEPTH = 14


def are_momenta(model: StoredDesign, resting: Sequence[int]) -> bool:
    """H = ½ sᵀA(y)s + U(y) in the resting plant states s, which no Casimir contains."""
    s = [model.z[i] for i in resting]
    zero = dict.fromkeys(s, 0)
    if any(i >= model.n for i in resting) or any(c.has(*s) for c in model.casimirs if s):
        return False
    A = sp.hessian(model.H, s) if s else sp.zeros(0)
    kinetic = (sp.Matrix([s]) * A * sp.Matrix(s))[0] / 2 if s else sp.Integer(0)
    flat = all(is_zero(sp.diff(a, v)) is True for a in A for v in s)
    return flat and is_zero(model.H - model.H.subs(zero) - kinetic) is True


def momentum_inside(
    model: StoredDesign,
    i: int,
    resting: Sequence[int],
    active: Sequence[int],
    level: float,
    bottom: arb,
) -> bool:
    """½ δ sᵀA(y)s > c − V(z̄) wherever the resting state i leaves the domain, and A ≻ 0."""
    bounds = model.bounds
    lo, hi = bounds[i]
    reach = (-lo).min(hi)
    if not reach > 0:
        return False
    needed, k = 2 * (level - bottom) / (model.delta * reach * reach), resting.index(i)
    A = sp.hessian(model.H, [model.z[j] for j in resting])
    cube = tuple((ends(bounds[j][0])[0], ends(bounds[j][1])[1]) for j in active)
    variables = [model.z[j] for j in active]

    def stiff(box: Box) -> bool:
        values = {v: ball(*b) for v, b in zip(variables, box, strict=True)}
        matrix = arb_mat([[evaluate(e, values) for e in row] for row in A.tolist()])
        matrix[k, k] = matrix[k, k] - needed
        return positive(matrix, 0)

    return by_bisection(cube, stiff, _DEPTH, [A.has(v) for v in variables])
