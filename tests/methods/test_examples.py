"""What holds each example that the published loop refuses, or is not defined for."""

import json

import numpy as np
import pytest
import sympy as sp
from helpers.symbolic_plants import EXAMPLES

from necc_casadi.certificate.checker.check import check
from necc_casadi.certificate.prover.certify import certify
from necc_casadi.choice.choose import choose
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
    "induction_motor": "constant",
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
    held = sp.Matrix(
        model.system.drift + model.system.directions * model.system.holding_input(target)
    )
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


def chosen(name):
    _, target, answer = found(name)
    method = answer.chosen
    return choose(method.loop, method.casimirs, method.verdict, target)


def written(design, certificate, folder):
    design.save(folder / "design.json")
    (folder / "certificate.json").write_text(certificate.to_json(), encoding="utf-8")
    return [r for r in check(folder) if r.name != "code"]


@pytest.mark.slow
def test_a_converter_is_held_with_clipped_duty_ratios_at_the_cost_of_lqr(tmp_path):
    """What inputs may be clipped to everywhere is no reason for a design that costs more."""
    kept = chosen("boost")
    claims = {claim.name: claim for claim in kept.certificate.claims}
    assert kept.certificate.is_global
    assert claims["clipping"].data == {"everywhere": True}
    assert claims["input_limits"].holds
    assert kept.kept.cost_to_lqr < 1.2
    made, certificate = kept.design, kept.certificate
    rng = np.random.default_rng(0)
    z = made.z_star + rng.uniform(-1, 1, (20000, 3)) * 2 * made.sizes.state
    inside = z[np.ravel(made.lyapunov.V(z)) <= certificate.level_u]
    u = np.array([made.control(row[:2], row[2:])[0] for row in inside]).ravel()
    assert len(u) > 50
    assert 0 <= u.min() <= u.max() <= 1
    assert [r.statement for r in written(made, certificate, tmp_path) if not r.holds] == []


@pytest.mark.slow
def test_bounds_that_no_double_is_are_kept_in_the_arithmetic_of_the_checker(tmp_path):
    kept = chosen("generator_excitation")
    assert kept.certificate.claims[-1].name == "global"
    region = json.loads(kept.certificate.to_json())["region"]
    assert region is not None
    results = written(kept.design, certify(kept.design), tmp_path)
    assert [r.statement for r in results if not r.holds] == []


@pytest.mark.slow
def test_a_winding_that_is_far_faster_than_its_load_is_followed_to_the_end():
    kept = chosen("servo_pendulum").kept
    assert kept.arrivals == len(kept.response.arrived)
    assert kept.cost_to_lqr < 2
