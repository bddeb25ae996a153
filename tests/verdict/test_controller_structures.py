"""Controller structures that see more than integrators."""

import sympy as sp
from helpers.linear_problems import default_loop, judged, linear_problems
from helpers.symbolic_plants import (
    load,
    rolling_coin,
)
from hypothesis import given, settings

from necc_casadi.casimirs.find import find_casimirs
from necc_casadi.model.closed_loop import interconnect
from necc_casadi.verdict.controller_structures import (
    complete_controller,
    suggest_controllers,
)


def test_copied_coin_rests_anywhere():
    plant = rolling_coin()
    (proposal,) = suggest_controllers(plant, dict(zip(plant.x, (0, 0, 1, 1, 0, 0), strict=True)))
    name, controller, verdict = proposal
    assert name == "copy of the kinematics with 4 states"
    assert controller.nc == 4
    assert (verdict.assignable, verdict.stability) == (True, "stable")
    assert "equilibria" in verdict.witness


def test_structures_that_rescue_a_motor():
    plant, _, target = load("dc_motor")
    reference = judged(default_loop(plant), target)[1]
    assert reference.reason == "invisible_gradient"
    ((name, controller, verdict),) = suggest_controllers(plant, target)
    assert name == "resonator with 2 states"
    assert verdict.assignable
    loop = interconnect(plant, controller)
    assert len(find_casimirs(loop).functions) == 1


@given(linear_problems())
@settings(max_examples=40, deadline=None)
def test_complete_controller_sees_what_any_controller_sees(problem):
    plant, _target = problem
    complete = complete_controller(plant)
    n = plant.n
    default = sp.Matrix.hstack(
        sp.zeros(n, 0),
        *[
            sp.Matrix([sp.diff(c, s) for s in plant.x])
            for c in find_casimirs(default_loop(plant)).functions
        ],
    )
    if complete is None:
        return
    functions = find_casimirs(interconnect(plant, complete)).functions
    seen = sp.Matrix.hstack(
        sp.zeros(n, 0), *[sp.Matrix([sp.diff(c, s) for s in plant.x]) for c in functions]
    )
    assert seen.row_join(default).rank() == seen.rank()
