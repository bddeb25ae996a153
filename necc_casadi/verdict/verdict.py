"""Verdict: what is known of a target before any training, and which of two promises more."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf
from typing import Final, Literal

import sympy as sp

__all__ = ["ASYMPTOTIC", "STABLE", "Merit", "Reason", "Stability", "Verdict", "assignable"]


#: The first condition that fails, or ``ok`` (docs/contract.md#json).
Reason = Literal[
    "ok",
    "undecided",
    "needs_decreasing_phi",
    "invisible_flat_curvature",
    "invisible_negative_curvature",
    "invisible_gradient",
    "not_an_equilibrium",
]


Stability = Literal["asymptotic", "stable"]


ASYMPTOTIC: Final = "asymptotic"


STABLE: Final = "stable"


def assignable(reason: Reason) -> bool | None:
    """The answer that goes with a reason; None where nothing was decided."""
    return {"ok": True, "undecided": None}.get(reason, False)


@dataclass(frozen=True, order=True)
class Merit:
    """How much is promised at a target: the first difference decides, more is better.

    What is left out of a comparison stands equal on both sides.
    """

    answer: tuple[bool, bool]  # (not refused, assignable)
    asymptotic: bool = False
    visible: int = 0  # minus the number of invisible directions
    flat: bool = False  # refused by no more than a flat direction
    ceiling: float = inf  # of the curvature; inf: none

    @classmethod
    def of(cls, reason: Reason, ceiling: float = inf) -> Merit:
        """The conditions at one ξ*."""
        answer = assignable(reason)
        flat = reason == "invisible_flat_curvature"
        return cls((answer is not False, answer is True), flat=flat, ceiling=ceiling)


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
    reason: Reason
    explanation: str  # plain words that tell an engineer what to do
    lam: tuple[sp.Expr, ...] | None  # (r,) λ with ∇H + Nλ = 0
    xi_star: tuple[sp.Expr, ...] | None  # (nc,) an admissible ξ*; None: any works
    invisible: sp.ImmutableMatrix  # n × k, columns span W = ker Nᵀ in the plant's coordinates
    curvature: sp.ImmutableMatrix | None  # k × k, Wᵀ∇²(H + Σλc)W with W = `invisible`
    a_max: float | None  # sup of λ_min at Φ₁(z*) = 1, W orthonormal; None: no ceiling
    stability: Stability | None  # None: refused, or not decided
    witness: str | None  # "stable": what does not decay; "asymptotic": why no rate is promised

    @property
    def exponential(self) -> bool:
        """Whether the linearisation can be made Hurwitz."""
        return self.stability == ASYMPTOTIC and self.witness is None

    @property
    def merit(self) -> Merit:
        """How much a controller structure reaches: the answer, stability, what it makes visible."""
        answer = (self.assignable is not False, self.assignable is True)
        return Merit(answer, self.stability == ASYMPTOTIC, -self.invisible.cols)
