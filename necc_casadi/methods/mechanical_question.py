"""A row of a mechanical plant that no input enters, at a target."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import sympy as sp

from necc_casadi.methods.linear_target import Weigh
from necc_casadi.methods.mechanical_model import FreeRow, MechanicalModel, short
from necc_casadi.methods.mechanical_response import MechanicalResponse, mechanical_response
from necc_casadi.symbolic.derivatives import value_at
from necc_casadi.symbolic.floats import to_float
from necc_casadi.symbolic.quadrature import quadrature
from necc_casadi.symbolic.zero import sign

__all__ = ["Question", "Shape", "near"]


@dataclass(frozen=True, eq=False)
class Question:
    """A row that no input enters, at a target."""

    model: MechanicalModel
    row: FreeRow
    x_star: Mapping[sp.Symbol, sp.Expr]
    weigh: Weigh

    @cached_property
    def response(self) -> MechanicalResponse | None:
        """What numbers of a structure cost; None where that is not known."""
        return mechanical_response(self.model, self.row, self.x_star, self.weigh)

    @property
    def q_r(self) -> sp.Symbol:
        """The coordinate of the row."""
        return self.model.q[self.row.r]

    @property
    def others(self) -> tuple[int, ...]:
        """Places of the coordinates whose accelerations are inputs."""
        return tuple(a for a in range(self.model.k) if a != self.row.r)

    def at_target(self, expr: sp.Expr) -> sp.Expr:
        """Its value at x*."""
        return value_at(expr, self.x_star)

    def integral(self, f: sp.Expr) -> sp.Expr | None:
        """∫f dq_r from q_r*."""
        return quadrature(short(f), self.q_r, self.x_star[self.q_r])

    @property
    def of_one_coordinate(self) -> bool:
        """Whether g⊥, s and Γ are functions of q_r alone."""
        row = self.row
        return row.g_perp.free_symbols | row.s.free_symbols | row.gamma.free_symbols <= {self.q_r}

    @property
    def slope(self) -> int | None:
        """Sign of ∂s/∂q_r at the target."""
        return sign(self.at_target(sp.diff(self.row.s, self.q_r)))

    @property
    def unit(self) -> sp.Expr:
        """1/M_rr: with it H₀ is an energy of the size of the plant's."""
        return 1 / near(self.at_target(self.model.mass[self.row.r, self.row.r]))

    def size(self, a: int) -> sp.Expr:
        """The size of q_a beside that of q_r: where the row couples them, 1/|g⊥ₐ|."""
        coupling = self.at_target(self.row.g_perp[a])
        if sign(coupling) in (1, -1):
            return 1 / near(sp.Abs(coupling))
        mass = self.model.mass
        ratio = self.at_target(mass[self.row.r, self.row.r] / mass[a, a])
        return near(sp.sqrt(ratio))


@dataclass(frozen=True, eq=False)
class Shape:
    """What determines a mechanical target structure."""

    M_d: sp.Matrix  # k × k, of q
    inverse: sp.Matrix  # M_d⁻¹
    V_d: sp.Expr
    gammas: tuple[sp.Expr, ...]  # γ, k − 1
    slopes: sp.Matrix  # ∇γ, k × k − 1, as it was integrated


def near(value: sp.Expr) -> sp.Expr:
    """A positive constant as it is where it is rational, else to three digits."""
    return value if value.is_Rational else sp.Rational(f"{to_float(value):.3g}")
