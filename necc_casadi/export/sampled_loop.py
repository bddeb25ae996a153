"""The sampled loop at z̄: how long a sample may last.

Between samples u is held and the plant moves freely, so its part of the linearised step is exact:

    x⁺ = e^{AT} x + ∫₀ᵀ e^{As} ds G u,   u = u_x x + u_ξ ξ,   A = ∂((J − R)∇H + G ū)/∂x
    ξ⁺ = P(T f_ξ) ξ + T Q(T f_ξ) f_x x,  P(z) = Σ_{k≤s} z^k/k!,  Q(z) = Σ_{k<s} z^k/(k+1)!

with ξ̇ = f(x, ξ) advanced by a method of order s with x held; where Casimirs are kept, k = ξ − γ(x)
takes m steps of Euler's method at x⁺. Local: it says nothing about regions
(docs/theory.md#sampled-loop).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca
import numpy as np

from necc_casadi.arrays import Vector
from necc_casadi.cases import Integrator
from necc_casadi.designs.design import Design
from necc_casadi.export.kept_casimirs import kept_casimirs

__all__ = ["ORDERS", "SampledLoop", "analyse_sampling", "largest_stable_time", "spectral_radius"]


#: Methods that advance ξ over one sample, x held: name -> order.
ORDERS: dict[Integrator, int] = {"euler": 1, "heun": 2, "rk4": 4}


#: A spectral radius this close to 1 may be 1.
_ROUNDING = 1e-12


@dataclass(frozen=True)
class SampledLoop:
    """The sampled loop, linearised at z̄."""

    sample_time: float  # s
    spectral_radius: float  # below 1: locally asymptotically stable
    largest_stable: float | None  # s; None: no sample time was found stable, or none unstable
    warning: str | None


def analyse_sampling(
    design: Design, sample_time: float, integrator: Integrator = "heun"
) -> SampledLoop:
    """Spectral radius at `sample_time` (s), the largest stable one, a warning past half of it."""
    radius = spectral_radius(design, sample_time, integrator)
    largest = largest_stable_time(design, integrator)
    warning = None
    if abs(radius - 1) <= _ROUNDING:
        warning = (
            f"whether the sampled loop is stable at {sample_time:g} s is not known: its "
            "linearisation neither decays nor grows"
        )
    elif not radius < 1:
        warning = f"the sampled loop is not stable at {sample_time:g} s"
        warning += "" if largest is None else f": the largest stable sample time is {largest:.3g} s"
    elif largest is not None and sample_time > largest / 2:
        warning = (
            f"{sample_time:g} s is past half of the largest stable sample time {largest:.3g} s"
        )
    return SampledLoop(sample_time, radius, largest, warning)


def spectral_radius(design: Design, sample_time: float, integrator: Integrator = "heun") -> float:
    """Spectral radius of the sampled loop at z̄; `sample_time` in s."""
    return _radius(_linear_step(design, integrator)(sample_time / design.units.time))


def largest_stable_time(design: Design, integrator: Integrator = "heun") -> float | None:
    """The sample time (s) up to which the sampled loop is stable at z̄, to three digits.

    Found by a scan in steps of 5 % from a thousandth of the fastest time constant upwards, then
    by bisection. None where already the start is unstable, or nothing up to a thousand slowest
    time constants is.
    """
    step = _linear_step(design, integrator)
    rates = np.abs(design.natural.spectrum)
    time, end = 1e-3 / rates.max(), 1e3 / max(rates.min(), 1e-3 * rates.max())
    if not _radius(step(time)) < 1 - _ROUNDING:
        return None
    while _radius(step(1.05 * time)) < 1 - _ROUNDING:
        time *= 1.05
        if time > end:
            return None
    low, high = time, 1.05 * time
    while high - low > 1e-4 * low:
        middle = (low + high) / 2
        low, high = (middle, high) if _radius(step(middle)) < 1 else (low, middle)
    return float(low * design.units.time)


def _linear_parts(design: Design) -> tuple[Vector, ...]:
    """A (n × n), G (n × m), u_x, u_ξ, f_x, f_ξ at z̄ and its holding input, natural units."""
    design = design.natural
    terms, law = design.lyapunov.terms, design.controller
    kept = terms.nc + (0 if design.integral is None else terms.m)
    x, xi, u = (ca.MX.sym(s, k) for s, k in (("x", terms.n), ("xi", kept), ("u", terms.m)))
    law_u, law_f = law.call([x, xi])
    plant = terms.drift(x) + terms.directions(x) @ u
    jacobians = [ca.jacobian(plant, x), terms.directions(x)]
    jacobians += [ca.jacobian(f, s) for f in (law_u, law_f) for s in (x, xi)]
    z = np.concatenate([design.stored_z_bar, np.zeros(kept - terms.nc)])
    x_bar, xi_bar = z[: terms.n], z[terms.n :]
    u_bar = law.call([x_bar, xi_bar])[0]
    values = ca.Function("parts", [x, xi, u], jacobians).call([x_bar, xi_bar, u_bar])
    return tuple(np.asarray(value, dtype=float) for value in values)


def _radius(step: Vector) -> float:
    return float(np.abs(np.linalg.eigvals(step)).max())


def _linear_step(design: Design, integrator: Integrator) -> Callable[[float], Vector]:
    """Period, natural units -> the linearised sample of (x, what the controller keeps)."""
    parts = _linear_parts(design)
    if integrator != "casimir":
        return lambda time: _held_step(parts, time, ORDERS[integrator])
    kept, x_bar = kept_casimirs(design.natural), design.natural.z_bar[: design.loop.plant.n]
    x = ca.MX.sym("x", len(x_bar))
    slope = ca.Function("slope", [x], [ca.jacobian(ca.densify(kept.gamma(x)), x)])
    gamma_x = np.asarray(slope(x_bar), float)
    return lambda time: _kept_step(parts, time, gamma_x, kept.steps(time))


def _plant_step(parts: tuple[Vector, ...], time: float) -> tuple[Vector, Vector]:
    """e^{AT} and ∫₀ᵀ e^{As} ds G."""
    A, G = parts[:2]
    n, m = G.shape
    held = _exponential(time * np.block([[A, G], [np.zeros((m, n + m))]]))
    return held[:n, :n], held[:n, n:]


def _held_step(parts: tuple[Vector, ...], time: float, order: int) -> Vector:
    """ξ advances with x held."""
    _, _, u_x, u_xi, f_x, f_xi = parts
    free, forced = _plant_step(parts, time)
    powers = [np.linalg.matrix_power(time * f_xi, k) for k in range(order + 1)]
    P = sum(power / math.factorial(k) for k, power in enumerate(powers))
    Q = sum(power / math.factorial(k + 1) for k, power in enumerate(powers[:-1]))
    return np.block([[free + forced @ u_x, forced @ u_xi], [time * Q @ f_x, P]])


def _kept_step(parts: tuple[Vector, ...], time: float, gamma_x: Vector, steps: int) -> Vector:
    """Of (x, k, ζ): ξ = γ(x) + k, and γ̇ = γ_x ẋ has no part in the rate of k."""
    A, _, u_x, u_xi, f_x, f_xi = parts
    nc, n = gamma_x.shape
    free, forced = _plant_step(parts, time)
    along = free + forced @ (u_x + u_xi[:, :nc] @ gamma_x)
    x_next = np.hstack([along, forced @ u_xi])
    one = np.eye(nc) + time / steps * f_xi[:nc, :nc]
    powers = [np.linalg.matrix_power(one, j) for j in range(steps + 1)]
    pull = f_x[:nc] - gamma_x @ A + f_xi[:nc, :nc] @ gamma_x
    k_next = time / steps * sum(powers[:-1]) @ pull @ x_next
    k_next[:, n : n + nc] += powers[-1]
    zeta_next = np.hstack([time * f_x[nc:], np.zeros((len(f_x) - nc, nc)), np.eye(len(f_x) - nc)])
    return np.vstack([x_next, k_next, zeta_next])


def _exponential(matrix: Vector) -> Vector:
    """e^matrix by scaling and squaring, Taylor to degree 18 on norm ≤ 1/2 (error below 1e-20)."""
    halvings = max(0, math.frexp(float(np.abs(matrix).sum(axis=1).max()))[1] + 1)
    scaled = matrix / 2**halvings
    result = term = np.eye(len(matrix))
    for k in range(1, 19):
        term = term @ scaled / k
        result = result + term
    for _ in range(halvings):
        result = result @ result
    return result
