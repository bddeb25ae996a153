"""Margins: known by hand, and those of python-control."""

import control
import numpy as np
import pytest

from necc_casadi.performance.margins import _response, margins


def of(numerator, denominator):
    system = control.ss(control.tf(numerator, denominator))
    return margins(system.A, system.B, system.C)


def test_three_equal_lags_by_hand():
    """k/(s + 1)³ has Im L = 0 at ω = √3, where |L| = k/8."""
    found = of([2.0], [1, 3, 3, 1])
    assert found.gain == pytest.approx(4.0, rel=1e-9)
    assert found.gain_down == 0.0
    crossing = np.sqrt(2 ** (2 / 3) - 1)
    phase = np.pi - 3 * np.arctan(crossing)
    assert found.phase_deg == pytest.approx(np.degrees(phase), rel=1e-9)
    assert found.delay == pytest.approx(phase / crossing, rel=1e-9)


def test_an_unstable_plant_needs_gain():
    """3/(s − 1): stable down to a third of the gain, for any larger gain."""
    found = of([3.0], [1, -1])
    assert found.gain_down == pytest.approx(1 / 3, rel=1e-9)
    assert found.gain == np.inf
    assert found.disk == pytest.approx(1.0, rel=1e-6)  # S − T = (s − 4)/(s + 2) is 2 at rest


def test_a_lead_that_never_crosses_has_no_phase_to_lose():
    found = of([0.5], [1, 1])
    assert (found.phase_deg, found.delay, found.gain) == (np.inf, np.inf, np.inf)
    assert found.disk == pytest.approx(2.0)  # |S − T| = |s + ½|/|s + 3/2| < 1


def test_narrow_resonances_are_found():
    """A peak of relative width 1e-5 beside slow dynamics."""
    found = of([1e-3], np.polymul([1, 1e-4, 100], [1, 0.01]))
    system = control.tf([1e-3], np.polymul([1, 1e-4, 100], [1, 0.01]))
    gain, phase, *_ = control.stability_margins(system)
    assert found.gain == pytest.approx(gain, rel=1e-6)
    assert found.phase_deg == pytest.approx(phase, rel=1e-6)


@pytest.mark.parametrize("name", ["default", "paper", "neural"])
def test_one_input_agrees_with_python_control(designs, name):
    A, B, C, D = designs[name].loop_transfer()
    found, system = margins(A, B, C), control.ss(A, B, C, D)
    gains, phases, _, _, crossings, _ = control.stability_margins(system, returnall=True)
    up, down = gains[(gains > 1) & np.isfinite(gains)], gains[(gains < 1) & (gains > 1e-9)]
    assert found.gain == pytest.approx(up.min(initial=np.inf), rel=1e-6)
    assert found.gain_down == pytest.approx(down.max(initial=0.0), rel=1e-6)
    assert found.phase_deg == pytest.approx(abs(phases).min(), rel=1e-6)
    delays = np.radians(np.where(phases > 0, phases, phases + 360)) / crossings
    assert found.delay == pytest.approx(delays.min(), rel=1e-6)


def test_the_disk_of_one_input_agrees_with_python_control(default_design):
    A, B, C, D = default_design.loop_transfer()
    on_a_grid = control.disk_margins(control.ss(A, B, C, D), np.logspace(-3, 3, 4000))[0]
    assert margins(A, B, C).disk == pytest.approx(on_a_grid, rel=1e-4)


@pytest.mark.parametrize("name", ["default", "joint", "coupled"])
def test_the_disk_of_all_inputs_agrees_with_python_controls_sensitivities(designs, name):
    A, B, C, D = designs[name].loop_transfer()
    found = margins(A, B, C).disk
    L, identity = control.ss(A, B, C, D), control.ss([], [], [], np.eye(len(D)))
    difference = control.feedback(identity, L) - control.feedback(L, identity)  # S − T
    response = control.frequency_response(difference, np.logspace(-3, 3, 4000), squeeze=False)
    values = np.moveaxis(response.complex, -1, 0)
    on_a_grid = 2 / np.linalg.svd(values, compute_uv=False).max()
    assert found <= on_a_grid * (1 + 1e-9)  # a grid misses the peak
    assert found == pytest.approx(on_a_grid, rel=1e-4)


@pytest.mark.parametrize("name", ["default", "joint", "coupled", "neural"])
def test_closing_the_opened_loop_gives_the_loop_back(designs, name):
    made = designs[name]
    A, B, C, _ = made.loop_transfer()
    closed = made.lyapunov.linearisation(made.z_bar)
    np.testing.assert_allclose(A - B @ C, closed, atol=1e-9 * abs(closed).max())


@pytest.mark.parametrize("name", ["default", "coupled"])
def test_margins_of_a_design_are_python_controls(designs, name):
    """Each input broken with the others closed, by python-control from `loop_transfer` alone."""
    made = designs[name]
    A, B, C, D = made.loop_transfer()
    found, m = margins(A, B, C), made.loop.plant.m
    phases = []
    for i in range(m):
        others = [j for j in range(m) if j != i]
        closed = A - B[:, others] @ C[others]
        _, phase, _, *_ = control.margin(control.ss(closed, B[:, [i]], C[[i]], D[[i], [i]]))
        every = control.stability_margins(
            control.ss(closed, B[:, [i]], C[[i]], D[[i], [i]]), returnall=True
        )[1]
        phases += [phase, *np.abs(every)]
    assert found.phase_deg == pytest.approx(min(np.abs(phases)), rel=1e-3)


def test_a_frequency_that_is_a_pole_has_a_response():
    """To the last digit: the resolvent is singular there, and L as large as numbers tell."""
    A, B, C = np.array([[0.0, 1.0], [-1.0, 0.0]]), np.array([[0.0], [1.0]]), np.array([[1.0, 0.0]])
    at_pole, beside = np.abs(_response(A, B, C, np.array([1.0, 1.1])))[:, 0, 0]
    assert 1e12 < at_pole < np.inf
    assert beside == pytest.approx(1 / (1.1**2 - 1))
