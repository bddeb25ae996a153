"""Verdict: what is known of a target before any training."""

from __future__ import annotations

from dataclasses import dataclass

import sympy as sp

__all__ = ["Verdict"]


@dataclass(frozen=True, eq=False)
class Verdict:
    """Whether a target is assignable, why, and what the structure can reach there.

    Examples
    --------
    >>> from necc_casadi import find_casimirs, judge, load_model, parse_target
    >>> loop = load_model("pendulum.py").loop
    >>> verdict = judge(loop, find_casimirs(loop), parse_target(loop.plant, "pi"))
    >>> verdict.assignable, verdict.stability, verdict.lam
    (True, 'asymptotic', (0,))
    """

    assignable: bool | None  # None: undecided
    reason: str  # a word of docs/contract.md#json: ok, invisible_gradient, …
    explanation: str  # plain words that tell an engineer what to do
    lam: tuple[sp.Expr, ...] | None  # (r,) λ with ∇H + Nλ = 0
    xi_star: tuple[sp.Expr, ...] | None  # (nc,) an admissible ξ*; None: any works
    invisible: sp.ImmutableMatrix  # n × k, columns span W = ker Nᵀ in the plant's coordinates
    curvature: sp.ImmutableMatrix | None  # k × k, Wᵀ∇²(H + Σλc)W with W = `invisible`
    a_max: float | None  # sup of λ_min at Φ₁(z*) = 1, W orthonormal; None: no ceiling
    stability: str | None  # asymptotic | stable | None (refused, or not decided)
    witness: str | None  # for "stable": what does not decay
