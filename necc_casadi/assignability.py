"""The verdict at a target, before any training (exact)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import sympy as sp

from necc_casadi.casimirs import Casimirs
from necc_casadi.loop import ClosedLoop

__all__ = ["Verdict", "judge"]


@dataclass(frozen=True, eq=False)
class Verdict:
    """Whether some V with Φ₁ > 0 has a positive definite Hessian at x*, and why."""

    assignable: bool | None  # None: undecided
    reason: str
    explanation: str
    lam: tuple[sp.Expr, ...] | None  # (r,)
    xi_star: tuple[sp.Expr, ...] | None  # None: any ξ* works
    invisible: sp.ImmutableMatrix  # n × k
    curvature: sp.ImmutableMatrix | None  # k × k
    a_max: float | None  # None: no ceiling
    stability: str | None
    witness: str | None


def judge(loop: ClosedLoop, casimirs: Casimirs, x_star: Mapping[sp.Symbol, sp.Expr]) -> Verdict:
    """Placeholder of the verdict for the scalar case."""
    k = len(casimirs.functions)
    return Verdict(True, "ok", "", (sp.Integer(0),) * k, None,
                   sp.ImmutableMatrix(sp.zeros(loop.plant.n, 0)), None, None, "asymptotic", None)
