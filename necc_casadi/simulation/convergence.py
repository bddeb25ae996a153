"""Many responses at once: from which states the loop converges."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np
import numpy.typing as npt

from necc_casadi.arrays import Vector
from necc_casadi.designs.design import Design
from necc_casadi.interrupts import interruptible
from necc_casadi.simulation.responses import default_horizon
from necc_casadi.simulation.saturated import saturated_field

__all__ = [
    "Arrivals",
    "Step",
    "bogacki_shampine",
    "converging",
    "rosenbrock",
    "simulated_share",
    "stepper",
]


#: States at the start, ż there and lengths of the step -> the end, ż there, and the error.
Step = Callable[[Vector, Vector, Vector], tuple[Vector, Vector, Vector]]


#: An explicit step is stable up to this multiple of the shortest time constant.
_EXPLICIT = 2.5


#: Many starts at once: one that comes this close, as a share of its first distance, converges.
_ARRIVED = 0.01


#: One that gets this many times as far from z̄ as the domain reaches does not.
_LOST = 50.0


#: Horizons that it may take: far from z̄ the linearisation says little about time.
_PATIENCE = 4.0


#: Errors are relative to a state's magnitude, or to this where it is smaller, in natural units.
_SMALL_STATE = 0.01


#: Steps per start at most, for up to so many states and fewer for more; the shortest step.
_MOST_STEPS, _FEW_STATES, _LEAST_STEP = 4000, 8, 1e-7


#: Random states that a simulated share rests on, and at least for loops with many states.
_SAMPLES, _FEWEST_SAMPLES = 200, 20


@dataclass(frozen=True, eq=False)
class Arrivals:
    """Which of many starts reach z̄."""

    arrived: npt.NDArray[np.bool_]  # (B,) came to within 1 % of the first distance
    unfinished: npt.NDArray[np.bool_]  # (B,) ran out of steps, or creep: not known


def converging(design: Design, starts: npt.ArrayLike, *, tolerance: float = 1e-4) -> Arrivals:
    """Whether the loop comes near z̄ within some default horizons, from states (B, n + nc).

    Where z̄ may attract though a mode of the linearisation does not decay, no horizon tells.
    Inputs stay within the limits of the model.
    All states at once, each with its own step; distances and errors in natural units.
    """
    units, design = design.units, design.natural
    horizon, z_bar = _PATIENCE * default_horizon(design), design.z_bar
    z, size = np.array(starts, float) / units.state, design.sizes.state
    if design.integral is not None:  # ζ starts at 0, where it ends on the plant of the model
        z = np.hstack([z, np.zeros((len(z), design.loop.plant.m))])
        z_bar = np.concatenate([z_bar, np.zeros(design.loop.plant.m)])
        size = np.concatenate([size, design.sizes.input])
    reach = (design.domain.hi - design.domain.lo) / design.sizes.state
    lost = _LOST * float(np.linalg.norm(reach))
    near = _ARRIVED * np.linalg.norm((z - z_bar) / size, axis=1)
    arrived = near == 0
    alive = np.flatnonzero(~arrived)
    t, h = np.zeros(len(z)), np.full(len(z), horizon / 1000)
    ode = saturated_field(design)
    late = np.zeros(len(z), dtype=bool)

    most = _MOST_STEPS * _FEW_STATES // max(_FEW_STATES, z.shape[1])
    take = stepper(ode, z_bar, horizon / most)
    slope = np.asarray(ode(z.T), float).T
    for _ in range(most):
        if alive.size == 0:
            break
        with interruptible(), np.errstate(all="ignore"):
            step, start = np.minimum(h[alive], horizon - t[alive]), z[alive]
            end, end_slope, difference = take(start, slope[alive], step)
            scale = tolerance * (_SMALL_STATE + np.fmax(np.abs(start), np.abs(end)))
            error = np.abs(difference / scale).max(axis=1)
            good = error <= 1
            moved = alive[good]
            z[moved], slope[moved] = end[good], end_slope[good]
            t[moved] += step[good]
            growth = np.clip(0.9 * np.fmax(error, 1e-9) ** (-1 / 3), 0.2, 5.0)
            h[alive] = step * np.where(np.isfinite(error), growth, 0.2)
            distance = np.linalg.norm((z[alive] - z_bar) / size, axis=1)
        arrived[alive] = distance <= near[alive]
        short = (h[alive] < _LEAST_STEP * horizon) & ~good
        in_time, stays = t[alive] < horizon * (1 - 1e-9), (distance < lost) & ~short
        late[alive] = stays & ~in_time & ~arrived[alive]
        alive = alive[in_time & stays & ~arrived[alive]]
    unfinished = late if design.creeps else np.zeros(len(z), dtype=bool)
    unfinished[alive] = True
    return Arrivals(arrived, unfinished)


def bogacki_shampine(
    field: Callable[[Vector], Vector], z: Vector, slope: Vector, h: Vector
) -> tuple[Vector, Vector, Vector]:
    """One explicit Runge–Kutta step of order 3 with an embedded one of order 2.

    Its last slope is the first one of the next step, so that a step costs three evaluations.

    Parameters
    ----------
    field
        States (B, N) -> ż (B, N).
    z, slope
        States at the start and ż there, (B, N).
    h
        Length of the step of each state, (B,).

    Returns
    -------
    end, slope, difference
        States after the step and ż there, and the solution of order 3 less that of order 2, an
        estimate of the error; (B, N) each.

    References
    ----------
    Bogacki and Shampine (1989).
    """
    h, k1 = h[:, None], slope
    k2 = field(z + h * k1 / 2)
    k3 = field(z + 3 * h * k2 / 4)
    end = z + h * (2 * k1 + 3 * k2 + 4 * k3) / 9
    k4 = field(end)
    return end, k4, h * (-5 * k1 / 72 + k2 / 12 + k3 / 9 - k4 / 8)


def rosenbrock(
    field: Callable[[Vector], Vector],
    jacobian: Callable[[Vector], Vector],
    z: Vector,
    slope: Vector,
    h: Vector,
) -> tuple[Vector, Vector, Vector]:
    """One linearly implicit step of order 2, L-stable, with an estimate of its error.

    For loops with modes that are over long before the others, such as the current of a winding.

    Parameters
    ----------
    field, z, slope, h
        As for :func:`bogacki_shampine`.
    jacobian
        States (B, N) -> ∂ż/∂z (B, N, N).

    Returns
    -------
    end, slope, difference
        As for :func:`bogacki_shampine`; what cannot be solved for is nan.

    References
    ----------
    Shampine and Reichelt (1997).
    """
    step, d, e = h[:, None], 1 / (2 + np.sqrt(2)), 6 + np.sqrt(2)
    W = np.eye(z.shape[1]) - d * h[:, None, None] * jacobian(z)
    try:
        inverse = np.linalg.inv(W)
    except np.linalg.LinAlgError:
        inverse = np.full_like(W, np.nan)

    def solved(right: Vector) -> Vector:
        return np.asarray(np.einsum("bij,bj->bi", inverse, right), float)

    k1 = solved(slope)
    middle = field(z + step * k1 / 2)
    k2 = solved(middle - k1) + k1
    end = z + step * k2
    last = field(end)
    k3 = solved(last - e * (k2 - middle) - 2 * (k1 - slope))
    return end, last, step * (k1 - 2 * k2 + k3) / 6


def stepper(ode: ca.Function, z_bar: Vector, mean: float) -> Step:
    """Steps that are explicit, but where those that are stable at z̄ are shorter than `mean`.

    `ode` has the states (N,) as its argument and ż as its first result.
    """
    n = len(z_bar)
    z = ca.MX.sym("z", n)
    slopes = ode.call([z])[0]
    derivative = ca.Function("jacobian", [z], [ca.jacobian(slopes, z)])

    def field(states: Vector) -> Vector:
        return np.asarray(ode.call([states.T])[0], float).T

    def jacobian(states: Vector) -> Vector:
        flat = np.asarray(ca.DM(derivative(states.T)), float)
        return flat.reshape(n, len(states), n).transpose(1, 0, 2)

    there = jacobian(z_bar[None])[0]
    finite = np.isfinite(there).all()
    fastest = float(np.abs(np.linalg.eigvals(there)).max()) if finite else 0.0
    if fastest * mean > _EXPLICIT:
        return lambda z, slope, h: rosenbrock(field, jacobian, z, slope, h)
    return lambda z, slope, h: bogacki_shampine(field, z, slope, h)


def simulated_share(design: Design, resting: Sequence[int], seed: int = 0) -> float | None:
    """Share of random states of the domain from which the loop converges; None: not known.

    The plant states `resting` start at 0, as a certificate's share of the domain has them.
    """
    lo, hi = design.domain.lo, design.domain.hi
    count = max(_FEWEST_SAMPLES, int(_SAMPLES * min(1.0, (_FEW_STATES / lo.size) ** 2)))
    starts = np.random.default_rng(seed).uniform(lo, hi, (count, lo.size))
    starts[:, list(resting)] = 0.0
    found = converging(design, starts)
    return None if found.unfinished.any() else float(found.arrived.mean())
