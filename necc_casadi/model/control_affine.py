"""Systems ẋ = f(x) + g(x) u, whatever their energy: equilibria, and feedback ahead of a loop."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import sympy as sp

from necc_casadi.symbolic.linear_algebra import kernel
from necc_casadi.symbolic.zero import is_zero

__all__ = ["ControlAffine", "Equilibria", "Preliminary"]


class Equilibria(ABC):
    """What follows from f and g alone, for anything that has them."""

    x: tuple[sp.Symbol, ...]  # (n,)
    inputs: tuple[str, ...]  # names, (m,); () where they have none

    @property
    @abstractmethod
    def drift(self) -> sp.ImmutableMatrix:
        """f, n × 1."""

    @property
    @abstractmethod
    def directions(self) -> sp.ImmutableMatrix:
        """g, n × m."""

    @property
    def n(self) -> int:
        """Number of states."""
        return len(self.x)

    @property
    def m(self) -> int:
        """Number of inputs."""
        return int(self.directions.cols)

    @cached_property
    def input_names(self) -> tuple[str, ...]:
        """Names of the inputs, in order: u, or u1 … um, where they have none of their own."""
        count = range(1, self.m + 1)
        return self.inputs or (("u",) if self.m == 1 else tuple(f"u{i}" for i in count))

    @cached_property
    def states(self) -> tuple[str, ...]:
        """Names of the states, in order."""
        return tuple(str(s) for s in self.x)

    @cached_property
    def equilibrium_equations(self) -> tuple[sp.Expr, ...]:
        """g⊥f, the residuals that no constant input can cancel; zero ones dropped."""
        residual = kernel(sp.Matrix(self.directions.T)).T * self.drift
        # simplify() is slow, and polynomials do not need it
        tidied = (sp.expand(row) if row.is_polynomial() else sp.simplify(row) for row in residual)
        equations = (sp.numer(sp.together(row)) for row in tidied)
        return tuple(row for row in equations if row != 0)

    def holding_input(self, x_star: Mapping[sp.Symbol, sp.Expr]) -> sp.Matrix:
        """The constant input u* with f + g u* = 0 at an equilibrium, m × 1."""
        G = sp.Matrix(self.directions.subs(x_star))
        return -(G.T * G).LUsolve(G.T * sp.Matrix(self.drift.subs(x_star)))


@dataclass(frozen=True, eq=False)
class ControlAffine(Equilibria):
    """A plant without an energy, ẋ = f(x) + g(x) u."""

    name: str
    x: tuple[sp.Symbol, ...]
    f: sp.ImmutableMatrix  # n × 1
    g: sp.ImmutableMatrix  # n × m
    units: Mapping[str, str] = field(default_factory=dict)
    domain: Mapping[str, tuple[sp.Expr, sp.Expr]] = field(default_factory=dict)
    u_limits: tuple[tuple[float, float], ...] | None = None
    sizes: Mapping[str, sp.Expr] = field(default_factory=dict)
    inputs: tuple[str, ...] = ()

    @property
    def drift(self) -> sp.ImmutableMatrix:
        """f, n × 1."""
        return self.f

    @property
    def directions(self) -> sp.ImmutableMatrix:
        """g, n × m."""
        return self.g


@dataclass(frozen=True, eq=False)
class Preliminary:
    """Feedback u = u₀(x) + B(x) ũ that gives ẋ = f + g u a target structure.

        f + g u₀ = (J_d − R_d)∇H₀,   g B = G_d                        (matching equations)

    References
    ----------
    Ortega, van der Schaft, Maschke, Escobar (2002).
    """

    f: sp.ImmutableMatrix  # n × 1
    g: sp.ImmutableMatrix  # n × m
    u0: sp.ImmutableMatrix  # m × 1
    gain: sp.ImmutableMatrix  # B, m × m
    #: the plant with its own energy, where it has one: it knows the sizes of its states
    origin: Equilibria | None = None

    @property
    def acts_alone(self) -> bool:
        """Whether each ũᵢ moves its own uᵢ alone, and upwards, whatever the state."""
        B, size = self.gain, range(self.gain.rows)
        alone = not any(B[i, j] for i in size for j in size if i != j)
        return alone and all(B[i, i].is_positive is True for i in size)

    def residuals(self, flow: sp.MatrixBase, ports: sp.MatrixBase) -> tuple[sp.Expr, ...]:
        """What must vanish for a structure with this flow (J_d − R_d)∇H₀ and these ports G_d."""
        return (*(self.f + self.g * self.u0 - flow), *(self.g * self.gain - ports))

    def matches(self, flow: sp.MatrixBase, ports: sp.MatrixBase) -> bool:
        """Whether the matching equations are proved."""
        return all(is_zero(residual) is True for residual in self.residuals(flow, ports))
