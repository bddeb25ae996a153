"""Minima of V below the one at the target: found where they are, and nowhere else."""

from pathlib import Path

import numpy as np
import pytest
from helpers.problems import problem, solve

from necc_casadi.certificate.prover.certify import certify
from necc_casadi.model.model_file import load_model
from necc_casadi.performance.other_minima import lower_minimum
from necc_casadi.performance.shares import holds, plant_share, sampled_share, unclipped_share
from necc_casadi.synthesis.options import Options

EXAMPLES = Path(__file__).parents[2] / "examples"
MOTOR = "phi=sqrt(2)/2,p=0,theta=pi/4"


@pytest.fixture(scope="module")
def motor():
    return solve(problem(load_model(EXAMPLES / "dc_motor.py"), MOTOR))


def test_a_lower_minimum_is_a_minimum_and_lower(motor):
    found = lower_minimum(motor)
    z = np.array([found.at.get(name, 0.0) for name in motor.loop.states])
    assert np.abs(motor.lyapunov.gradient(z)).max() < 1e-6
    assert np.linalg.eigvalsh(motor.lyapunov.hessian(z))[0] > 0
    assert motor.V(motor.z_bar) - motor.V(z) == pytest.approx(found.below, rel=1e-9)
    assert found.below > 0.1


def test_there_is_none_where_one_critical_point_is_proved(pendulum):
    made = solve(pendulum, Options(whole=True, least_cost=True))
    assert certify(made).is_global
    assert lower_minimum(made) is None


def test_a_minimum_that_is_higher_is_not_named(default_design):
    assert lower_minimum(default_design) is None  # one at q = 5.29, above V(z̄)


def test_shares_are_those_of_the_region(default_design):
    certificate = certify(default_design)
    share = plant_share(default_design, certificate)
    assert sampled_share(default_design, certificate) < share < 1
    starts = np.array([default_design.z_bar, default_design.z_bar + np.array([5, 0, 0])])
    assert holds(default_design, certificate, starts).tolist() == [True, False]
    assert unclipped_share(default_design, certificate) is None


def test_nothing_is_held_without_a_region(default_design):
    certificate = certify(default_design, region=False)
    assert plant_share(default_design, certificate) == 0
    assert not holds(default_design, certificate, default_design.z_bar[None]).any()
