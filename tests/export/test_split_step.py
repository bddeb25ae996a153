"""``necc_update`` and ``necc_output``, the halves of ``necc_step``, and what rounding leaves."""

import ctypes

import numpy as np
import pytest
from helpers.export_cases import STRICT, arm_loop, design, pendulum_loop
from numpy.testing import assert_allclose, assert_array_equal

from necc_casadi.export.compiled import compile_controller
from necc_casadi.lyapunov.networks import Network
from necc_casadi.lyapunov.parameterization import Form

REJECTED = 2


class Halves:
    """One controller in memory, sampled and advanced by separate calls."""

    def __init__(self, compiled, xi):
        self.compiled, self.state = compiled, compiled._state(xi)

    def output(self, x):
        c = self.compiled
        u = (c.real * c.m)()
        flags = c._function("output")(self.state, c._array(x, c.n), u)
        return np.array(u, float), int(flags)

    def update(self, dt):
        return int(self.compiled._function("update")(self.state, self.compiled.real(dt)))

    @property
    def xi(self):
        return np.array(self.state, float)[: self.compiled.nc]


def heun(f, y, dt):
    k1 = f(y)
    return y + dt / 2 * (k1 + f(y + dt * k1))


@pytest.fixture(scope="module", params=["double", "float"])
def arm(request):
    d = design(arm_loop(), Form(Network(2, (5,)), Network(2, (9,))))
    return d, compile_controller(d, real=request.param, flags=STRICT)


def test_output_then_update_gives_the_bits_of_step(arm):
    d, compiled = arm
    rng = np.random.default_rng(1)
    xs, dts = rng.normal(size=(40, 4)), rng.uniform(1e-4, 0.1, 40)
    us, xis, _ = compiled.samples(d.xi_star, xs, dts)
    halves = Halves(compiled, d.xi_star)
    for k, x in enumerate(xs):
        u, flags = halves.output(x)
        assert flags == 0
        assert_array_equal(u, us[k])
        assert_array_equal(halves.xi, xis[k])
        if k + 1 < len(xs):  # after u has left
            assert halves.update(dts[k + 1]) == 0


def test_two_updates_are_two_steps_of_the_method(arm):
    d, compiled = arm
    tolerance = 1e-12 if compiled.real is ctypes.c_double else 1e-5
    halves, x = Halves(compiled, d.xi_star), [0.3, -0.2, 0.5, 0.1]
    halves.output(x)
    f = lambda s: d.control(x, s)[1]  # noqa: E731
    xi = np.array(d.xi_star)
    for dt in (0.5, 0.2):
        halves.update(dt)
        xi = heun(f, xi, dt)
    assert_allclose(halves.xi, xi, rtol=0, atol=tolerance)
    once = heun(f, np.array(d.xi_star), 0.7)
    assert np.abs(once - xi).max() > 10 * tolerance  # one step of the whole is another point


def test_nothing_advances_before_the_first_sample_or_by_a_period_that_is_no_number(arm):
    d, compiled = arm
    halves = Halves(compiled, d.xi_star)
    assert halves.update(0.1) == 0
    start = halves.xi
    assert_allclose(start, d.xi_star, rtol=1e-6)
    halves.output([0.3, -0.2, 0.5, 0.1])
    for dt in (np.nan, np.inf, -0.1):
        assert halves.update(dt) == REJECTED
        assert_array_equal(halves.xi, start)
    u, flags = halves.output([np.nan, 0, 0, 0])
    assert (flags, *u) == (REJECTED, 0, 0)
    assert halves.update(0.1) == 0
    assert np.abs(halves.xi - start).max() > 1e-3  # the x before is held on


def test_float_keeps_what_rounding_takes_from_xi():
    """Steps a thousand times below the spacing of ξ add up; without the rest ξ would not move."""
    form = Form(Network(1, (5,)), Network(1, (6,)))
    d = design(pendulum_loop(), form)
    compiled = compile_controller(d, real="float", flags=STRICT)
    x, xi, dt, steps = [0.3, 0.2], np.float32(d.xi_star).astype(float), 1e-10, 20_000
    rate = d.control(x, xi)[1]
    assert abs(rate[0] * dt) < 1e-2 * np.spacing(np.float32(xi[0]))
    halves = Halves(compiled, xi)
    for _ in range(steps):
        halves.output(x)
        halves.update(dt)
    moved = halves.xi - xi
    assert_allclose(moved, steps * dt * rate, rtol=0, atol=np.spacing(np.float32(xi[0])))
    assert np.abs(moved).max() > 10 * np.spacing(np.float32(xi[0]))
