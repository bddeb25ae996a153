"""Costs of responses and the least cost: against matrix equations where the loop is linear."""

import dataclasses

import numpy as np
import pytest
from helpers.constructed import make_design, mechanical
from scipy.linalg import expm, solve_continuous_lyapunov
from scipy.optimize import brentq

from necc_casadi.lyapunov.networks import Network
from necc_casadi.lyapunov.parameterization import Form
from necc_casadi.model.cost import QuadraticCost
from necc_casadi.performance.closed_loop_cost import design_feedback, lqr_feedback, responses
from necc_casadi.performance.optimum import Optimum
from necc_casadi.performance.plant_model import plant_model
from necc_casadi.performance.steady_error import disturbed_error, perturbed_error

COST = QuadraticCost(np.diag([2.0, 0.5]), np.array([[0.3]]))
STARTS = [np.array([1.0, 0.0]), np.array([-0.4, 0.8])]


@pytest.fixture(scope="module")
def spring():
    """V = ½(q² + p²) + ½ξ² + ½(q − ξ)²: a linear loop."""
    plant = mechanical(lambda q, p: (p**2 + q**2) / 2, 1)
    form = Form(Network(1, (), quadratic=True), Network(1, (), quadratic=True))
    return make_design(plant, (0, 0), form, [0, 0, 1.0, 0, 0, 0, 1.0, 0], [0.0], (1.0, 1.5))


def test_the_cost_of_a_linear_loop_solves_a_lyapunov_equation(spring):
    plant = plant_model(spring, COST)
    A, B, C, _ = spring.loop_transfer()
    W = C.T @ COST.R @ C
    W[:2, :2] += COST.Q
    P = solve_continuous_lyapunov((A - B @ C).T, -W)
    found = responses(plant, design_feedback(spring), STARTS, 40.0)
    for start, cost in zip(STARTS, found.cost, strict=True):
        z = np.append(start, 0.0)
        assert cost == pytest.approx(z @ P @ z, rel=1e-5)


def test_lqr_and_the_optimum_of_a_linear_plant_cost_the_same(spring):
    plant = plant_model(spring, COST)
    found = responses(plant, lqr_feedback(plant), STARTS, 30.0)
    problem = Optimum(plant, 30.0)
    for start, cost in zip(STARTS, found.cost, strict=True):
        expected = start @ plant.linear.P @ start
        assert cost == pytest.approx(expected, rel=1e-5)
        assert problem.cost(start) == pytest.approx(expected, rel=1e-5)


def test_settling_overshoot_and_peak_by_hand(spring):
    """Against the matrix exponential on a fine grid."""
    plant = plant_model(spring, COST)
    A, B, C, _ = spring.loop_transfer()
    found = responses(plant, design_feedback(spring), STARTS[:1], 30.0)
    step = expm((A - B @ C) * (found.t[1] - found.t[0]))
    z, path = np.array([1.0, 0.0, 0.0]), []
    for _ in found.t:
        path.append(z)
        z = step @ z
    path = np.array(path)
    np.testing.assert_allclose(found.x[0], path[:, :2], atol=1e-6)
    np.testing.assert_allclose(found.peak_inputs[0], abs(path @ -C.T).max(axis=0), rtol=1e-6)
    beyond = max(0.0, -path[:, 0].min())
    assert found.overshoots[0] == pytest.approx(beyond, abs=1e-6)
    distance = np.linalg.norm(path[:, :2], axis=1)
    outside = np.flatnonzero(distance > 0.02)[-1]
    assert found.settling_times[0] == found.t[outside + 1]


def test_a_start_that_does_not_arrive_costs_infinitely(spring):
    plant = plant_model(spring, COST)
    found = responses(plant, design_feedback(spring), STARTS, 0.5)
    assert np.isinf(found.cost).all()
    assert np.isinf(found.settling_times).all()


def test_the_error_under_a_disturbance_by_hand(spring):
    """At rest p = 0, so ∂V/∂ξ = 0: ξ = q/2, and q + q/2 = d."""
    error = disturbed_error(spring, 0.1)
    assert error[0] == pytest.approx(0.1 / 1.5, rel=1e-9)
    assert error[1] == pytest.approx(0.0, abs=1e-12)


def test_the_error_on_another_plant_is_where_its_loop_rests(default_design, pendulum):
    """1.1 sin q = u(q, 0, ξ) and ξ̇ = 0, by bisection."""
    loop = pendulum.loop
    H, p = loop.plant.H, loop.plant.x[1]
    heavier = dataclasses.replace(loop.plant, H=H + H.subs({p: 0}) / 10)
    error = perturbed_error(default_design, heavier)

    def rest(q):
        xi = brentq(lambda v: default_design.control([q, 0.0], [v])[1][0], -20, 20)
        return default_design.control([q, 0.0], [xi])[0][0] - 1.1 * np.sin(q)

    q = brentq(rest, 0.4, 1.2)
    size = default_design.sizes.state[0]
    assert error[0] == pytest.approx(abs(q - np.pi / 4) / size, rel=1e-6)
    assert error[0] > 0.01


def test_an_unchanged_plant_has_no_error(default_design, pendulum):
    assert perturbed_error(default_design, pendulum.loop.plant).max() < 1e-9
