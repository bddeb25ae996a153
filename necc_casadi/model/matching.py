"""A target structure of a plant: the same motion, written with another energy.

ẋ = f(x) + g(x) u = (J_d − R_d)∇H₀ + G_d ũ,   u = u₀(x) + B(x) ũ              docs/theory.md#methods

What holds a target for (J_d, R_d, G_d, H₀) and ũ holds it for the plant and u. The equations stand
in :class:`Preliminary`.
"""

from __future__ import annotations

from dataclasses import dataclass

import sympy as sp

from necc_casadi.model.control_affine import Preliminary
from necc_casadi.model.plant import Plant

__all__ = ["Matching"]


@dataclass(frozen=True, eq=False)
class Matching:
    """A plant ẋ = f + g u as its target structure sees it."""

    ahead: Preliminary  # f, g, u₀, B
    plant: Plant  # x, J_d, R_d, G_d, H₀
    shaping: tuple[sp.Expr, ...] = ()  # γ(x), where known: (J_d − R_d)∇γ = −G_d

    @property
    def u0(self) -> sp.ImmutableMatrix:
        """u₀(x), m × 1."""
        return self.ahead.u0

    @property
    def gain(self) -> sp.ImmutableMatrix:
        """B(x), m × columns of G_d."""
        return self.ahead.gain

    @property
    def holds(self) -> bool:
        """Whether the matching equations are proved."""
        return self.ahead.matches(self.plant.flow, self.plant.G)
