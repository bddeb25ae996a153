"""Inputs stay within the limits of the model, and ξ moves as if they had none."""

import dataclasses

import numpy as np
import pytest

from necc_casadi.simulation.convergence import converging
from necc_casadi.simulation.responses import simulate
from necc_casadi.simulation.saturated import saturated_field


def limited(design, limits):
    plant = dataclasses.replace(design.loop.plant, u_limits=limits)
    return dataclasses.replace(design, loop=dataclasses.replace(design.loop, plant=plant))


def test_the_plant_gets_the_clipped_input(default_design, points):
    made = limited(default_design, ((0.5, 0.9),))
    for z in points(made, 20):
        u, xi_dot = made.control(z[:2], z[2:])
        expected = [z[1], np.clip(u[0], 0.5, 0.9) - np.sin(z[0]), xi_dot[0]]
        found = np.asarray(saturated_field(made)(z)).ravel()
        np.testing.assert_allclose(found, expected, atol=1e-14)


def test_a_response_says_that_it_was_limited(default_design):
    x0 = [-0.5, 0.0]
    free = simulate(default_design, x0)
    assert not free.saturated
    top = 0.9 * float(free.u.max())
    held = simulate(limited(default_design, ((-5.0, top),)), x0)
    assert held.saturated
    assert held.peak_input == pytest.approx(top)
    assert held.demand.max() > top
    wide = simulate(limited(default_design, ((-50.0, 50.0),)), x0)
    assert not wide.saturated
    np.testing.assert_allclose(wide.z, free.z, atol=1e-6)


def test_without_enough_input_nothing_arrives(default_design):
    """sin(π/4) holds the target: 0.6 does not."""
    start = default_design.z_star + np.array([0.3, 0.0, 0.0])
    assert converging(default_design, [start]).arrived[0]
    assert not converging(limited(default_design, ((-0.6, 0.6),)), [start]).arrived[0]
