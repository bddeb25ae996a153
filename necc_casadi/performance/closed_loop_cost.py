"""Responses of any controller from many starts, and what they cost.

References
----------
Hindmarsh et al. (2005), CVODES.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from necc_casadi.arrays import Truth, Vector
from necc_casadi.designs.design import Design
from necc_casadi.interrupts import interruptible
from necc_casadi.lyapunov.limits import limited_law
from necc_casadi.performance.plant_model import PlantModel

__all__ = ["Feedback", "Responses", "design_feedback", "lqr_feedback", "responses"]


#: Output times of a response.
_POINTS = 401


#: A response that ends within this share of its first distance has come to the target.
_ARRIVED = 0.01


#: It has settled while it stays within this share.
_SETTLED = 0.02


#: Error that a step allows, in natural units, and steps between two output times.
_RELATIVE, _ABSOLUTE, _MOST_STEPS = 1e-8, 1e-10, 1000


@dataclass(frozen=True, eq=False)
class Feedback:
    """A controller in natural units."""

    law: ca.Function  # (x, s) -> (u, ṡ), s what the controller keeps
    nc: int  # states of the controller
    start: Callable[[Vector], Vector]  # x(0) (n,) -> s(0) (nc,)
    #: the law without the damping that limits scale; None: they clip each input
    resting: ca.Function | None = None

    def limited(self, low: Vector, high: Vector) -> ca.Function:
        """(x, s) -> (u, ṡ, what u would be), u within these limits, (m,) each; ∞ where none."""
        given = (low, high) if np.isfinite([low, high]).any() else (None, None)
        return limited_law(self.law, self.resting, *given)


@dataclass(frozen=True, eq=False)
class Responses:
    """Of one controller from N starts, in natural units; unreached times are nan."""

    t: Vector  # (points,)
    x: Vector  # (N, points, n)
    u: Vector  # (N, points, m) within the limits of the model
    demand: Vector  # (N, points, m) what the controller asked for
    kept: Vector  # (N, points, nc) states of the controller
    cost: Vector  # (N,) ∞ where the target is not reached
    x_star: Vector  # (n,)
    size: Vector  # (n,)

    @property
    def distance(self) -> Vector:
        """‖x − x*‖ in sizes, (N, points)."""
        return np.asarray(np.linalg.norm((self.x - self.x_star) / self.size, axis=2), float)

    @property
    def near(self) -> Truth:
        """Which starts end near the target, (N,)."""
        distance = self.distance
        with np.errstate(invalid="ignore"):
            return np.asarray(distance[:, -1] <= _ARRIVED * distance[:, 0], bool)

    @property
    def arrived(self) -> Truth:
        """Which starts come to the target, (N,)."""
        return np.isfinite(self.cost)

    @property
    def settling_times(self) -> Vector:
        """Time from which the distance stays within 2 % of the first, (N,); ∞ if never."""
        distance, times = self.distance, []
        for row, arrived in zip(distance, self.arrived, strict=True):
            outside = np.flatnonzero(row > _SETTLED * row[0])
            last = int(outside[-1]) + 1 if outside.size else 0
            times.append(float(self.t[last]) if arrived and last < len(self.t) else np.inf)
        return np.array(times)

    @property
    def overshoots(self) -> Vector:
        """How far a state goes beyond the target, as a share of the first distance, (N,)."""
        first = (self.x[:, 0] - self.x_star) / self.size
        beyond = -np.sign(first)[:, None] * (self.x - self.x_star) / self.size
        largest = np.fmax.reduce(np.where(first[:, None] == 0, 0.0, beyond), axis=(1, 2))
        norm = np.linalg.norm(first, axis=1)
        return np.asarray(np.maximum(largest, 0.0) / np.where(norm > 0, norm, 1.0), float)

    @property
    def peak_inputs(self) -> Vector:
        """Largest |u| of each input, (N, m)."""
        return np.asarray(np.fmax.reduce(np.abs(self.u), axis=1), float)

    @property
    def peak_demands(self) -> Vector:
        """Largest |u| that the controller asked for, (N, m)."""
        return np.asarray(np.fmax.reduce(np.abs(self.demand), axis=1), float)


def design_feedback(design: Design) -> Feedback:
    """The controller of a design, ξ starting where the design says."""
    natural, V = design.natural, design.natural.lyapunov
    law, resting = V.control_law_function, None
    if design.scales_damping:
        resting = V.resting.control_law_function
    return Feedback(law, V.terms.nc, lambda x: V.stored(x, natural.xi_at_state(x)), resting)


def lqr_feedback(plant: PlantModel) -> Feedback | None:
    """U = u* − K(x − x*), where LQR stabilises."""
    if plant.linear is None:
        return None
    x, xi = ca.MX.sym("x", plant.n), ca.MX.sym("xi", 0)
    u = ca.DM(plant.u_star) - ca.DM(plant.linear.K) @ (x - ca.DM(plant.x_star))
    law = ca.Function("lqr", [x, xi], [u, ca.MX(0, 1)])
    return Feedback(law, 0, lambda _: np.zeros(0))


def responses(
    plant: PlantModel,
    feedback: Feedback,
    starts: Sequence[Vector],
    horizon: float,
    kept: Sequence[Vector] | None = None,
) -> Responses:
    """Responses from plant states (n,) over a horizon, in natural units, inputs limited.

    The controller starts as it does by itself, or from `kept` (nc,) for each start.
    """
    kept = [feedback.start(start) for start in starts] if kept is None else kept
    grid = np.linspace(0.0, horizon, _POINTS)
    integrator = _integrator(plant, feedback, grid)
    n, nc = plant.n, feedback.nc
    states = np.full((len(starts), _POINTS, n + nc + 1), np.nan)
    for index, (start, held) in enumerate(zip(starts, kept, strict=True)):
        states[index, 0] = np.concatenate([start, held, [0.0]])
        try:
            with interruptible():
                ends = np.asarray(integrator(x0=states[index, 0])["xf"], float)
        except RuntimeError:  # the integrator's way to say that it cannot go on
            continue
        states[index, 1:] = ends.T
    law = feedback.limited(plant.u_low, plant.u_high).map(len(starts) * _POINTS)
    columns = states.reshape(-1, n + nc + 1).T
    applied, _, asked = law.call([columns[:n], columns[n : n + nc]])
    u, demand = (
        np.asarray(v, float).reshape(plant.m, -1).T.reshape(len(starts), _POINTS, plant.m)
        for v in (applied, asked)
    )
    found = Responses(
        t=grid,
        x=states[..., :n],
        u=u,
        demand=demand,
        kept=states[..., n : n + nc],
        cost=states[:, -1, -1],
        x_star=plant.x_star,
        size=plant.size,
    )
    return replace(found, cost=np.where(found.near & np.isfinite(found.cost), found.cost, np.inf))


def _integrator(plant: PlantModel, feedback: Feedback, grid: Vector) -> ca.Function:
    n, nc = plant.n, feedback.nc
    state = ca.MX.sym("state", n + nc + 1)
    x, xi = state[:n], state[n : n + nc]
    u, xi_dot, _ = feedback.limited(plant.u_low, plant.u_high).call([x, xi])
    sx, su = ca.SX.sym("x", n), ca.SX.sym("u", plant.m)
    running = ca.Function("cost", [sx, su], [plant.running_cost(sx, su)])
    field = {"x": state, "ode": ca.vertcat(plant.dynamics(x, u), xi_dot, running(x, u))}
    options = {
        "abstol": _ABSOLUTE,
        "reltol": _RELATIVE,
        "max_num_steps": _MOST_STEPS,
        "show_eval_warnings": False,
        "disable_internal_warnings": True,
    }
    return ca.integrator("rollout", "cvodes", field, 0.0, grid[1:].tolist(), options)
