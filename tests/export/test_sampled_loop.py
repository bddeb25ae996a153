"""The sampled loop's spectral radius against the simulated loop."""

import numpy as np
import pytest
from helpers.dragged import ATTRACT, dragged
from helpers.export_cases import arm_loop, design, pendulum_loop

from necc_casadi.export.sampled_loop import (
    ORDERS,
    analyse_sampling,
    largest_stable_time,
    spectral_radius,
)
from necc_casadi.export.vectors import reference_step
from necc_casadi.lyapunov.networks import Network
from necc_casadi.lyapunov.parameterization import Form


def quadratic_pendulum(seed=0):
    form = Form(Network(1, (8,), quadratic=True), Network(1, (8,), quadratic=True))
    return design(pendulum_loop(), form, seed)


def sampled_step(d, integrator, time, substeps=64):
    """z ↦ z⁺ of the nonlinear sampled loop; the plant by many small RK4 steps."""
    terms = d.lyapunov.terms
    controller = reference_step(d, integrator)

    def plant(x, u):
        G = np.asarray(terms.directions(x), float)
        return (np.asarray(terms.drift(x), float) + G @ u).ravel()

    def step(z):
        x = z[: terms.n]
        u, xi = (np.asarray(v, float) for v in controller(x, z[terms.n :], time))
        h = time / substeps
        for _ in range(substeps):
            k1 = plant(x, u)
            k2 = plant(x + h / 2 * k1, u)
            k3 = plant(x + h / 2 * k2, u)
            x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + plant(x + h * k3, u))
        return np.concatenate([x, xi.ravel()])

    return step


@pytest.mark.parametrize("integrator", sorted(ORDERS))
@pytest.mark.parametrize("time", [0.02, 0.2])
def test_radius_is_that_of_the_simulated_loops_jacobian(integrator, time):
    d = quadratic_pendulum()
    step, z, h = sampled_step(d, integrator, time), d.z_bar, 1e-5
    columns = [(step(z + h * e) - step(z - h * e)) / (2 * h) for e in np.eye(z.size)]
    radius = np.abs(np.linalg.eigvals(np.array(columns).T)).max()
    assert np.abs(step(z) - z).max() < 1e-10
    assert spectral_radius(d, time, integrator) == pytest.approx(radius, abs=1e-7)


@pytest.mark.parametrize("integrator", sorted(ORDERS))
def test_the_largest_stable_time_is_where_the_radius_crosses_one(integrator):
    d = quadratic_pendulum()
    largest = largest_stable_time(d, integrator)
    assert largest is not None
    assert spectral_radius(d, 0.999 * largest, integrator) < 1
    assert spectral_radius(d, 1.001 * largest, integrator) > 1
    grid = np.linspace(1e-3, 0.99, 300) * largest
    assert all(spectral_radius(d, t, integrator) < 1 for t in grid)


def test_short_samples_approach_the_continuous_loop():
    d = quadratic_pendulum()
    abscissa = np.linalg.eigvals(d.linearise()[0]).real.max()
    assert np.log(spectral_radius(d, 1e-4)) / 1e-4 == pytest.approx(abscissa, rel=1e-3)


def test_warnings():
    d = quadratic_pendulum()
    largest = largest_stable_time(d)
    assert analyse_sampling(d, 0.4 * largest).warning is None
    assert "half" in analyse_sampling(d, 0.6 * largest).warning
    result = analyse_sampling(d, 1.2 * largest)
    assert result.spectral_radius > 1
    assert "not stable" in result.warning
    assert f"{largest:.3g} s" in result.warning


def test_a_mode_that_neither_decays_nor_grows_is_not_judged():
    result = analyse_sampling(dragged(ATTRACT["on both"]), 0.01)
    assert result.spectral_radius == pytest.approx(1, abs=1e-12)
    assert "not known" in result.warning


def test_an_unstable_loop_has_no_stable_sample_time():
    form = Form(Network(2, ()), Network(2, ()))
    d = design(arm_loop(), form, 2)
    if np.linalg.eigvals(d.linearise()[0]).real.max() >= 0:
        assert largest_stable_time(d) is None
