"""Whether ξ should start at ξ* or at the minimum of V(x(0), ·): measured, not proved."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from necc_casadi.arrays import Vector
from necc_casadi.designs.design import Design
from necc_casadi.model.cost import QuadraticCost
from necc_casadi.performance.closed_loop_cost import Responses, design_feedback, responses
from necc_casadi.performance.measure import horizon_of, random_starts
from necc_casadi.performance.plant_model import plant_model

__all__ = ["with_better_start"]


#: Starts that the choice rests on, others than those that a design is measured from.
_STARTS, _SEED = 12, 2


#: Of a mean cost that is lower by less, nothing can be told from so few starts.
_GAIN = 0.03


def with_better_start(design: Design, cost: QuadraticCost) -> Design:
    """The design with ξ(0) = argmin V(x(0), ·) where that costs less, else with ξ(0) = ξ*.

    ξ* needs no computing, so it stays unless more of the starts arrive, or they cost less by more
    than the starts can tell. Inputs stay within the limits of the model.
    """
    if not design.spectrum.real.max() < 0:
        return design
    plant = plant_model(design, cost)
    starts = [
        start / design.units.state[: plant.n] for start in random_starts(design, _STARTS, _SEED)
    ]
    horizon = horizon_of(design, plant)
    plain, least = (
        responses(plant, design_feedback(kind), starts, horizon)
        for kind in (replace(design, initial_xi="target"), replace(design, initial_xi="minimum"))
    )
    return replace(design, initial_xi="minimum" if _is_better(least, plain) else "target")


def _is_better(one: Responses, other: Responses) -> bool:
    arrived, before = one.arrived.sum(), other.arrived.sum()
    if arrived != before:
        return bool(arrived > before)
    both: Vector = np.flatnonzero(one.arrived & other.arrived)
    if not both.size:
        return False
    return bool(np.mean(np.log(one.cost[both] / other.cost[both])) < np.log(1 - _GAIN))
