"""Measures of a design: its responses beside those of LQR and the optimum, and its margins."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from necc_casadi.arrays import Vector
from necc_casadi.designs.design import Design
from necc_casadi.model.cost import QuadraticCost, bryson
from necc_casadi.performance.closed_loop_cost import (
    design_feedback,
    lqr_feedback,
    responses,
)
from necc_casadi.performance.margins import Margins, margins
from necc_casadi.performance.optimum import optimal_costs
from necc_casadi.performance.plant_model import PlantModel, plant_model

__all__ = ["Performance", "measure", "random_starts"]


#: Modes that decay more slowly than this share of the fastest are not waited for.
_DECAYS = 1e-4


#: The slowest mode has this many time constants to settle.
_CONSTANTS = 10.0


@dataclass(frozen=True, eq=False)
class Performance:
    """What was measured; inputs in the units of the model, times in its unit of time.

    Costs are geometric means over the starts from which both controllers reach the target.
    """

    settling_time: float | None  # s, median of the starts that arrive
    overshoot: float | None  # share of the first distance, median likewise
    peak_u: Vector | None  # (m,) largest |u| of the starts that arrive
    converging_share: float
    cost_to_lqr: float | None
    cost_to_optimum: float | None
    worst_to_optimum: float | None
    lqr_to_optimum: float | None
    lqr_worst: float | None
    margins: Margins | None  # of a loop that is stable at z̄


def random_starts(design: Design, count: int, seed: int) -> list[Vector]:
    """Plant states drawn uniformly from the domain, (n,) each, in the units of the model."""
    n, rng = design.loop.plant.n, np.random.default_rng(seed)
    lo, hi = design.domain.lo[:n], design.domain.hi[:n]
    return list(rng.uniform(lo, hi, (count, n)))


def measure(
    design: Design,
    *,
    cost: QuadraticCost | None = None,
    starts: Sequence[Vector] | None = None,
    optimum: bool = True,
    seed: int = 1,
) -> Performance:
    """Measure a design from random starts.

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
    """
    cost = bryson(design.sizes, design.loop.plant.n) if cost is None else cost
    starts = random_starts(design, 20, seed) if starts is None else list(starts)
    plant = plant_model(design, cost)
    natural_starts = [start / design.units.state[: plant.n] for start in starts]
    horizon = _horizon(design, plant)
    ours = responses(plant, design_feedback(design), natural_starts, horizon)
    linear = lqr_feedback(plant)
    theirs = None if linear is None else responses(plant, linear, natural_starts, horizon)
    known = [r for r in (ours, theirs) if r is not None]
    least = optimal_costs(plant, natural_starts, known) if optimum and linear is not None else None
    arrived = ours.arrived
    units = design.units
    return Performance(
        settling_time=_median(ours.settling_times[arrived] * units.time),
        overshoot=_median(ours.overshoots[arrived]),
        peak_u=ours.peak_inputs[arrived].max(axis=0) * units.input if arrived.any() else None,
        converging_share=float(arrived.mean()),
        cost_to_lqr=None if theirs is None else _mean_ratio(ours.cost, theirs.cost),
        cost_to_optimum=_mean_ratio(ours.cost, least),
        worst_to_optimum=_worst_ratio(ours.cost, least),
        lqr_to_optimum=None if theirs is None else _mean_ratio(theirs.cost, least),
        lqr_worst=None if theirs is None else _worst_ratio(theirs.cost, least),
        margins=_margins(design),
    )


def _margins(design: Design) -> Margins | None:
    A, B, C, _ = design.loop_transfer()
    return margins(A, B, C) if design.spectrum.real.max() < 0 else None


def _horizon(design: Design, plant: PlantModel) -> float:
    """Long enough for the slowest mode of either controller, in natural time."""
    modes = design.spectrum * design.units.time
    spectra = [modes] if plant.linear is None else [modes, plant.linear.spectrum]
    slowest = []
    for spectrum in spectra:
        decays = -np.real(spectrum)
        slowest.append(float(decays[decays > _DECAYS * np.abs(spectrum).max()].min(initial=np.inf)))
    pace = min(slowest)
    return _CONSTANTS / pace if np.isfinite(pace) else _CONSTANTS


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
