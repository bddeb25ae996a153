"""Responses with clipped inputs: against other integrators, and where starts end."""

from pathlib import Path

import numpy as np
import pytest
from helpers.dragged import creeping
from helpers.problems import PENDULUM, problem, solve

from necc_casadi.model.cost import bryson
from necc_casadi.model.model_file import load_model
from necc_casadi.performance.closed_loop_cost import design_feedback, responses
from necc_casadi.performance.plant_model import plant_model
from necc_casadi.performance.saturated import (
    _PATIENCE,
    _Calls,
    _Follower,
    even_starts,
    lqr_costs,
    saturated,
)
from necc_casadi.simulation.responses import simulate
from necc_casadi.synthesis.options import Options

EXAMPLES = Path(__file__).parents[2] / "examples"
SMALL = {"hidden_k": (8,), "hidden_h": (6,)}


def cost_of(made):
    return bryson(made.sizes, made.loop.plant.n)


@pytest.fixture(scope="module")
def weak(tmp_path_factory):
    """A pendulum whose motor holds π/4 (0.71 N m) with little to spare."""
    path = tmp_path_factory.mktemp("weak") / "weak.py"
    limits = "\nR = sp.diag(0, 1)\nu_limits = [(-0.75, 0.75)]\ndomain = {q: (-3, 3), p: (-1, 1)}\n"
    path.write_text(PENDULUM.read_text(encoding="utf-8") + limits, encoding="utf-8")
    return solve(problem(load_model(path), "pi/4"), Options(**SMALL))


def test_without_limits_costs_and_peaks_are_those_of_cvodes(default_design):
    starts = even_starts(default_design, 8)
    found = saturated(default_design, cost_of(default_design), starts)
    plant = plant_model(default_design, cost_of(default_design))
    natural = starts / default_design.units.state[:2]
    exact = responses(plant, design_feedback(default_design), list(natural), 40.0)
    assert found.arrived.any()
    both = found.arrived & exact.arrived
    np.testing.assert_allclose(found.cost[both], exact.cost[both], rtol=5e-3)
    peaks = exact.peak_inputs[both] * default_design.units.input
    np.testing.assert_allclose(found.peak_u[both], peaks, rtol=2e-2)
    assert found.keeps_limits


def test_starts_fill_the_domain_and_are_the_same_for_every_design(default_design, paper_design):
    starts = even_starts(default_design)
    domain = default_design.domain
    assert ((domain.lo[:2] <= starts) & (starts <= domain.hi[:2])).all()
    np.testing.assert_allclose(starts.min(0), domain.lo[:2], atol=0.5)
    np.testing.assert_array_equal(starts, even_starts(paper_design))


def test_what_settles_elsewhere_is_a_minimum_of_v(default_design):
    """Two starts of the plain design go to the next minimum of V."""
    found = saturated(default_design, cost_of(default_design))
    assert found.strayed
    at = found.elsewhere[0].at
    assert at["q"] == pytest.approx(5.287, abs=0.02)
    index = found.elsewhere[0].starts[0]
    end = simulate(default_design, found.starts[index], time=60.0).z[-1]
    assert end[0] == pytest.approx(at["q"], abs=0.05)
    assert np.isinf(found.cost[index])


def clipped_by_hand(made, start, time, steps=40_000):
    """State and cost of the weak pendulum after a time, by the classical Runge–Kutta method."""
    cost, h = cost_of(made), time / steps
    u_star = np.sin(np.pi / 4)
    centre = np.array([np.pi / 4, 0.0])

    def slope(z):
        (u,), (xi_dot,) = made.control(z[:2], z[2:3])
        u = np.clip(u, -0.75, 0.75)
        away = z[:2] - centre
        running = away @ cost.Q @ away + cost.R[0, 0] * (u - u_star) ** 2
        return np.array([z[1], -np.sin(z[0]) - z[1] + u, xi_dot, running])

    z = np.array([*start, *made.xi_star, 0.0])
    for _ in range(steps):
        k1 = slope(z)
        k2 = slope(z + h / 2 * k1)
        k3 = slope(z + h / 2 * k2)
        z = z + h * (k1 + 2 * k2 + 2 * k3 + slope(z + h * k3)) / 6
    return z


def test_a_clipped_input_is_what_the_plant_gets_and_pays_for(weak):
    starts = np.array([[-1.5, 0.0], [2.5, -0.5]])
    found = saturated(weak, cost_of(weak), starts)
    assert found.exceeded.any()
    assert found.arrived.any()
    for index, start in enumerate(starts):
        end = clipped_by_hand(weak, start, 40.0, steps=4000)
        arrived = abs(end[0] - np.pi / 4) < 0.05
        assert arrived == found.arrived[index]
        if arrived:  # what is left of the cost once a start has arrived is 1e-4 of it
            # the unit of time of a cost is the natural one
            assert found.cost[index] * weak.units.time == pytest.approx(end[3], rel=1e-2)


def test_turns_that_nothing_counts_are_no_distance():
    """θ of the cart-pole is seen by no Casimir: hanging is hanging, whatever the turns."""
    task = problem(load_model(EXAMPLES / "cart_pole.py"), "x=1,theta=pi,p_x=0,p_theta=0")
    made = solve(task, Options(**SMALL))
    starts = np.array([[1.0, np.pi + 0.1, 0.0, 0.0], [1.0, 3 * np.pi + 0.1, 0.0, 0.0]])
    found = saturated(made, cost_of(made), starts)
    assert found.arrived.all()
    # of a pendulum q is counted by the Casimir: a turn away is another state
    pendulum = solve(problem(load_model(PENDULUM), "pi/4"), Options(**SMALL))
    away = np.array([[np.pi / 4 + 2 * np.pi, 0.0]])
    assert saturated(pendulum, cost_of(pendulum), away).cost[0] > 1


def test_what_runs_away_is_lost():
    """Below the magnet's reach the ball falls."""
    made = solve(problem(load_model(EXAMPLES / "maglev.py"), "q=0.1"), Options(**SMALL))
    found = saturated(made, cost_of(made))
    assert found.lost.any()
    assert not (found.lost & found.arrived).any()
    assert set(np.flatnonzero(found.lost)) <= set(found.strayed)


@pytest.mark.slow
def test_a_satellite_comes_to_rest_half_a_turn_off():
    task = problem(load_model(EXAMPLES / "satellite.py"), "pi/6,pi/8,-pi/5,0,0,0")
    found = saturated(made := solve(task), cost_of(made))
    assert found.share < 0.8
    yaws = [place.at["yaw"] for place in found.elsewhere]
    half_a_turn = -np.pi / 5 + np.pi
    assert min(abs(yaw - half_a_turn) for yaw in yaws) < 0.2


def test_lqr_is_followed_from_the_same_starts(default_design):
    starts = even_starts(default_design, 6)
    costs = lqr_costs(default_design, cost_of(default_design), starts)
    ours = saturated(default_design, cost_of(default_design), starts).cost
    both = np.isfinite(costs) & np.isfinite(ours)
    assert both.sum() >= 4
    ratio = float(np.exp(np.mean(np.log(ours[both] / costs[both]))))
    assert 0.9 < ratio < 1.5


def test_nothing_is_at_rest_elsewhere_where_a_loop_creeps():
    """ȧ = −a³: the pace falls faster than the distance, and z̄ is the only place of rest."""
    made = creeping()
    found = saturated(made, cost_of(made))
    assert not found.arrived.any()
    assert not found.strayed


def test_a_response_near_a_pole_is_followed_though_its_steps_are_short(default_design):
    """The way that is taken then, against the usual one; None where it is too long."""
    cost = cost_of(default_design)
    plant = plant_model(default_design, cost)
    follower = _Follower(default_design, plant, design_feedback(default_design))
    starts = even_starts(default_design, 1)
    usual = follower.follow(starts)
    z = np.concatenate(
        [starts[0] / follower.units, follower.feedback.start(starts[0] / follower.units), [0.0]]
    )
    path = follower._stiffly(z, 0.0, _PATIENCE * follower.horizon, _Calls(40_000))
    assert follower.distance(path[-1:])[0] < 1e-3
    np.testing.assert_allclose(path[-1, -1], usual.cost[0], rtol=5e-3)
    assert follower._stiffly(z, 0.0, follower.horizon, _Calls(10)) is None
