"""Whether ξ should start at ξ* or at the minimum of V(x(0), ·): measured, not proved."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from necc_casadi.arrays import Truth, Vector
from necc_casadi.designs.design import Design
from necc_casadi.designs.initial import least_over_xi
from necc_casadi.model.cost import QuadraticCost
from necc_casadi.performance.closed_loop_cost import design_feedback, responses
from necc_casadi.performance.plant_model import plant_model
from necc_casadi.performance.starts import decay_time, random_starts

__all__ = ["with_better_start"]


#: Starts that the choice rests on, others than those that a design is measured from.
_STARTS, _SEED = 20, 2


#: Loops of more states are not simulated for the choice: it would take longer than the design.
_MANY_STATES = 16


#: From so few starts nothing can be told where the mean cost is lower by less than this share, or
#: as few more arrive.
_GAIN, _FEW_MORE = 0.03, 1


def with_better_start(design: Design, cost: QuadraticCost) -> Design:
    """The design with ξ(0) = argmin V(x(0), ·) where that costs less, else with ξ(0) = ξ*.

    ξ* needs no computing, so it stays unless more of the starts arrive, or they cost less by more
    than the starts can tell; and where V(x(0), ·) has no minimum that Newton's method finds, and
    in loops of many states. Inputs stay within the limits of the model.
    """
    if len(design.z_star) > _MANY_STATES or not design.decays:
        return design
    plant = plant_model(design, cost)
    starts = [
        start / design.units.state[: plant.n] for start in random_starts(design, _STARTS, _SEED)
    ]
    natural = design.natural
    least = [least_over_xi(natural.lyapunov, natural, start) for start in starts]
    if not all(reached for _, reached in least):
        return replace(design, initial_xi="target")
    V, near = natural.lyapunov, [natural.stored_star] * _STARTS
    kept = near + [V.stored(x, at) for x, (at, _) in zip(starts, least, strict=True)]
    found = responses(plant, design_feedback(design), starts * 2, decay_time(design), kept)
    arrived, paid = found.arrived, found.cost
    better = _is_better(arrived[_STARTS:], paid[_STARTS:], arrived[:_STARTS], paid[:_STARTS])
    return replace(design, initial_xi="minimum" if better else "target")


def _is_better(arrived: Truth, cost: Vector, before: Truth, cost_before: Vector) -> bool:
    more = int(arrived.sum()) - int(before.sum())
    if abs(more) > _FEW_MORE:
        return more > 0
    both = arrived & before
    if not both.any():
        return False
    return bool(np.mean(np.log(cost[both] / cost_before[both])) < np.log(1 - _GAIN))
