"""Responses of many starts at once, what they cost, and how that changes with V and the damping.

With hidden layers and ξ* as they are, what moves is

    θ = (output layers, log(κ − κ_min), β, T, η),   ½κ(v − v*)² − βv  the quadratic parts,

v* what a network sees at z*, ξ(0) = ξ* + T(x(0) − x*), η the damping (quadratic_cost.py). The
classical method of Runge and Kutta is differentiated as it stands: with ż = f(z, θ), each of its
stages carries

    Ṡ = ∂f/∂z S + ∂f/∂θ,   S = ∂z/∂θ,

and the residuals of the cost, of states and of inputs within their limits, follow from S.

References
----------
Hairer, Nørsett and Wanner (1993), II.1 and II.6.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from typing import TypeVar

import casadi as ca
import numpy as np

from necc_casadi.arrays import Vector
from necc_casadi.interrupts import interruptible
from necc_casadi.lyapunov.limits import clipped, scaled
from necc_casadi.lyapunov.lyapunov import control_law, value
from necc_casadi.lyapunov.networks import Network
from necc_casadi.lyapunov.opened_loop import plant_dynamics
from necc_casadi.performance.plant_model import PlantModel
from necc_casadi.synthesis.lifting import Lifting
from necc_casadi.synthesis.quadratic_cost import damping_variables

__all__ = ["Moving", "Rollouts", "Sums"]


_Symbols = TypeVar("_Symbols", ca.MX, ca.SX)


#: Up to this many weights the field is evaluated in scalar operations, which are faster.
_SCALAR_WEIGHTS = 10_000


#: κ begins at least this much above κ_min, as a share of it.
_ABOVE = 0.02


class Moving:
    """θ, and the weights and the damping that it stands for; natural weights ŵ."""

    def __init__(
        self,
        lifting: Lifting,
        kappa_min: float,
        weights: Vector,
        xi_star: Vector,
        trained: Vector,
        networks: bool = True,
    ) -> None:
        self.lifting, self.kappa_min = lifting, kappa_min
        self.xi_star, self.trained = xi_star, trained
        self.w0 = (weights - lifting.tau) / lifting.sigma
        bases = lifting.bases.call([lifting.jets_at(weights, xi_star)])
        units = lifting.form.split(lifting.sigma)
        at, affine, kappa, centre, base = 0, [], [], [], []
        for network, v, unit in zip(lifting.form.networks, bases, units, strict=True):
            if not isinstance(network, Network):
                raise TypeError("a neural Φ has no quadratic parts")
            d = network.inputs if network.quadratic else 0
            end, last = at + network.size - 2 * d, network.shapes[-1]
            affine += list(range(end - last[0] * last[1] - last[0], end)) if networks else []
            kappa += list(range(end, end + d))
            centre += list(range(end + d, end + 2 * d))
            base += list(np.asarray(v, float).ravel()[:d] / unit[network.size - d :][:d])
            at += network.size
        self.affine, self.kappa, self.centre = (
            np.array(v, dtype=int) for v in (affine, kappa, centre)
        )
        self.base = np.array(base, float)
        self.eta, damping = damping_variables(trained)
        self._damping = ca.Function("damping", [self.eta], [damping])
        self.gain_shape = lifting.terms.nc, lifting.terms.n
        gains = lifting.terms.nc * lifting.terms.n
        self.size = len(affine) + 2 * len(kappa) + gains + self.eta.numel()
        size = lifting.scales.state
        #: T in the sizes of its states
        self.gain_unit = size[lifting.terms.n :, None] / size[: lifting.terms.n]

    def first(self, eta: Vector, gain: Vector | None = None) -> Vector:
        """θ of the weights, damping and T (nc, n) at the start, (size,); without T it is 0."""
        T = np.zeros(self.gain_shape) if gain is None else gain / self.gain_unit
        k, o = self.w0[self.kappa], self.w0[self.centre]
        above = np.log(np.fmax(k - self.kappa_min, _ABOVE * self.kappa_min))
        outer = self.w0[self.affine]
        return np.concatenate([outer, above, k * (o - self.base), T.ravel(), eta])

    def split(self, theta: ca.MX) -> tuple[ca.MX, ca.MX, ca.MX, ca.MX]:
        """(output layers, log(κ − κ_min), β, η)."""
        a, k = len(self.affine), len(self.kappa)
        return theta[:a], theta[a : a + k], theta[a + k : a + 2 * k], theta[self.eta_at]

    def weights_at(self, theta: Vector) -> Vector:
        """The same as numbers."""
        symbol = ca.MX.sym("theta", self.size)
        found = ca.Function("weights", [symbol], [self.weights(symbol)])(theta)
        return np.asarray(found, float).ravel()

    def gain(self, theta: Vector) -> Vector:
        """T as numbers, (nc, n)."""
        return np.asarray(theta[self.gain_at].reshape(self.gain_shape) * self.gain_unit, float)

    @property
    def gain_at(self) -> slice:
        """Where T stands in θ."""
        begin = len(self.affine) + 2 * len(self.kappa)
        return slice(begin, self.eta_at.start)

    @property
    def kappa_at(self) -> slice:
        """Where log(κ − κ_min) stands in θ."""
        return slice(len(self.affine), len(self.affine) + len(self.kappa))

    @property
    def eta_at(self) -> slice:
        """Where η stands in θ."""
        return slice(self.size - self.eta.numel(), self.size)

    def weights(self, theta: ca.MX) -> ca.MX:
        """All weights, (form.size,), in training units."""
        outer, above, beta, _ = self.split(theta)
        kappa = self.kappa_min + ca.exp(above)
        w = ca.MX(ca.DM(self.w0))
        w[self.affine.tolist()] = outer
        w[self.kappa.tolist()] = kappa
        w[self.centre.tolist()] = ca.DM(self.base) + beta / kappa
        return ca.DM(self.lifting.sigma) * w + ca.DM(self.lifting.tau)

    def damping_of(self, theta: ca.MX) -> ca.MX:
        """𝒟, (m + channels)²."""
        found: ca.MX = self._damping(self.split(theta)[-1])
        return found

    def shape(self, theta: ca.MX) -> tuple[ca.MX, ca.MX]:
        """∇V and ∇²V at z*."""
        lifting, terms = self.lifting, self.lifting.terms
        z, w, form = ca.MX.sym("z", terms.n + terms.nc), self.weights(theta), lifting.form
        V = value(terms, z, form.controller_energy(w), form.casimir(w), form.outer(w))
        N, g = ca.hessian(V, z)
        at = ca.MX(ca.DM(np.concatenate([lifting.x_star, self.xi_star])))
        gradient, hessian = ca.substitute([g, N], [z], [at])
        return gradient, hessian


@dataclass(frozen=True, eq=False)
class Sums:
    """Costs of N responses, and Gauss and Newton's sums over their residuals r."""

    costs: Vector  # (N,)
    gradient: Vector  # (p,) of the weighted mean of the costs
    curvature: Vector  # (p, p)


class Rollouts:
    """Responses from plant states (N, n), on a fixed grid; first over one step of no length.

    With `scales` limits of inputs scale the damping, as where 𝒟 is full; else they clip inputs.
    """

    def __init__(
        self, moving: Moving, plant: PlantModel, starts: Vector, scales: bool = True
    ) -> None:
        self.moving, self.plant, self.starts = moving, plant, starts
        self.scales = scales
        self.step, self.steps = 0.0, 1
        self.n, self.nc = plant.n, moving.lifting.terms.nc
        held = np.asarray(moving.lifting.terms.gamma(plant.x_star), float).ravel()
        self.kept_star = moving.xi_star - held  # s at z*
        self.input_root = np.linalg.cholesky(plant.cost.R).T
        self.state_root = _root(plant.cost.Q)
        #: what follows the horizon costs about what LQR pays for it
        self.end_root = np.zeros((0, self.n)) if plant.linear is None else _root(plant.linear.P)
        self._one_plain, self._one = self._stages()
        self._maps()

    def _maps(self) -> None:
        self.stage, self.plain = (f.map(len(self.starts)) for f in (self._one, self._one_plain))

    def over(self, horizon: float, steps: int) -> Rollouts:
        """The same over a horizon."""
        result = copy(self)
        result.step, result.steps = horizon / steps, steps
        return result

    def of(self, starts: Vector) -> Rollouts:
        """The same from other starts."""
        result = copy(self)
        result.starts = starts
        result._maps()
        return result

    def _stages(self) -> tuple[ca.Function, ca.Function]:
        """(z, θ) -> ż and u, limited; and the same with their slopes in z and θ."""
        moving, plant = self.moving, self.plant
        terms, form = moving.lifting.terms, moving.lifting.form
        x, s = ca.MX.sym("x", self.n), ca.MX.sym("s", self.nc)
        theta = ca.MX.sym("theta", moving.size)
        weights, damping = moving.weights(theta), moving.damping_of(theta)
        u, s_dot = control_law(terms, form, weights, damping, x, s)
        low, high = ca.DM(plant.u_low), ca.DM(plant.u_high)
        if plant.limited and self.scales:
            resting = control_law(terms, form, weights, ca.DM(*damping.shape), x, s)
            u, s_dot = scaled(u, s_dot, *resting, low, high)
        elif plant.limited:
            u = clipped(u, low, high)
        found = ca.vertcat(plant_dynamics(terms)(x, u), s_dot, u)
        split = ca.Function("split", [x, s, theta], [ca.densify(found)])
        z = ca.MX.sym("z", self.n + self.nc)
        field = ca.Function("field", [z, theta], [split(z[: self.n], z[self.n :], theta)])
        if form.size > _SCALAR_WEIGHTS:
            return field, _with_slopes(field, [z, theta])
        scalars = [ca.SX.sym(s.name(), s.numel()) for s in (z, theta)]
        return field.expand(), _with_slopes(field.expand(), scalars)

    def slope(self, theta: Vector) -> Vector:
        """∂ż/∂z at z*, (n + nc, n + nc)."""
        z_star = np.concatenate([self.plant.x_star, self.kept_star])
        by_z = np.asarray(self._one.call([z_star, theta])[1], float)
        return by_z[: self.n + self.nc]

    def _first(self, theta: Vector) -> tuple[Vector, Vector]:
        """(x(0), s(0)) and its slopes in θ."""
        moving, away = self.moving, self.starts - self.plant.x_star
        kept = self.kept_star + away @ moving.gain(theta).T
        slopes = np.zeros((len(away), self.n + self.nc, theta.size))
        columns = np.arange(theta.size)[moving.gain_at].reshape(moving.gain_shape)
        for i in range(self.nc):
            slopes[:, self.n + i, columns[i]] = away * moving.gain_unit[i]
        return np.concatenate([self.starts, kept], axis=1), slopes

    def costs(self, theta: Vector) -> Vector:
        """What the responses cost, (N,); nan where the method leaves floating point."""
        z, h, total = self._first(theta)[0], self.step, 0.0
        size = self.n + self.nc
        parameters = np.repeat(theta[:, None], len(z), axis=1)

        def field(z: Vector) -> Vector:
            return np.asarray(self.plain(z.T, parameters), float).T

        with interruptible(), np.errstate(all="ignore"):
            for index in range(self.steps + 1):
                k1 = field(z)
                total = total + self._share(index) * (self._residuals(z, k1[:, size:]) ** 2).sum(1)
                if index < self.steps:
                    k2 = field(z + h / 2 * k1[:, :size])
                    k3 = field(z + h / 2 * k2[:, :size])
                    k4 = field(z + h * k3[:, :size])
                    z = z + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)[:, :size]
            total = total + (self._left(z) ** 2).sum(1)
        return np.asarray(total, float)

    def sums(self, theta: Vector, weights: Vector) -> Sums:
        """The same with the derivatives of Σ weights · costs."""
        (z, S), h, size = self._first(theta), self.step, self.n + self.nc
        count, p = len(z), theta.size
        total = np.zeros(count)
        gradient, curvature = np.zeros(p), np.zeros((p, p))
        parameters = np.repeat(theta[:, None], count, axis=1)
        root = np.sqrt(weights)[:, None, None]

        def field(z: Vector, S: Vector) -> tuple[Vector, Vector]:
            value, by_z, by_theta = (
                np.asarray(v, float) for v in self.stage.call([z.T, parameters])
            )
            rows = value.shape[0]
            A = by_z.reshape(rows, count, size).transpose(1, 0, 2)
            B = by_theta.reshape(rows, count, p).transpose(1, 0, 2)
            return value.T, A @ S + B

        with interruptible(), np.errstate(all="ignore"):
            for index in range(self.steps + 1):
                k1, K1 = field(z, S)
                share = self._share(index)
                r = self._residuals(z, k1[:, size:])
                slopes = np.concatenate(
                    [self.state_root @ S[:, : self.n], self.input_root @ K1[:, size:]], axis=1
                )
                total += share * (r**2).sum(1)
                rows = (root * slopes).reshape(-1, p)
                gradient += 2 * share * rows.T @ (root[:, :, 0] * r).ravel()
                curvature += 2 * share * rows.T @ rows
                if index < self.steps:
                    k2, K2 = field(z + h / 2 * k1[:, :size], S + h / 2 * K1[:, :size])
                    k3, K3 = field(z + h / 2 * k2[:, :size], S + h / 2 * K2[:, :size])
                    k4, K4 = field(z + h * k3[:, :size], S + h * K3[:, :size])
                    z = z + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)[:, :size]
                    S = S + h / 6 * (K1 + 2 * K2 + 2 * K3 + K4)[:, :size]
            rows, left = (root * (self.end_root @ S[:, : self.n])).reshape(-1, p), self._left(z)
            gradient += 2 * rows.T @ (root[:, :, 0] * left).ravel()
            curvature += 2 * rows.T @ rows
        return Sums(total + (left**2).sum(1), gradient, curvature)

    def _share(self, index: int) -> float:
        return self.step * (0.5 if index in (0, self.steps) else 1.0)

    def _left(self, z: Vector) -> Vector:
        """Residuals of what follows the end."""
        return (z[:, : self.n] - self.plant.x_star) @ self.end_root.T

    def _residuals(self, z: Vector, u: Vector) -> Vector:
        away = (z[:, : self.n] - self.plant.x_star) @ self.state_root.T
        return np.concatenate([away, (u - self.plant.u_star) @ self.input_root.T], axis=1)


def _with_slopes(field: ca.Function, symbols: list[_Symbols]) -> ca.Function:
    """(z, θ) -> the field, and its slopes in z and in θ."""
    value = field(*symbols)
    by_z, by_theta = (ca.densify(ca.jacobian(value, v)) for v in symbols)
    return ca.Function("stage", symbols, [value, by_z, by_theta])


def _root(matrix: Vector) -> Vector:
    """W with WᵀW the matrix ⪰ 0, whatever the units of its rows."""
    scale = np.sqrt(np.diag(matrix))
    scale[scale == 0] = 1.0
    values, vectors = np.linalg.eigh(matrix / np.outer(scale, scale))
    return np.asarray(np.sqrt(np.fmax(values, 0.0))[:, None] * vectors.T * scale, float)
