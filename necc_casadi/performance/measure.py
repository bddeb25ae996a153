"""Measures of a design: its responses beside those of LQR and the optimum, and its margins."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from necc_casadi.arrays import Vector
from necc_casadi.designs.design import Design
from necc_casadi.model.control_affine import Equilibria
from necc_casadi.model.cost import QuadraticCost, bryson
from necc_casadi.performance.closed_loop_cost import (
    Responses,
    design_feedback,
    lqr_feedback,
    responses,
)
from necc_casadi.performance.margins import Margins, Sweep, margins, one_input
from necc_casadi.performance.optimum import Optimal, optimal_responses
from necc_casadi.performance.plant_model import PlantModel, plant_model
from necc_casadi.performance.starts import decay_time, random_starts, settled_in
from necc_casadi.performance.steady_error import disturbed_error, parameter_errors

__all__ = [
    "Curve",
    "Errors",
    "Loop",
    "Performance",
    "Rating",
    "measure",
]


#: Starts that a design is measured from, and the matched disturbance as a share of an input's size.
STARTS, DISTURBANCE = 20, 0.1


@dataclass(frozen=True, eq=False)
class Rating:
    """Of one controller; inputs in the units of the model, times in its unit of time.

    Costs are geometric means over the starts from which both controllers reach the target.
    """

    settling_time: float | None  # s, median of the starts that arrive
    overshoot: float | None  # share of the first distance, median likewise
    peak_u: Vector | None  # (m,) largest |u| of the starts that arrive, within the limits
    peak_demand: Vector | None  # (m,) the same of what the controller asked for
    converging_share: float
    cost_to_optimum: float | None
    worst_to_optimum: float | None
    margins: Margins | None  # of a loop that is stable at z̄; none of the optimum, which is open


@dataclass(frozen=True, eq=False)
class Curve:
    """The response of one controller to a step of the set-point, in the units of the model."""

    name: str
    t: Vector  # (points,) s
    x: Vector  # (points, n)
    u: Vector  # (points, m)


@dataclass(frozen=True, eq=False)
class Loop:
    """One loop, opened at each input in turn; frequencies in the model's unit of time."""

    name: str
    inputs: tuple[Sweep, ...]  # (m,)
    margins: Margins


@dataclass(frozen=True, eq=False)
class Errors:
    """|x − x*| at rest, (n,) each, in the units of the model; None: not known to stay."""

    disturbance: Vector | None  # largest over the inputs and both signs
    parameters: Mapping[str, Vector | None]  # by name, each 10 % larger


@dataclass(frozen=True, eq=False)
class Performance:
    """A design beside LQR and the least cost from the same starts."""

    design: Rating
    lqr: Rating | None  # None: LQR does not stabilise the plant
    optimum: Rating | None  # None: not asked for, or nothing follows the horizon
    cost_to_lqr: float | None
    errors: Errors
    starts: int
    step: tuple[Curve, ...] = field(default=(), repr=False)  # from one size below the target
    loops: tuple[Loop, ...] = field(default=(), repr=False)


def measure(
    design: Design,
    *,
    cost: QuadraticCost | None = None,
    starts: Sequence[Vector] | None = None,
    optimum: bool = True,
    seed: int = 1,
    others: Mapping[str, Equilibria] | None = None,
) -> Performance:
    """Measure a design from random starts, inputs within the limits of the model.

    Parameters
    ----------
    design
        The design.
    cost
        Weights in the units of the model; Bryson's rule by default.
    starts
        Plant states (n,); 20 of the domain by default.
    optimum
        Whether to compute the least cost from each start, 10–100 ms each.
    seed
        Of the random starts.
    others
        Other plants to hold at the target, by the name of what is changed.
    """
    cost = bryson(design.sizes, design.loop.plant.n) if cost is None else cost
    starts = random_starts(design, STARTS, seed) if starts is None else list(starts)
    plant = plant_model(design, cost)
    natural_starts = [s / design.units.state[: plant.n] for s in (*starts, step_start(design))]
    horizon = _horizon(design, plant)
    ours = responses(plant, design_feedback(design), natural_starts, horizon)
    linear = lqr_feedback(plant)
    theirs = None if linear is None else responses(plant, linear, natural_starts, horizon)
    known = [r for r in (ours, theirs) if r is not None]
    least = None
    if optimum and linear is not None:
        least = _as_responses(optimal_responses(plant, natural_starts, known), ours)
    mine, lqr_loop = _loop(design), _lqr_loop(design, plant)
    lqr_margins = None if lqr_loop is None else lqr_loop.margins
    shown = {"this design": ours, "LQR": theirs, "optimum": least}
    return Performance(
        design=_rating(design, ours, least, None if mine is None else mine.margins),
        lqr=None if theirs is None else _rating(design, theirs, least, lqr_margins),
        optimum=None if least is None else _rating(design, least, least, None),
        cost_to_lqr=None if theirs is None else _mean_ratio(ours.cost[:-1], theirs.cost[:-1]),
        errors=_errors(design, others or {}),
        starts=len(starts),
        step=tuple(_curve(n, r, design) for n, r in shown.items() if r is not None),
        loops=tuple(loop for loop in (mine, lqr_loop) if loop is not None),
    )


def step_start(design: Design) -> Vector:
    """A step of the set-point: one size below the target in every state but momenta, (n,)."""
    n = design.loop.plant.n
    away = np.array([0.0 if i in design.momenta else design.sizes.state[i] for i in range(n)])
    x = design.z_star[:n]
    below = x - away
    return np.asarray(
        np.where(below >= design.domain.lo[:n], below, (x + design.domain.lo[:n]) / 2)
    )


def _as_responses(found: Sequence[Optimal | None], like: Responses) -> Responses:
    """Responses of least cost on the times of others."""
    x, u = np.full_like(like.x, np.nan), np.full_like(like.u, np.nan)
    costs = np.full(len(found), np.inf)
    for index, best in enumerate(found):
        if best is None:
            continue
        costs[index] = best.cost
        t = np.concatenate([[0.0], best.t])
        states = np.vstack([like.x[index, 0], best.x])
        inputs = np.vstack([best.u[0], best.u])
        x[index] = np.column_stack([np.interp(like.t, t, row) for row in states.T])
        u[index] = np.column_stack([np.interp(like.t, t, row) for row in inputs.T])
    found_responses = replace(like, x=x, u=u, demand=u, cost=costs)
    return replace(found_responses, cost=np.where(found_responses.near, costs, np.inf))


def _rating(
    design: Design, found: Responses, least: Responses | None, found_margins: Margins | None
) -> Rating:
    """Of all starts but the last, which is the step."""
    arrived, units = found.arrived[:-1], design.units
    best = None if least is None else least.cost[:-1]

    def peaks(of: Vector) -> Vector | None:
        return of[:-1][arrived].max(axis=0) * units.input if arrived.any() else None

    return Rating(
        settling_time=_median(found.settling_times[:-1][arrived] * units.time),
        overshoot=_median(found.overshoots[:-1][arrived]),
        peak_u=peaks(found.peak_inputs),
        peak_demand=peaks(found.peak_demands),
        converging_share=float(arrived.mean()),
        cost_to_optimum=_mean_ratio(found.cost[:-1], best),
        worst_to_optimum=_worst_ratio(found.cost[:-1], best),
        margins=found_margins,
    )


def _curve(name: str, found: Responses, design: Design) -> Curve:
    units, n = design.units, design.loop.plant.n
    return Curve(
        name, found.t * units.time, found.x[-1] * units.state[:n], found.u[-1] * units.input
    )


def _errors(design: Design, others: Mapping[str, Equilibria]) -> Errors:
    pushed = disturbed_error(design, DISTURBANCE)
    size = design.sizes.state[: design.loop.plant.n]
    return Errors(None if pushed is None else pushed * size, parameter_errors(design, others))


def _loop(design: Design) -> Loop | None:
    """Of a design that is stable at z̄."""
    A, B, C, _ = design.loop_transfer()
    return _opened("this design", A, B, C) if design.decays else None


def _lqr_loop(design: Design, plant: PlantModel) -> Loop | None:
    linear = plant.linear
    if linear is None:  # L is the same in natural units of states and inputs, but not of time
        return None
    time = design.units.time
    return _opened("LQR", linear.A / time, linear.B / time, linear.K)


def _opened(name: str, A: Vector, B: Vector, C: Vector) -> Loop:
    inputs = tuple(one_input(A, B, C, i) for i in range(B.shape[1]))
    return Loop(name, inputs, margins(A, B, C))


def _horizon(design: Design, plant: PlantModel) -> float:
    """Long enough for the slowest mode of either controller, in natural time."""
    ours = decay_time(design)
    return ours if plant.linear is None else max(ours, settled_in(plant.linear.spectrum))


def _median(values: Vector) -> float | None:
    return float(np.median(values)) if values.size else None


def _ratios(costs: Vector, others: Vector | None) -> Vector:
    if others is None:
        return np.zeros(0)
    both = np.isfinite(costs) & np.isfinite(others) & (others > 0)
    return np.asarray(costs[both] / others[both], float)


def _mean_ratio(costs: Vector, others: Vector | None) -> float | None:
    ratios = _ratios(costs, others)
    return float(np.exp(np.mean(np.log(ratios)))) if ratios.size else None


def _worst_ratio(costs: Vector, others: Vector | None) -> float | None:
    ratios = _ratios(costs, others)
    return float(ratios.max()) if ratios.size else None
