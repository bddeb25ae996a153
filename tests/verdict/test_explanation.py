"""The verdict in words."""

import sympy as sp
from helpers.symbolic_plants import (
    load,
    verdict_of,
)

from necc_casadi.model.closed_loop import interconnect
from necc_casadi.model.controller import make_controller


def test_words_name_the_coordinate_and_the_entry():
    _, upright, _ = load("cart_pole")
    text = verdict_of(upright, (1, 0, 0, 0)).explanation
    assert "theta" in text
    assert "x - xi1" in text
    assert "Actuate theta" in text
    _, parallel, target = load("parallel_rlc")
    text = verdict_of(parallel, target.values()).explanation
    assert "R[0,0] = 1/2" in text
    assert "q" in text


def test_friction_on_the_shaped_coordinate_is_the_obstacle_and_rc_kills_the_casimir():
    plant, _, _ = load("pendulum")
    xi = sp.symbols("xi1", real=True)
    lossy = make_controller(plant, [xi], sp.zeros(1, 1), sp.eye(1), sp.eye(1))
    verdict = verdict_of(interconnect(plant, lossy), (sp.pi / 4, 0))
    assert verdict.reason == "invisible_gradient"
    assert "Rc[0,0] = 1" in verdict.explanation
