"""A rate and a peak: met as they are said to be, or the reason that stops them."""

import dataclasses

import numpy as np
import pytest
from helpers.problems import problem, solve

from necc_casadi.designs.error_bound import natural_loss
from necc_casadi.errors import OptionError
from necc_casadi.model.model_file import load_model
from necc_casadi.simulation.responses import random_states, simulate
from necc_casadi.synthesis.options import Options, check_options
from necc_casadi.synthesis.synthesis import answered

TWO = """
import sympy as sp
q, p, y, v = sp.symbols("q p y v", real=True)
x = (q, p, y, v)
J = sp.Matrix([[0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 0, 1], [0, 0, -1, 0]])
R = sp.diag(0, 0, 0, 1)
G = sp.Matrix([0, 1, 0, 0])
H = p**2 / 2 + 1 - sp.cos(q) + (y**2 + v**2) / 2
"""


def ask(task, **options):
    return answered(task.loop, task.casimirs, task.verdict, task.x_star, Options(**options))


def slowest(design) -> float:
    """Of the loop opened at the input and closed again, 1/s."""
    A, B, C, _ = design.loop_transfer()
    return float(-np.linalg.eigvals(A - B @ C).real.max())


@pytest.mark.parametrize("rate", [1.0, 4.0])
def test_every_mode_exceeds_the_rate(pendulum, rate):
    found = ask(pendulum, rate=rate)
    assert found.asked.met
    assert slowest(found.design) >= rate * (1 - 1e-9)
    assert found.asked.rate_reached == pytest.approx(slowest(found.design), rel=1e-6)
    assert natural_loss(found.design) <= 1e-9


def test_a_peak_is_kept_by_the_responses(pendulum):
    free, made = ask(pendulum, least_cost=True), ask(pendulum, peak_u=np.array([1.0]))
    assert made.asked.met

    def peak(design):
        starts = random_states(design, 10, design.seed)
        return max(simulate(design, x).peak_input for x in starts)

    assert peak(made.design) <= 1.0 < peak(free.design)


def test_a_peak_below_what_holds_the_target_is_refused_with_that(pendulum):
    """sin(π/4) is 0.707."""
    asked = ask(pendulum, peak_u=np.array([0.5])).asked
    assert asked.stopped_by == "input_peak"
    assert asked.held_outside
    assert asked.held == pytest.approx([np.sin(np.pi / 4)], abs=1e-6)


def test_a_mode_that_no_input_moves_stops_the_rate(tmp_path):
    """A second mass, coupled to nothing: s = (−1 ± j√3)/2."""
    model = tmp_path / "two.py"
    model.write_text(TWO, encoding="utf-8")
    asked = ask(problem(load_model(model), "q=pi/4"), rate=2.0).asked
    assert asked.stopped_by == "unmoved_mode"
    assert abs(asked.mode) == pytest.approx(1.0, rel=1e-6)
    assert asked.rate_reached == pytest.approx(0.5, rel=1e-3)


def test_a_rate_and_a_form_without_the_program_exclude_each_other():
    for clash in ({"phi": "neural"}, {"quadratic": False}, {"D": np.eye(1)}):
        with pytest.raises(OptionError, match="exclude"):
            check_options(Options(rate=1.0, **clash))


def test_weights_ask_for_the_least_cost(pendulum):
    weighted = ask(pendulum, state_cost=np.diag([4.0, 1.0])).design
    assert weighted.starts[-1].mode == "cost"
    assert solve(pendulum).starts[-1].mode == "hard"


def test_xi_at_the_start_is_the_minimum_or_the_target(default_design):
    made = dataclasses.replace(default_design, initial_xi="minimum")
    at_target = dataclasses.replace(default_design, initial_xi="target")
    for x in ([0.1, 0.4], [1.9, -1.0]):
        xi = made.xi_at_start(x)
        z = np.concatenate([x, xi])
        assert abs(made.lyapunov.gradient(z)[2]) < 1e-9
        assert made.V(z) < made.V(np.concatenate([x, made.xi_star]))
        assert at_target.xi_at_start(x).tolist() == at_target.xi_star.tolist()
        assert simulate(made, x, time=1.0, points=3).z[0, 2] == pytest.approx(xi[0], rel=1e-14)
