"""A finished controller on a plant whose parameters are other ones.

The controller is the exported one, u within the limits of the model; the plant is that of the model
with parameters θ and constant disturbances of u as inputs: one integrator serves every plant.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from necc_casadi.arrays import Vector
from necc_casadi.designs.design import Design
from necc_casadi.interrupts import interruptible
from necc_casadi.lyapunov.sympy2casadi import casadi_function
from necc_casadi.model.parametric import Parametric
from necc_casadi.model.plant import Plant
from necc_casadi.simulation.responses import SETTLED, default_horizon
from necc_casadi.symbolic.derivatives import gradient
from necc_casadi.symbolic.floats import to_float

__all__ = ["OtherPlants", "Outcome", "disturbance_names"]


#: A response is followed for so many default horizons, with so many outputs.
_HORIZONS, _POINTS = 2.0, 401


#: Error that a step allows, in natural units; steps between two outputs at most.
_RELATIVE, _ABSOLUTE, _MOST_STEPS = 1e-8, 1e-10, 10_000


#: Steps from the design's own plant to another one, Newton steps in each, and the last of them.
_STEPS, _NEWTON, _SMALL = 10, 20, 1e-10


#: An offset below this share of a state's size is rounding.
_NOTHING = 1e-12


@dataclass(frozen=True, eq=False)
class Outcome:
    """What becomes of one plant; in the units of the model."""

    offset: Vector | None  # (n,) x at rest less x*; None: the loop does not stay at rest nearby
    settling_times: Vector  # (starts,) s, to within 2 % of the way to that rest; ∞ where never
    peak_input: Vector  # (m,) largest |u| of all starts

    @property
    def share(self) -> float:
        """Of the starts that come to rest there."""
        return float(np.isfinite(self.settling_times).mean())


def disturbance_names(plant: Plant) -> list[str]:
    """Names of constant disturbances of the inputs."""
    return [f"d_{name}" for name in plant.input_names]


class OtherPlants:
    """The loop of a design as a function of the plant's parameters."""

    def __init__(self, design: Design, plant: Parametric) -> None:
        self.design, natural = design, design.natural
        own = [str(symbol) for symbol in plant.symbols]
        pushes = disturbance_names(design.loop.plant)
        self.names = [*own, *(name for name in pushes if name not in own)]
        values = [to_float(plant.values[name]) for name in own]
        self.nominal = np.array([*values, *[0.0] * (len(self.names) - len(own))])
        self._pushed = len(self.names) - len(own) == len(pushes)
        self._natural = natural
        self._integrators = np.zeros(0 if design.integral is None else design.loop.plant.m)
        self._size = len(natural.z_star) + len(self._integrators)
        self._field = self._as_field(plant)
        self._rest = self._as_equations()
        horizon = _HORIZONS * default_horizon(design)
        self.grid = np.linspace(0.0, horizon, _POINTS)
        self._integrator = self._as_integrator()

    def _as_field(self, plant: Parametric) -> ca.Function:
        """(z, θ) -> ż in natural units, and u; z = (x, s, ζ), s what the controller keeps."""
        own, units = self.design.loop.plant, self.design.units
        known = (*own.x, *plant.symbols)
        slopes = casadi_function("slopes", known, gradient(plant.H, own.x))
        structure = casadi_function("structure", known, plant.J - plant.R)
        ports = casadi_function("ports", known, plant.G)
        n, z = own.n, ca.MX.sym("z", self._size)
        theta, count = ca.MX.sym("theta", len(self.names)), len(plant.symbols)
        u, s_dot, _ = self._natural.limited_controller.call([z[:n], z[n:]])
        state = ca.DM(units.state[:n])
        at = ca.vertcat(z[:n] * state, theta[:count, 0])
        pushed = theta[count:, 0] if self._pushed else 0
        x_dot = structure(at) @ slopes(at) + ports(at) @ (u * ca.DM(units.input) + pushed)
        slope = ca.vertcat(x_dot * units.time / state, s_dot)
        return ca.Function("other", [z, theta], [slope, u], ["z", "theta"], ["z_dot", "u"])

    def _as_equations(self) -> ca.Function:
        """(z, θ) -> ż and ∂ż/∂z."""
        z, theta = ca.MX.sym("z", self._size), ca.MX.sym("theta", len(self.names))
        slope = self._field(z, theta)[0]
        return ca.Function("rest", [z, theta], [slope, ca.jacobian(slope, z)])

    def _as_integrator(self) -> ca.Function:
        z, theta = ca.MX.sym("z", self._size), ca.MX.sym("theta", len(self.names))
        options = {
            "abstol": _ABSOLUTE,
            "reltol": _RELATIVE,
            "max_num_steps": _MOST_STEPS,
            "show_eval_warnings": False,
            "disable_internal_warnings": True,
        }
        field = {"x": z, "p": theta, "ode": self._field(z, theta)[0]}
        times = (self.grid[1:] / self.design.units.time).tolist()
        return ca.integrator("response", "cvodes", field, 0.0, times, options)

    def at_rest(self, theta: Vector) -> Vector | None:
        """Z at rest with these parameters, in natural units; None: none nearby that is stable."""
        at = np.concatenate([self._natural.stored_z_bar, self._integrators])
        for share in np.linspace(0, 1, _STEPS + 1)[1:]:
            values = self.nominal + share * (theta - self.nominal)
            for _ in range(_NEWTON):
                slope, A = (np.asarray(v, float) for v in self._rest.call([at, values]))
                if not np.isfinite(A).all() or not np.isfinite(slope).all():
                    return None
                step = np.linalg.lstsq(A, slope.ravel(), rcond=None)[0]
                at = at - step
                if np.linalg.norm(step) < _SMALL:
                    break
            else:
                return None
        A = np.asarray(self._rest.call([at, theta])[1], float)
        return at if np.linalg.eigvals(A).real.max() < 0 else None

    def follow(self, theta: Vector, starts: Sequence[Vector]) -> Outcome:
        """What becomes of plant states (n,) on the plant with parameters (p,)."""
        units = self.design.units
        rest = self.at_rest(theta)
        times, peak = np.full(len(starts), np.inf), np.zeros(self.design.loop.plant.m)
        for index, x0 in enumerate(starts):
            kept = self.design.lyapunov.stored(x0, self.design.xi_at_state(x0))
            z0 = np.concatenate([np.asarray(x0, float), kept]) / units.state
            z0 = np.concatenate([z0, self._integrators])
            z = self._response(z0, theta)
            u = np.asarray(self._field.call([z.T, np.tile(theta[:, None], len(z))])[1], float)
            peak = np.fmax(peak, np.abs(u).max(axis=1) * units.input)
            if rest is not None and len(z) == len(self.grid):
                times[index] = self._settled(z, rest)
        return Outcome(None if rest is None else self._offset(rest), times, peak)

    def error_from(self, theta: Vector, x0: Vector) -> Vector:
        """X less x* at the times of the grid, (times, n), from a plant state (n,), in its units.

        Of the first time alone where the integrator gives up.
        """
        units, n = self.design.units, self.design.loop.plant.n
        kept = self.design.lyapunov.stored(x0, self.design.xi_at_state(x0))
        start = np.concatenate([np.asarray(x0, float), kept]) / units.state
        z = self._response(np.concatenate([start, self._integrators]), theta)
        return np.asarray((z[:, :n] - self._natural.z_star[:n]) * units.state[:n], float)

    def rest_error(self, theta: Vector) -> Vector | None:
        """X at rest less x*, (n,), in its units; None: it does not stay at rest nearby."""
        rest = self.at_rest(theta)
        return None if rest is None else self._offset(rest)

    def _offset(self, rest: Vector) -> Vector:
        """X at rest less x*, without what is rounding, in the units of the model."""
        n = self.design.loop.plant.n
        away = rest[:n] - self._natural.z_star[:n]
        rounding = np.abs(away) < _NOTHING * self._natural.sizes.state[:n]
        return np.asarray(np.where(rounding, 0.0, away) * self.design.units.state[:n], float)

    def _response(self, z0: Vector, theta: Vector) -> Vector:
        """States at the times of the grid; the first alone where the integrator gives up."""
        try:
            with interruptible():
                ends = np.asarray(self._integrator(x0=z0, p=theta)["xf"], float).T
        except RuntimeError:  # the integrator's way to say that it cannot go on
            return z0[None, :]
        return np.vstack([z0, ends]) if np.isfinite(ends).all() else z0[None, :]

    def _settled(self, z: Vector, rest: Vector) -> float:
        """Time after which it stays within 2 % of the first distance from rest, s; ∞: never."""
        sizes = self._natural.sizes
        size = np.concatenate([sizes.state, sizes.input[: len(self._integrators)]])
        distance = np.linalg.norm((z - rest) / size, axis=1)
        near = SETTLED * distance[0]
        outside = np.flatnonzero(distance > near)
        if outside.size == 0:
            return 0.0
        last = outside[-1]
        if last + 1 >= len(z):
            return float("inf")
        way = (distance[last] - near) / (distance[last] - distance[last + 1])
        return float(self.grid[last] + way * (self.grid[last + 1] - self.grid[last]))
