"""Controller structure and its power-preserving interconnection with the plant.

eq. Controller:       ξ̇ = (Jc − Rc)∇Hc + Gc u_c,  y_c = Gcᵀ∇Hc
eq. PlantControllerInterconnection:  u = −y_c + v,  u_c = y + v_c
eq. ClosedLoopSystem: Jcl = [[J, −G Gcᵀ], [Gc Gᵀ, Jc]],  Rcl = diag(R, Rc)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import sympy as sp

from necc_casadi.errors import ModelError
from necc_casadi.plant import (
    Plant,
    Property,
    check_psd,
    check_rank,
    check_skew,
    check_states,
    shaped_matrix,
    square_matrix,
)

__all__ = ["ClosedLoop", "Controller", "default_controller", "interconnect", "make_controller"]


@dataclass(frozen=True, eq=False)
class Controller:
    """Structure of the controller (eq. Controller); Hc comes later, from the design."""

    xi: tuple[sp.Symbol, ...]  # (nc,)
    Jc: sp.ImmutableMatrix  # nc × nc, skew-symmetric
    Rc: sp.ImmutableMatrix  # nc × nc, ⪰ 0
    Gc: sp.ImmutableMatrix  # nc × m, full rank
    properties: tuple[Property, ...] = ()

    @property
    def nc(self) -> int:
        """Number of controller states."""
        return len(self.xi)

    @cached_property
    def states(self) -> tuple[str, ...]:
        """Names of the controller states, in order."""
        return tuple(str(s) for s in self.xi)


@dataclass(frozen=True, eq=False)
class ClosedLoop:
    """Plant and controller, interconnected (eq. ClosedLoopSystem), z = (x, ξ)."""

    plant: Plant
    controller: Controller

    @cached_property
    def z(self) -> tuple[sp.Symbol, ...]:
        """All states, plant first, (n + nc,)."""
        return self.plant.x + self.controller.xi

    @property
    def n(self) -> int:
        """Number of closed-loop states, n + nc."""
        return len(self.z)

    @cached_property
    def states(self) -> tuple[str, ...]:
        """Names of all states, plant first."""
        return self.plant.states + self.controller.states

    @cached_property
    def J(self) -> sp.ImmutableMatrix:
        """Jcl, (n + nc) × (n + nc)."""
        coupling = self.plant.G * self.controller.Gc.T
        upper = sp.Matrix.hstack(sp.Matrix(self.plant.J), sp.Matrix(-coupling))
        lower = sp.Matrix.hstack(sp.Matrix(coupling.T), sp.Matrix(self.controller.Jc))
        return sp.ImmutableMatrix(sp.Matrix.vstack(upper, lower))

    @cached_property
    def R(self) -> sp.ImmutableMatrix:
        """Rcl, (n + nc) × (n + nc)."""
        return sp.ImmutableMatrix(sp.diag(sp.Matrix(self.plant.R), sp.Matrix(self.controller.Rc)))

    @cached_property
    def M(self) -> sp.ImmutableMatrix:
        """Jcl − Rcl, so that a Casimir satisfies ∇Cᵀ M = 0 (eq. CasimirCondition)."""
        return sp.ImmutableMatrix(self.J - self.R)

    @cached_property
    def ports(self) -> sp.ImmutableMatrix:
        """𝒢 = diag(G, Gc), (n + nc) × 2m, through which v and v_c act."""
        return sp.ImmutableMatrix(sp.diag(sp.Matrix(self.plant.G), sp.Matrix(self.controller.Gc)))

    @property
    def properties(self) -> tuple[Property, ...]:
        """Structural properties of plant and controller."""
        return self.plant.properties + self.controller.properties


def default_controller(plant: Plant) -> Controller:
    """One integrator per input: Jc = 0, Rc = 0, Gc = I, states xi1 … xim."""
    xi = sp.symbols([f"xi{i + 1}" for i in range(plant.m)], real=True)
    m = plant.m
    return make_controller(plant, xi, sp.zeros(m, m), sp.zeros(m, m), sp.eye(m))


def make_controller(
    plant: Plant, xi: Sequence[sp.Symbol], Jc: sp.Matrix, Rc: sp.Matrix, Gc: sp.Matrix
) -> Controller:
    """Check the structure of eq. Controller against `plant`.

    Raises
    ------
    ModelError
        ``name_clash, duplicate_state, shape, undefined_symbol, not_real, non_smooth, singular,
        jc_not_skew, rc_not_psd, gc_rank``.
    """
    xi = tuple(xi)
    check_states(xi, "xi")
    clash = sorted({str(s) for s in xi} & set(plant.states))
    if clash:
        raise ModelError(
            "name_clash",
            f"{clash[0]} is a plant state and a controller state",
            "Rename one of them; the default controller states are called xi1, xi2, ….",
        )
    nc = len(xi)
    Jc = square_matrix(Jc, nc, "Jc", xi)
    Rc = square_matrix(Rc, nc, "Rc", xi)
    Gc = shaped_matrix(Gc, "Gc", xi)
    if Gc.shape != (nc, plant.m):
        raise ModelError(
            "shape",
            f"Gc has shape {Gc.rows}×{Gc.cols}",
            f"Gc must be {nc}×{plant.m}: controller states by inputs.",
        )
    properties = (
        check_skew(Jc, "Jc", "jc_not_skew"),
        check_psd(Rc, "Rc", "rc_not_psd", "rc_not_psd"),
        check_rank(Gc, "Gc", "gc_rank"),
    )
    return Controller(xi, Jc, Rc, Gc, properties)


def interconnect(plant: Plant, controller: Controller) -> ClosedLoop:
    """The closed loop of eq. ClosedLoopSystem, before damping is injected."""
    return ClosedLoop(plant, controller)
