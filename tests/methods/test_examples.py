"""What holds each example that the published loop refuses, or is not defined for."""

import pytest
import sympy as sp
from helpers.symbolic_plants import EXAMPLES

from necc_casadi.methods.find import find_method
from necc_casadi.model.model_file import load_model
from necc_casadi.symbolic.floats import float_matrix

QUICK = {
    "parallel_rlc": "shaping",
    "rlc_ladder": "shaping",
    "servo_pendulum": "shaping",
    "mems_switch": "shaping",
    "generator_excitation": "shaping",
    "quadruple_tank": "shaping",
    "three_tanks": "shaping",
    "boost": "modulated",
    "buck_boost": "modulated",
    "cuk": "modulated",
}
LONGER = {
    "pmsm": "modulated",
    "maglev_voltage": "constant",
    "cstr": "constant",
    "flexible_joint": "constant",
    "turbine_generator": "constant",
}


def found(name, method="auto"):
    model = load_model(EXAMPLES / f"{name}.py")
    target = {s: model.target[str(s)] for s in model.system.x}
    return model, target, find_method(model, target, method)


def is_held(name, method, wanted="auto"):
    model, target, answer = found(name, wanted)
    assert answer.chosen is not None
    assert answer.chosen.name == method
    assert answer.chosen.verdict.stability == "asymptotic"
    at = [(s, float(v)) for s, v in target.items()]
    held = sp.Matrix(model.system.drift + model.system.directions * model.system.holding_input(target))
    size = max(abs(v) for _, v in at)
    assert max(map(abs, float_matrix(held.subs(target)).ravel())) < 1e-9 * max(size, 1)


@pytest.mark.parametrize("name", QUICK)
def test_the_example_is_held_by_its_method(name):
    is_held(name, QUICK[name])


@pytest.mark.slow
@pytest.mark.parametrize("name", LONGER)
def test_the_example_is_held_by_its_method_after_some_search(name):
    is_held(name, LONGER[name])


@pytest.mark.slow
def test_a_motor_is_held_by_a_constant_structure_too():
    is_held("pmsm", "constant", wanted="constant")
