"""What --compare measures: against the design's own numbers, and within the limits."""

import dataclasses

import numpy as np
import pytest

from necc_casadi.performance.measure import measure
from necc_casadi.performance.starts import random_starts


@pytest.fixture(scope="module")
def limited(default_design):
    plant = dataclasses.replace(default_design.loop.plant, u_limits=((-1.2, 1.2),))
    return dataclasses.replace(
        default_design, loop=dataclasses.replace(default_design.loop, plant=plant)
    )


@pytest.fixture(scope="module")
def found(limited, pendulum):
    H, p = pendulum.loop.plant.H, pendulum.loop.plant.x[1]
    heavier = dataclasses.replace(pendulum.loop.plant, H=H + H.subs({p: 0}) / 10)
    others = {"m": heavier}
    return measure(limited, starts=random_starts(limited, 4, 5), others=others)


def test_nobody_is_cheaper_than_the_optimum(found):
    """By more than the quadrature of the collocation."""
    for rating in (found.design, found.lqr):
        assert rating.cost_to_optimum > 0.995
        assert rating.worst_to_optimum >= rating.cost_to_optimum
    assert found.optimum.cost_to_optimum == pytest.approx(1.0)


def test_inputs_stay_within_the_limits(found):
    for rating in (found.design, found.lqr, found.optimum):
        assert rating.peak_u.max() <= 1.2 + 1e-6
    assert found.lqr.peak_demand.max() > 1.2
    for curve in found.step:
        assert np.nanmax(np.abs(curve.u)) <= 1.2 + 1e-6


def test_the_step_starts_one_size_below_and_ends_at_the_target(found, limited):
    for curve in found.step:
        assert curve.x[0, 0] == pytest.approx(np.pi / 4 - limited.sizes.state[0])
        assert curve.x[-1, 0] == pytest.approx(np.pi / 4, abs=0.02)


def test_errors_are_in_the_units_of_the_model(found, limited):
    heavier, disturbed = found.errors.parameters["m"], found.errors.disturbance
    assert 0.01 < heavier[0] < 0.2
    assert 0.01 < disturbed[0] < 0.2
    assert heavier[1] == pytest.approx(0.0, abs=1e-9)


def test_every_loop_is_its_transfer_at_a_frequency(found, limited):
    loop = next(one for one in found.loops if one.name == "this design")
    A, B, C, _ = limited.loop_transfer()
    sweep = loop.inputs[0]
    for k in (10, len(sweep.w) // 2):
        expected = (C @ np.linalg.solve(1j * sweep.w[k] * np.eye(len(A)) - A, B))[0, 0]
        assert sweep.L[k] == pytest.approx(expected, rel=1e-9)
