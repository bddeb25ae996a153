"""The pendulum without networks: a closed-form quadratic design, and closed-loop metrics for any.

With Φ = H + Hc + C, two quadratics K and Hc meet the local conditions of Lemma 1 exactly, so they
are the design that networks have to beat on region, transient and effort.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

__all__ = ["LoopMetrics", "QuadraticDesign", "closed_loop_metrics", "least_curvature", "quadratic"]

Vector = npt.NDArray[np.float64]
Law = Callable[[Vector, Vector], npt.ArrayLike]  # (x (2,), ξ (nc,)) -> one vector

SETTLED = 0.02  # share of the initial ‖z − z*‖ that counts as settled
SAMPLES = 20_001  # instants at which a trajectory is looked at; the integrator picks its own steps


@dataclass(frozen=True)
class QuadraticDesign:
    """V = H + Hc + K(q − ξ) with quadratic K and Hc, and the control law of Lemma 1."""

    q_star: float  # rad
    xi_star: float
    curvature: float  # k = K'' = Hc'', everywhere
    damping: float  # D
    controller_damping: float  # Dc

    def V(self, x: Vector, xi: Vector) -> float:
        """V at x = (q, p), ξ = (ξ,); zero at z* up to the constant 1 − cos q*."""
        q, p = x
        slope, k = -math.sin(self.q_star), self.curvature
        offsets = np.array([q - xi[0] - (self.q_star - self.xi_star), xi[0] - self.xi_star])
        return float(p * p / 2 + 1 - math.cos(q) + np.sum(slope * offsets + k / 2 * offsets**2))

    def control(self, x: Vector, xi: Vector) -> Vector:
        """u = −∂Hc/∂ξ − D ∂V/∂p, (1,)."""
        return np.array([-self._hc_slope(xi) - self.damping * x[1]])

    def xi_dot(self, x: Vector, xi: Vector) -> Vector:
        """ξ̇ = ∂H/∂p − Dc ∂V/∂ξ, (1,)."""
        slope = self._hc_slope(xi) - self._k_slope(x[0] - xi[0])
        return np.array([x[1] - self.controller_damping * slope])

    def _k_slope(self, s: float) -> float:
        return -math.sin(self.q_star) + self.curvature * (s - (self.q_star - self.xi_star))

    def _hc_slope(self, xi: Vector) -> float:
        return float(-math.sin(self.q_star) + self.curvature * (xi[0] - self.xi_star))


def least_curvature(q_star: float, a: float) -> float:
    """The smallest k = K'' = Hc'' with λ_min(∇²V(z*)) ≥ a.

    In (q, ξ), ∇²V − aI = [[d + k, −k], [−k, 2k − a]] with d = cos q* − a; it grows with k, and its
    determinant k² + (2d − a)k − ad has its larger root where the least eigenvalue crosses zero.
    The momentum contributes the eigenvalue 1, which no K or Hc can move.

    Raises
    ------
    ValueError
        Where a is not in (0, 1].
    """
    if not 0 < a <= 1:
        raise ValueError(f"a = {a}: must lie in (0, 1], because ∂²V/∂p² = 1")
    d = math.cos(q_star) - a
    return (a - 2 * d + math.sqrt(4 * d * d + a * a)) / 2


def quadratic(
    q_star: float = math.pi / 4,
    *,
    a: float = 0.5,
    xi_star: float = 0.0,
    damping: float = 5.0,
    controller_damping: float = 6.0,
    curvature: float | None = None,
) -> QuadraticDesign:
    """The quadratic design with K'(s*) = Hc'(ξ*) = −sin q*, paper's a, D and Dc by default.

    `curvature` replaces the least one, and `a` is then unused; above 2, ∇²V ≻ 0 everywhere and
    the loop is globally asymptotically stable.
    """
    k = least_curvature(q_star, a) if curvature is None else curvature
    return QuadraticDesign(q_star, xi_star, k, damping, controller_damping)


@dataclass(frozen=True)
class LoopMetrics:
    """One closed-loop trajectory z(t) = (q, p, ξ), 0 ≤ t ≤ horizon, against z* = (q*, 0, ξ*)."""

    settling_time: float  # last t with ‖z(t) − z*‖ > 2 % of ‖z(0) − z*‖; inf: still so at the end
    peak_input: float  # max |u(t)|
    input_energy: float  # ∫ u² dt over the horizon: grows with it, as u* = sin q* holds the target
    excess_energy: float  # ∫ (u − u*)² dt over the horizon: what the transient costs


def closed_loop_metrics(
    control: Law,
    xi_dot: Law,
    xi_star: npt.ArrayLike,
    q_star: float,
    x0s: Sequence[npt.ArrayLike],
    xi0s: Sequence[npt.ArrayLike],
    horizon: float,
) -> list[LoopMetrics]:
    """Simulate the pendulum from every (x0, xi0) under u = control(x, ξ), ξ̇ = xi_dot(x, ξ).

    DOP853 with rtol 1e-9 and atol 1e-12; the integrals are states of the same integration. The
    settling time is refined to rounding between samples, the peak is the largest sample: samples
    are horizon / 20 000 apart, and an excursion shorter than that can be missed.

    Raises
    ------
    ValueError
        Where a trajectory starts at z*, which leaves its settling time undefined.
    RuntimeError
        Where the integrator gives up.
    """
    z_star = np.concatenate([[q_star, 0.0], _flat(xi_star)])
    return [
        _metrics(control, xi_dot, z_star, np.concatenate([_flat(x0), _flat(xi0)]), horizon)
        for x0, xi0 in zip(x0s, xi0s, strict=True)
    ]


def _flat(value: npt.ArrayLike) -> Vector:
    """One vector, also from a CasADi column or a plain number."""
    return np.asarray(value, dtype=float).ravel()


def _metrics(control: Law, xi_dot: Law, z_star: Vector, z0: Vector, horizon: float) -> LoopMetrics:
    u_star = math.sin(z_star[0])

    def u_of(z: Vector) -> float:
        return float(_flat(control(z[:2], z[2:]))[0])

    def field(_: float, s: Vector) -> Vector:  # s = (z, ∫u², ∫(u − u*)²)
        z = s[:-2]
        u, rate = u_of(z), _flat(xi_dot(z[:2], z[2:]))
        return np.array([z[1], u - math.sin(z[0]), *rate, u * u, (u - u_star) ** 2])

    solution = solve_ivp(
        field, (0, horizon), [*z0, 0, 0], "DOP853", dense_output=True, rtol=1e-9, atol=1e-12
    )
    if not solution.success:
        raise RuntimeError(f"integration stopped at t = {solution.t[-1]:.6g}: {solution.message}")

    times = np.linspace(0, horizon, SAMPLES)
    states = solution.sol(times)[:-2].T  # SAMPLES × (2 + nc)
    return LoopMetrics(
        settling_time=_settling_time(lambda t: solution.sol(t)[:-2], states, times, z_star),
        peak_input=max(abs(u_of(z)) for z in states),
        input_energy=float(solution.y[-2, -1]),
        excess_energy=float(solution.y[-1, -1]),
    )


def _settling_time(
    state: Callable[[float], Vector], states: Vector, times: Vector, z_star: Vector
) -> float:
    distances = np.linalg.norm(states - z_star, axis=1)
    if distances[0] == 0:
        raise ValueError("the trajectory starts at z*: its settling time is undefined")
    threshold = SETTLED * distances[0]
    last = int(np.flatnonzero(distances > threshold)[-1])
    if last == len(times) - 1:
        return math.inf

    def surplus(t: float) -> float:
        return float(np.linalg.norm(state(t) - z_star) - threshold)

    return float(brentq(surplus, times[last], times[last + 1]))
