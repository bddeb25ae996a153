"""Where the published loop does not hold the target: formulas, and what wrong parameters do."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from helpers.symbolic_plants import EXAMPLES
from scipy.integrate import solve_ivp

from necc_casadi.pipeline.request import Request
from necc_casadi.pipeline.run import run_design
from necc_casadi.report.methods import method_rows
from necc_casadi.report.to_json import to_json
from necc_casadi.report.to_text import summary


@pytest.fixture(scope="module")
def circuit():
    """A parallel RLC circuit: power shaping, and parameters."""
    return run_design(Request(model=EXAMPLES / "parallel_rlc.py"), lambda _: None)


def text_of(found) -> str:
    return " ".join(summary(found).split())


def test_structure_shaping_functions_and_feedback_are_shown_as_formulas(circuit):
    text = text_of(circuit)
    assert "method shaping: holds the target" in text
    assert "shaping functions γ = phi/2 + q; α = 1; ξ̇ = ∇γᵀẋ + v_c" in text


def test_the_input_ahead_of_a_structure_is_shown_as_a_formula():
    found = run_design(Request(model=EXAMPLES / "boost.py", check=True), lambda _: None)
    rows = dict(reversed(method_rows(found)))
    assert rows["method"].startswith("modulated: ")
    text = text_of(found)
    assert "u = 1/2 + w; for w the plant has H = 5000*phi**2 - 24*phi/5" in text
    assert "damping alone: w = −D y" in text
    assert "where the model file has them" not in text  # nothing was designed yet


def test_each_wrong_parameter_is_named_with_where_it_rests(circuit):
    text = text_of(circuit)
    assert "the controller contains the model: errors of its parameters displace it" in text
    for name in "rCL":
        assert f"{name} + 10 %: rests off by q " in text
    assert "--integral" not in text  # no family offers it for this loop


def test_where_it_rests_is_where_a_simulation_of_that_circuit_ends(circuit):
    """What the controller keeps is s = ξ − γ(x), which a wrong model does not move."""
    made, gamma = circuit.design, np.array([1.0, 0.5])

    def rates(x, u, r):
        return np.array([x[1] - x[0] / r, u - x[0]])  # of charge and flux, 1 F and 1 H

    def field(_, z):
        x, s = z[:2], z[2:]
        (u,), xi_dot = made.control(x, s + gamma @ x)
        s_dot = xi_dot - gamma @ rates(x, u, r=2.0)  # what the law adds to the rate of γ
        return [*rates(x, u, r=2.2), *s_dot]

    start = np.append(made.z_star[:2], made.xi_star - gamma @ made.z_star[:2])
    end = solve_ivp(field, (0, 200), start, rtol=1e-9, atol=1e-12).y[:2, -1]
    error = circuit.parameter_errors["r"]
    np.testing.assert_allclose(np.abs(end - made.z_star[:2]), error, rtol=1e-5)
    assert error[0] > 0.01
    listed = to_json(circuit)["method"]["parameter_errors"]
    assert listed["r"] == dict(zip(["q", "phi"], error.tolist(), strict=True))
    assert set(listed) == {"r", "C", "L"}


def test_a_plant_that_is_not_held_is_said_so(circuit):
    lost = replace(circuit, parameter_errors={"r": None})
    assert "r + 10 %: no rest is found nearby at which every mode decays" in text_of(lost)


def test_a_model_without_parameters_is_told_how_to_name_them(circuit):
    assert "where the model file has them in `params`" in text_of(
        replace(circuit, parameter_errors={})
    )


def test_what_another_structure_falls_short_of_is_one_line(circuit):
    other = SimpleNamespace(name="constant", because="it costs 2 times as much")
    both = replace(circuit, found=replace(circuit.found, passed=(other,)))
    assert "instead of constant: it costs 2 times as much" in text_of(both)
    assert to_json(both)["method"]["instead_of"] == [vars(other)]


@pytest.mark.slow
def test_integral_action_is_mentioned_where_a_family_offers_it(tmp_path):
    """A pendulum whose velocity is measured: the published loop, fully actuated."""
    file = tmp_path / "arm.py"
    file.write_text(
        'import sympy as sp\nq = sp.Symbol("q")\nm, g = sp.symbols("m g")\n'
        "M, V, B = m, m * g * (1 - sp.cos(q)), 1\nparams = {m: 1, g: 9.81}\n",
        encoding="utf-8",
    )
    found = run_design(Request(model=file, target="pi/4", compare=True), lambda _: None)
    text = text_of(found)
    assert "m + 10 %: rests off by" in text
    assert "with --integral neither a constant disturbance of u nor wrong inertia" in text
    assert "contains the model" not in text
    bare = file.read_text("utf-8") + 'measured = "state"\n'
    file.write_text(bare, encoding="utf-8")
    found = run_design(Request(model=file, target="pi/4", compare=True), lambda _: None)
    assert "--integral" not in text_of(found)
