"""Where ξ should start: at ξ*, along with x(0), or at the minimum of V(x(0), ·).

Along with x(0) it starts at ξ* + T(x(0) − x*), T the one of least cost of the linearised loop. What
is better is measured, not proved.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from necc_casadi.arrays import Truth, Vector
from necc_casadi.cases import InitialXi
from necc_casadi.designs.design import Design
from necc_casadi.designs.initial import least_over_xi
from necc_casadi.model.cost import QuadraticCost
from necc_casadi.performance.closed_loop_cost import design_feedback, responses
from necc_casadi.performance.plant_model import plant_model
from necc_casadi.performance.starts import decay_time, random_starts

__all__ = ["start_gain", "with_better_start", "with_start"]


#: Starts that the choice rests on, others than those that a design is measured from.
_STARTS, _SEED = 20, 2


#: Loops of more states are not simulated for the choice: it would take longer than the design.
_MANY_STATES = 16


#: From so few starts nothing can be told where the mean cost is lower by less than this share, or
#: as few more arrive.
_GAIN, _FEW_MORE = 0.03, 1


#: Power of the ratios of costs: the worst starts count most.
_POWER = 2


#: Directions of ξ that cost less than this share of the dearest cost nothing: T leaves them alone.
_FREE = 1e-9


def start_gain(P: Vector, n: int) -> Vector:
    """T of the least zᵀPz with ξ − ξ* = T(x − x*), (nc, n).

    Parameters
    ----------
    P
        Cost of the linearised loop, (n + nc, n + nc), states in their sizes.
    n
        States of the plant.
    """
    return -np.asarray(np.linalg.pinv(P[n:, n:], rcond=_FREE, hermitian=True) @ P[n:, :n], float)


def with_better_start(design: Design, cost: QuadraticCost) -> Design:
    """The design with the ξ(0) that costs least over the starts.

    ξ* needs no computing, so it stays unless more of the starts arrive with another ξ(0), or they
    cost less by more than the starts can tell; then ξ* + T(x(0) − x*), in the same way. The minimum
    of V(x(0), ·) is left out where Newton's method does not find it. In loops of many states ξ*
    stays. Inputs keep to the limits of the model, and no ξ(0) is taken that asks for more from more
    starts than ξ* does.
    """
    if len(design.z_star) > _MANY_STATES or not design.decays:
        return design
    plant = plant_model(design, cost)
    starts = [
        start / design.units.state[: plant.n] for start in random_starts(design, _STARTS, _SEED)
    ]
    words: tuple[InitialXi, ...] = ("target", "linear", "minimum")
    tried = [with_start(design, cost, word) for word in words]
    natural = design.natural
    if not all(least_over_xi(natural.lyapunov, natural, start)[1] for start in starts):
        tried.pop()
    V = natural.lyapunov
    kept = [V.stored(x, made.natural.xi_at_state(x)) for made in tried for x in starts]
    count = len(tried)
    found = responses(plant, design_feedback(design), starts * count, decay_time(design), kept)
    arrived, paid = found.arrived.reshape(count, -1), found.cost.reshape(count, -1)
    beyond = (found.demand < plant.u_low) | (found.demand > plant.u_high)
    clipped = beyond.any(axis=(1, 2)).reshape(count, -1).sum(1)
    best = 0
    for other in range(1, count):
        if clipped[other] > clipped[0]:
            continue
        if _is_better(arrived[other], paid[other], arrived[best], paid[best]):
            best = other
    return tried[best]


def with_start(design: Design, cost: QuadraticCost, word: InitialXi) -> Design:
    """The design with this ξ(0); T is the one that it has, else that of least linear cost."""
    gain = None
    if word == "linear":
        gain = _gain(design, cost) if design.initial_gain is None else design.initial_gain
    return replace(design, initial_xi=word, initial_gain=gain)


def _gain(design: Design, cost: QuadraticCost) -> Vector:
    """T of the linearised loop at z̄, three digits, in the units of the model."""
    from scipy.linalg import solve_continuous_lyapunov  # slow to import, and few runs need it

    A, B, C, _ = design.natural.loop_transfer()
    n, size = design.loop.plant.n, design.natural.sizes.state
    weights = cost.measured_in(design.units)
    W = C.T @ weights.R @ C
    W[:n, :n] += weights.Q
    closed = (A - B @ C) * size / size[:, None]
    P = solve_continuous_lyapunov(closed.T, -W * np.outer(size, size))
    T = start_gain((P + P.T) / 2, n) * size[n:, None] / size[:n]
    rounded = np.array([[float(f"{v:.3g}") for v in row] for row in T])  # natural: no unit shows
    return np.asarray(rounded * design.units.state[n:, None] / design.units.state[:n], float)


def _is_better(arrived: Truth, cost: Vector, before: Truth, cost_before: Vector) -> bool:
    more = int(arrived.sum()) - int(before.sum())
    if abs(more) > _FEW_MORE:
        return more > 0
    both = arrived & before
    if not both.any():
        return False
    least = np.fmin(cost[both], cost_before[both])
    now, then = (np.mean((paid[both] / least) ** _POWER) for paid in (cost, cost_before))
    return bool(now < then * (1 - _GAIN) ** _POWER)
