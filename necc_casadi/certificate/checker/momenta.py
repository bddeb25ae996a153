"""Momenta, judged anew: states that enter H as ½ sᵀA(y)s and no Casimir.

With Φ₁ ≥ δ, V(y, s) ≥ V(y, 0) + ½ δ sᵀA(y)s.
"""

from __future__ import annotations

from collections.abc import Sequence

import sympy as sp

from necc_casadi.certificate.checker.model import StoredDesign
from necc_casadi.symbolic.zero import is_zero

__all__ = ["are_momenta"]


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
