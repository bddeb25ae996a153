"""The loop of power shaping: the controller integrates another passive output of the plant.

With F = J − R and shaping functions γ(x) that solve F∇γ = −Gα for some α(x):

    u = −α∇Hc(ξ) + v,   ξ̇ = ∇γᵀẋ + v_c
    Jcl, Rcl = [I; ∇γᵀ]{J, R}[I, ∇γ],   𝒢 = [[G, 0], [∇γᵀG, I]]

The Casimirs are ξ − γ(x): ∇Cᵀ[I; ∇γᵀ] = 0. A controller keeps s = ξ − γ(x), so ṡ = v_c needs no ẋ
and no u, and inputs that saturate do not wind it up.

References
----------
Ortega, van der Schaft, Castaños, Astolfi (2008), the output −GᵀF⁻ᵀẋ; docs/theory.md#power-shaping.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import sympy as sp

from necc_casadi.model.closed_loop import ClosedLoop
from necc_casadi.model.controller import Controller
from necc_casadi.model.plant import Plant

__all__ = ["ShapedLoop", "shaped_loop"]


@dataclass(frozen=True, eq=False)
class ShapedLoop(ClosedLoop):
    """A plant and a controller that integrates the passive outputs ∇γᵀẋ, z = (x, ξ)."""

    shaping: tuple[sp.Expr, ...]  # γ, (nc,) of x
    alpha: sp.ImmutableMatrix  # m × nc, of x

    @cached_property
    def slopes(self) -> sp.ImmutableMatrix:
        """∇γ, n × nc."""
        return sp.ImmutableMatrix(sp.Matrix(list(self.shaping)).jacobian(self.plant.x).T)

    @cached_property
    def J(self) -> sp.ImmutableMatrix:
        """Jcl = [I; ∇γᵀ] J [I, ∇γ], (n + nc)²."""
        return self._seen_through(self.plant.J)

    @cached_property
    def R(self) -> sp.ImmutableMatrix:
        """Rcl = [I; ∇γᵀ] R [I, ∇γ], (n + nc)²."""
        return self._seen_through(self.plant.R)

    @cached_property
    def ports(self) -> sp.ImmutableMatrix:
        """𝒢 = [[G, 0], [∇γᵀG, I]], (n + nc) × (m + nc)."""
        G, nc = sp.Matrix(self.plant.G), self.controller.nc
        lower = sp.Matrix.hstack((self.slopes.T * G).applyfunc(_tidy), sp.eye(nc))
        return sp.ImmutableMatrix(
            sp.Matrix.vstack(sp.Matrix.hstack(G, sp.zeros(self.plant.n, nc)), lower)
        )

    @property
    def feedback(self) -> sp.ImmutableMatrix:
        """α in u = −α∇Hc + v, m × nc."""
        return self.alpha

    @property
    def gamma(self) -> tuple[sp.Expr, ...]:
        """γ(x), (nc,)."""
        return self.shaping

    @property
    def own_structure(self) -> sp.ImmutableMatrix:
        """0: ṡ = v_c, nc × (n + nc)."""
        return sp.ImmutableMatrix(sp.zeros(self.controller.nc, self.n))

    @property
    def own_ports(self) -> sp.ImmutableMatrix:
        """[0, I], nc × (m + nc)."""
        nc = self.controller.nc
        return sp.ImmutableMatrix(sp.Matrix.hstack(sp.zeros(nc, self.plant.m), sp.eye(nc)))

    @property
    def matrices(self) -> tuple[sp.MatrixBase, ...]:
        """J, R, G, ∇γ and α."""
        plant = self.plant
        return (plant.J, plant.R, plant.G, self.slopes, self.alpha)

    @property
    def mismatch(self) -> sp.ImmutableMatrix:
        """F∇γ + Gα, n × nc: zero for shaping functions."""
        plant = self.plant
        return sp.ImmutableMatrix((plant.J - plant.R) * self.slopes + plant.G * self.alpha)

    def rewritten(self, change: Callable[[sp.Expr], sp.Expr]) -> ShapedLoop:
        """The loop with every entry of J, R, G, γ and α changed."""
        J, R, G = (m.applyfunc(change) for m in (self.plant.J, self.plant.R, self.plant.G))
        return replace(
            self,
            plant=replace(self.plant, J=J, R=R, G=G),
            shaping=tuple(change(g) for g in self.shaping),
            alpha=self.alpha.applyfunc(change),
        )

    def _seen_through(self, A: sp.MatrixBase) -> sp.ImmutableMatrix:
        """[I; ∇γᵀ] A [I, ∇γ]."""
        through = sp.Matrix.vstack(sp.eye(self.plant.n), sp.Matrix(self.slopes.T))
        return sp.ImmutableMatrix((through * A * through.T).applyfunc(_tidy))


def _tidy(entry: sp.Expr) -> sp.Expr:
    """What cancels is gone: the search for Casimirs counts the entries."""
    return sp.Integer(0) if entry == 0 else sp.expand(entry) if entry.is_polynomial() else entry


def shaped_loop(
    plant: Plant,
    gamma: Sequence[sp.Expr],
    alpha: sp.MatrixBase,
    xi: Sequence[sp.Symbol] | None = None,
) -> ShapedLoop:
    """The loop with one integrator for each shaping function; ξ1 … ξr by default.

    Parameters
    ----------
    plant
        With F = J − R.
    gamma
        γ, r functions of x with F∇γ = −Gα; :attr:`ShapedLoop.mismatch` says whether they are.
    alpha
        α, m × r, of x.
    xi
        Controller states, r symbols.
    """
    nc = len(gamma)
    symbols = sp.symbols([f"xi{i + 1}" for i in range(nc)], real=True) if xi is None else xi
    zero, one = sp.ImmutableMatrix(sp.zeros(nc, nc)), sp.ImmutableMatrix(sp.eye(nc))
    controller = Controller(tuple(symbols), zero, zero, one)
    return ShapedLoop(plant, controller, tuple(gamma), sp.ImmutableMatrix(alpha))
