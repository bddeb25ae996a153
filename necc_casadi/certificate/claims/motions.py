"""Derivations that no motion is left where V stays constant, as data: what maker and checker read.

A solution that stays in E = {𝒢ᵀ∇V = 0, Rcl∇V = 0} and in a compact set obeys ż = Jcl w, w = ∇V,
and keeps every Casimir constant. Each step adds to what is known of it, and the derivation ends
when w = 0 is (docs/theory.md, motions without loss). With momenta s, H = ½ sᵀA(y)s + U(y), the
velocities are w_s = As, and s = A⁻¹w_s.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from necc_casadi.certificate.claims.fields import Entries

__all__ = ["Follows", "Rule", "Solutions", "Step"]

#: What is proved of solutions from a set: all go to z̄, some do, or they stay.
Follows = Literal["converges", "invariant", "stable"]

#: rate (i): żᵢ is a combination of constants; being bounded, zᵢ is constant and the rate 0.
#: steady (i): wᵢ is constant, since it depends on constant states and on Casimirs alone.
#: level (i, l): wᵢ is constant and ∂H/∂zᵢ tells values of z_l apart, its only state that may move.
#: convex (i, …): w is constant in all controller states that may move, and Hc strictly convex.
#: momentum (j): s_j = Σ (A⁻¹)_jl w_l is a combination of constants.
#: inertia (j, l): s_j = (A⁻¹)_jl w_l is constant, and the factor is a constant other than 0.
#: swing (j, l, k): s_j = (A⁻¹)_jl w_l is constant, ż_k = αw_l, and the factor a function of z_k.
#: placed (i, …): these states are constant, their w vanishes, and only z̄'s values make it vanish.
#: linear (i, …): ∂H/∂zᵢ are linear in the plant's states; of a form in these wᵢ that vanishes the
#: rate, a form in w by ż = Jcl w, vanishes too.
Rule = Literal[
    "rate", "steady", "level", "convex", "momentum", "inertia", "swing", "placed", "linear"
]  # fmt: skip


@dataclass(frozen=True)
class Step:
    """One rule and the states, as indices in z, that it is applied to."""

    rule: Rule
    states: tuple[int, ...]


@dataclass(frozen=True)
class Solutions(Entries):
    """What is proved of solutions from a set, and the steps that it takes, if any."""

    follows: Follows
    motion: tuple[Step, ...] = ()
