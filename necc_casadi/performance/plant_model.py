"""What a performance is measured on: the plant at its target, in natural units."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np

from necc_casadi.arrays import Vector
from necc_casadi.designs.design import Design
from necc_casadi.lyapunov.opened_loop import plant_dynamics, plant_linearisation
from necc_casadi.model.cost import QuadraticCost
from necc_casadi.model.lqr import Lqr, lqr

__all__ = ["PlantModel", "plant_model"]


@dataclass(frozen=True, eq=False)
class PlantModel:
    """Dynamics, target, cost, and LQR at the target, all in natural units."""

    dynamics: ca.Function  # (x, u) -> ẋ
    x_star: Vector  # (n,)
    u_star: Vector  # (m,) holds the target
    cost: QuadraticCost
    size: Vector  # (n,) natural sizes
    u_size: Vector  # (m,)
    u_low: Vector  # (m,) limits of the inputs, −∞ and ∞ without
    u_high: Vector
    A: Vector  # (n, n) ∂ẋ/∂x at the target
    B: Vector  # (n, m) ∂ẋ/∂u

    @cached_property
    def linear(self) -> Lqr | None:
        """LQR at the target; None: it does not stabilise the plant."""
        return lqr(self.A, self.B, self.cost)

    @property
    def n(self) -> int:
        """Number of states."""
        return len(self.x_star)

    @property
    def m(self) -> int:
        """Number of inputs."""
        return len(self.u_star)

    @property
    def limited(self) -> bool:
        """Whether any input has a limit."""
        return bool(np.isfinite([self.u_low, self.u_high]).any())

    def running_cost(self, x: ca.SX, u: ca.SX) -> ca.SX:
        """What (x, u) costs per unit of time."""
        away, effort = x - ca.DM(self.x_star), u - ca.DM(self.u_star)
        Q, R = ca.SX(ca.DM(self.cost.Q)), ca.SX(ca.DM(self.cost.R))
        return ca.bilin(Q, away, away) + ca.bilin(R, effort, effort)


def plant_model(design: Design, cost: QuadraticCost) -> PlantModel:
    """The plant of a design beside a cost in the units of its model."""
    natural, units = design.natural, design.units
    terms = natural.lyapunov.terms
    x = natural.z_star[: terms.n]
    u = natural.lyapunov.control_law(x, natural.xi_star)[0]
    A, B = plant_linearisation(terms, x, u)
    scaled = cost.measured_in(units)
    limits = natural.loop.plant.u_limits or ((-np.inf, np.inf),) * terms.m
    low, high = np.array(limits, float).T
    return PlantModel(
        dynamics=plant_dynamics(terms),
        x_star=x,
        u_star=u,
        cost=scaled,
        size=natural.sizes.state[: terms.n],
        u_size=natural.sizes.input,
        u_low=low,
        u_high=high,
        A=A,
        B=B,
    )
