"""A target structure of a plant: the same motion, written with another energy.

ẋ = f(x) + g(x) u = (J_d − R_d)∇H₀ + G_d ũ,   u = u₀(x) + A(x) ũ              docs/theory.md#methods

What holds a target for (J_d, R_d, G_d, H₀) and ũ holds it for the plant and u.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import sympy as sp

from necc_casadi.model.plant import Plant
from necc_casadi.symbolic.zero import is_zero

__all__ = ["Matching"]


@dataclass(frozen=True, eq=False)
class Matching:
    """A plant ẋ = f + g u as its target structure sees it.

    References
    ----------
    Ortega, van der Schaft, Maschke, Escobar (2002), the matching equation.
    """

    drift: sp.ImmutableMatrix  # f, n × 1
    ports: sp.ImmutableMatrix  # g, n × m
    plant: Plant  # x, J_d, R_d, G_d, H₀
    u0: sp.ImmutableMatrix  # u₀(x), m × 1
    gain: sp.ImmutableMatrix  # A(x), m × columns of G_d
    shaping: tuple[sp.Expr, ...] = ()  # γ(x), where known: (J_d − R_d)∇γ = −G_d

    @cached_property
    def residuals(self) -> tuple[sp.Expr, ...]:
        """What must vanish: f + g u₀ − (J_d − R_d)∇H₀, then g A − G_d."""
        structure = self.plant
        target = (structure.J - structure.R) * structure.grad_H
        drift = self.drift + self.ports * self.u0 - target
        return (*drift, *(self.ports * self.gain - structure.G))

    @property
    def holds(self) -> bool:
        """Whether the matching equations are proved."""
        return all(is_zero(residual) is True for residual in self.residuals)
