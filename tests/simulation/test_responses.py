"""Responses: accuracy against a fixed-step integrator, V never rises, settling, CSV."""

import dataclasses

import numpy as np
import pytest
from helpers import reference

from necc_casadi.simulation.responses import (
    Trajectory,
    default_horizon,
    random_states,
    simulate,
    slowest_decay,
)


@pytest.mark.parametrize("name", ["default", "paper", "beta-sum", "neural"])
def test_the_integrator_agrees_with_tight_runge_kutta(designs, name):
    made = designs[name]
    start = made.z_star + 0.7
    n = made.loop.plant.n
    response = simulate(made, start[:n], start[n:], time=3.0, points=4)

    def f(z):
        return np.asarray(made.lyapunov.vector_field(z)).ravel()

    for k in (1, 3):
        exact = reference.rk4(f, start, response.t[k], 1000 * k)
        coarse = reference.rk4(f, start, response.t[k], 500 * k)
        assert np.linalg.norm(exact - coarse) < 1e-8
        np.testing.assert_allclose(response.z[k], exact, atol=2e-7)


def test_V_never_rises_and_the_input_is_the_controllers(any_design):
    n = any_design.loop.plant.n
    for x0 in random_states(any_design, 3, seed=5):
        response = simulate(any_design, x0, any_design.xi_star, points=301)
        assert response.complete
        assert np.all(np.diff(response.V) <= 1e-8 * (1 + np.abs(response.V[:-1])))
        assert response.V_bar <= response.V.min() + 1e-8
        for k in (0, 150, 300):
            u, _ = any_design.control(response.z[k, :n], response.z[k, n:])
            np.testing.assert_allclose(response.u[k], u, rtol=1e-14, atol=1e-14)
            assert response.V[k] == pytest.approx(any_design.V(response.z[k]), rel=1e-14)


def test_the_energy_balance_closes(designs):
    """V(T) − V(0) = ∫ V̇ dt by Simpson's rule over the response."""
    for name in ("default", "joint"):
        made = designs[name]
        response = simulate(made, random_states(made, 1)[0], time=4.0, points=2001)
        rates = [
            float(
                np.asarray(made.lyapunov.gradient(z)).ravel()
                @ np.asarray(made.lyapunov.vector_field(z)).ravel()
            )
            for z in response.z
        ]
        weights = np.ones(2001)
        weights[1:-1:2], weights[2:-1:2] = 4, 2
        total = float(weights @ rates) * response.t[1] / 3
        assert response.V[-1] - response.V[0] == pytest.approx(total, abs=1e-7)


def test_by_default_it_starts_as_the_design_does_and_runs_until_settled(default_design):
    response = simulate(default_design, [0.0, 0.0])
    assert np.array_equal(response.z[0], [0.0, 0.0, *default_design.xi_at_start([0.0, 0.0])])
    assert response.t[-1] == default_horizon(default_design)
    assert response.converged
    spectrum = np.linalg.eigvals(default_design.linearise()[0])
    assert default_horizon(default_design) == pytest.approx(8 / -spectrum.real.max())


def test_settling_time_is_the_last_exit_from_two_percent():
    t = np.linspace(0, 10, 1001)
    z = np.exp(-t)[:, None]
    response = Trajectory(t, z, z, t, np.zeros(1), 0.0, True)
    assert response.settling_time == pytest.approx(np.log(50), abs=0.011)
    assert response.peak_input == 1.0
    never = dataclasses.replace(response, z=np.ones((1001, 1)))
    assert never.settling_time == np.inf
    assert not never.converged
    cut = dataclasses.replace(response, complete=False, z=np.ones((1001, 1)))
    assert cut.settling_time == np.inf
    still = dataclasses.replace(response, z=np.zeros((1001, 1)))
    assert still.settling_time == 0.0
    huge = dataclasses.replace(response, z=1e300 * z)
    assert huge.settling_time == response.settling_time
    lost = dataclasses.replace(response, z=np.full((1001, 1), np.nan))
    assert lost.settling_time == np.inf


def test_csv_reads_back_bit_for_bit(default_design):
    response = simulate(default_design, [0.1, -0.2], time=1.0, points=5)
    header, *lines = response.csv(default_design.loop.states).splitlines()
    assert header == "t,q,p,xi1,u1,V"
    table = np.array([[float(v) for v in line.split(",")] for line in lines])
    expected = np.column_stack([response.t, response.z, response.u, response.V])
    assert np.array_equal(table, expected)


def test_random_states_lie_in_the_middle_of_the_domain(any_design):
    lo, hi = any_design.domain.lo, any_design.domain.hi
    n = any_design.loop.plant.n
    states = np.array(random_states(any_design, 50, seed=1))
    assert states.shape == (50, n)
    middle, half = (lo + hi)[:n] / 2, (hi - lo)[:n] / 2
    assert np.all(np.abs(states - middle) <= half / 2)
    assert np.array_equal(states, random_states(any_design, 50, seed=1))


def test_a_fast_winding_does_not_hide_how_slowly_its_load_decays():
    load = [-792.0 + 3248j, -792.0 - 3248j]
    assert slowest_decay(np.array([-3.7e7, -9127.0, *load])) == pytest.approx(792)
    swinging = np.array([-0.01 + 1000j, -0.01 - 1000j])  # for thousands of its periods
    assert slowest_decay(np.array([-5.0, *swinging])) == pytest.approx(5)
    assert slowest_decay(np.array([-5.0, -1e-15])) == pytest.approx(5)
    assert slowest_decay(np.array([1j, -1j])) == 0
