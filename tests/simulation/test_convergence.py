"""Convergence of many starts: the order of the steps, and agreement with responses one by one."""

import dataclasses

import casadi as ca
import numpy as np
import pytest
from helpers.constructed import make_design, mechanical
from helpers.dragged import creeping

from necc_casadi.lyapunov.networks import Network
from necc_casadi.lyapunov.parameterization import Form
from necc_casadi.simulation.convergence import (
    bogacki_shampine,
    converging,
    rosenbrock,
    simulated_share,
    stepper,
)
from necc_casadi.simulation.responses import default_horizon, simulate


def pendulum(z):
    """Undamped, in rows: nonlinear, so that no order condition is met by accident."""
    return np.stack([z[:, 1], -np.sin(z[:, 0])], axis=1)


START = np.array([[1.0, 0.5]])


def advanced(time: float, steps: int):
    """The state after `time` in equal steps, and the error estimate of the last one."""
    z, slope, h = START, pendulum(START), np.array([time / steps])
    for _ in range(steps):
        z, slope, difference = bogacki_shampine(pendulum, z, slope, h)
    return z, np.abs(difference).max()


def order(values) -> float:
    """Exponent p of values that fall as hᵖ while h is halved; of the two smallest steps."""
    return float(np.log2(values[-2] / values[-1]))


def test_steps_are_of_order_three_and_their_estimate_of_order_two():
    """Local errors fall as h⁴, global ones as h³; the embedded solution errs by h³ in one step."""
    sizes = [0.2 / 2**k for k in range(4)]
    exact = [advanced(h, 2000)[0] for h in sizes]
    local = [np.abs(advanced(h, 1)[0] - z).max() for h, z in zip(sizes, exact, strict=True)]
    assert order(local) == pytest.approx(4, abs=0.15)
    assert order([advanced(h, 1)[1] for h in sizes]) == pytest.approx(3, abs=0.15)
    end = advanced(2.0, 20_000)[0]
    errors = [np.abs(advanced(2.0, steps)[0] - end).max() for steps in (20, 40, 80)]
    assert order(errors) == pytest.approx(3, abs=0.15)


def test_each_state_has_its_own_step_and_the_last_slope_is_the_next_first():
    z = np.repeat(START, 3, axis=0)
    h = np.array([0.05, 0.1, 0.2])
    end, slope, difference = bogacki_shampine(pendulum, z, pendulum(z), h)
    np.testing.assert_array_equal(slope, pendulum(end))
    for k, step in enumerate(h):
        alone, _, estimate = bogacki_shampine(pendulum, START, pendulum(START), h[k : k + 1])
        np.testing.assert_array_equal(end[k], alone[0], err_msg=str(step))
        np.testing.assert_array_equal(difference[k], estimate[0])


def turned(z):
    """∂ż/∂z of the pendulum, (B, 2, 2)."""
    still = np.zeros(len(z))
    return np.stack(
        [np.stack([still, still + 1], axis=1), np.stack([-np.cos(z[:, 0]), still], axis=1)], axis=1
    )


def advanced_implicitly(time: float, steps: int):
    z, slope, h = START, pendulum(START), np.array([time / steps])
    for _ in range(steps):
        z, slope, difference = rosenbrock(pendulum, turned, z, slope, h)
    return z, np.abs(difference).max()


def test_implicit_steps_are_of_order_two_and_their_estimate_of_order_three():
    sizes = [0.2 / 2**k for k in range(4)]
    exact = [advanced(h, 2000)[0] for h in sizes]
    errors = [
        np.abs(advanced_implicitly(h, 1)[0] - z).max() for h, z in zip(sizes, exact, strict=True)
    ]
    assert order(errors) == pytest.approx(3, abs=0.2)
    assert order([advanced_implicitly(h, 1)[1] for h in sizes]) == pytest.approx(3, abs=0.2)
    end = advanced(2.0, 20_000)[0]
    errors = [np.abs(advanced_implicitly(2.0, steps)[0] - end).max() for steps in (40, 80, 160)]
    assert order(errors) == pytest.approx(2, abs=0.2)


def test_modes_that_are_over_long_before_the_others_are_stepped_over():
    """ż = −z₁·10⁶ beside ż = −z₂: steps of the slow one leave nothing of the fast one."""
    z = ca.MX.sym("z", 2)
    ode = ca.Function("stiff", [z], [ca.vertcat(-1e6 * z[0], -z[1])])
    start, h = np.array([[1.0, 1.0]]), np.array([0.1])
    slope = np.array([[-1e6, -1.0]])
    end, _, _ = stepper(ode, np.zeros(2), 0.01)(start, slope, h)
    assert abs(end[0, 0]) < 1e-4
    assert end[0, 1] == pytest.approx(np.exp(-0.1), rel=1e-3)
    explicit, _, _ = stepper(ode, np.zeros(2), 1e-7)(start, slope, h)
    assert abs(explicit[0, 0]) > 1e6


def test_many_starts_at_once_agree_with_responses_one_by_one(default_design, paper_design):
    for made in (default_design, paper_design):
        lo, hi = made.domain.lo, made.domain.hi
        starts = np.random.default_rng(2).uniform(lo, hi, (12, lo.size))
        found = converging(made, starts)
        horizon = 4 * default_horizon(made)
        each = [simulate(made, z[:2], z[2:], time=horizon, points=101).converged for z in starts]
        assert found.arrived.tolist() == each
        assert not found.unfinished.any()


def test_share_of_a_loop_with_a_second_minimum_is_the_side_of_the_saddle():
    """p²/2 + (q² − 1)²/4: from rest, damped, to the well at q = 1 from q > 0 alone, ξ at rest."""
    plant = mechanical(lambda q, p: p**2 / 2 + (q**2 - 1) ** 2 / 4, 1)
    form = Form(Network(1, (), quadratic=True), Network(1, (), quadratic=True))
    weights = [0, 0, 1.0, 0.0, 0, 0, 1e-9, 1.0]
    made = make_design(plant, (1, 0), form, weights, [0.0], damping=(1.0, 1.0))
    q = np.array([-1.4, -1.0, -0.1, 0.1, 1.0, 1.4])
    starts = np.column_stack([q, 0 * q, 0 * q])
    assert converging(made, starts).arrived.tolist() == (q > 0).tolist()
    share = simulated_share(made, [1])
    assert 0.3 < share < 0.9
    assert share == simulated_share(made, [1])


def test_running_out_of_time_tells_nothing_of_a_loop_that_creeps():
    made = creeping()
    assert made.creeps
    assert made.abscissa == 0
    starts = np.array([[0.5, 0, 0, 0], [0, 0.5, 0, 0]])
    found = converging(made, starts)
    assert found.arrived.tolist() == [False, True]
    assert found.unfinished.tolist() == [True, False]
    assert simulated_share(made, (2,)) is None
    only_stable = dataclasses.replace(made.verdict, stability="stable", witness="a rests")
    found = converging(dataclasses.replace(made, verdict=only_stable), starts)
    assert found.arrived.tolist() == [False, True]
    assert not found.unfinished.any()
