"""Whether ξ should start at ξ* or at the minimum of V(x(0), ·): measured, not proved."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from necc_casadi.designs.design import Design
from necc_casadi.model.cost import QuadraticCost
from necc_casadi.performance.closed_loop_cost import Responses, design_feedback, responses
from necc_casadi.performance.measure import horizon_of, random_starts
from necc_casadi.performance.plant_model import plant_model

__all__ = ["with_better_start"]


#: Starts that the choice rests on, others than those that a design is measured from.
_STARTS, _SEED = 20, 2


#: From so few starts nothing can be told where the mean cost is lower by less than this share, or
#: as few more arrive.
_GAIN, _FEW_MORE = 0.03, 1


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
    more = int(one.arrived.sum()) - int(other.arrived.sum())
    if abs(more) > _FEW_MORE:
        return more > 0
    both = np.flatnonzero(one.arrived & other.arrived)
    if not both.size:
        return False
    return bool(np.mean(np.log(one.cost[both] / other.cost[both])) < np.log(1 - _GAIN))
