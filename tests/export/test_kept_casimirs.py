"""Casimirs kept: the scheme against Python, its energy balance, its local limit, its refusals."""

import ctypes
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import sympy as sp
from helpers.constructed import EXAMPLES
from helpers.export_cases import STRICT, design, pendulum_loop
from helpers.velocity import pendulum as sprung_pendulum
from numpy.testing import assert_allclose, assert_array_equal
from scipy.integrate import solve_ivp

from necc_casadi.casimirs.casimirs import Casimirs
from necc_casadi.casimirs.find import find_casimirs
from necc_casadi.casimirs.outputs import integrated_outputs
from necc_casadi.errors import OptionError
from necc_casadi.export.compiled import compile_controller
from necc_casadi.export.kept_casimirs import kept_casimirs
from necc_casadi.export.sampled_loop import largest_stable_time, spectral_radius
from necc_casadi.export.source import Source
from necc_casadi.export.vectors import next_state
from necc_casadi.lyapunov.networks import Network
from necc_casadi.lyapunov.parameterization import Form
from necc_casadi.model.closed_loop import interconnect
from necc_casadi.model.controller import default_controller
from necc_casadi.model.model_file import load_model
from necc_casadi.model.plant import make_plant

REJECTED = 2


def links():
    """Two links with friction, an input of its own for each, Casimirs in another combination."""
    q1, q2, p1, p2 = x = sp.symbols("q1 q2 p1 p2", real=True)
    J = sp.Matrix(4, 4, lambda i, j: 1 if j == i + 2 else -1 if i == j + 2 else 0)
    R = sp.diag(0, 0, sp.Rational(1, 10), sp.exp(-(q1**2)))
    H = p1**2 / (3 + 2 * sp.cos(q2)) / 2 + p2**2 / 2 + sp.sqrt(2 + sp.sin(q1)) + sp.cos(q2)
    G = sp.Matrix([[0, 0], [0, 0], [1, 0], [sp.Rational(1, 4), 2]])
    loop = interconnect(plant := make_plant(x, J, R, G, H), default_controller(plant))
    xi1, xi2 = loop.controller.xi
    c1, c2 = q1 + q2 / 4 - xi1, 2 * q2 - xi2
    return loop, Casimirs((c1 + 3 * c2, c2 - c1), 2, 2)


def made(which="pendulum", seed=0):
    """Random weights on a quadratic part; a full damping where the seed is odd."""
    if which == "pendulum":
        form = Form(Network(1, (8,), quadratic=True), Network(1, (8,), quadratic=True))
        return design(pendulum_loop(), form, seed)
    form = Form(Network(2, (5,), quadratic=True), Network(2, (9,), quadratic=True))
    return design(links(), form, seed)


def uncoupled(d):
    """The same with a damping of plant and controller apart."""
    m, damping = d.loop.plant.m, d.damping.copy()
    damping[:m, m:] = damping[m:, :m] = 0
    return replace(d, damping=damping)


def motion(d, x, u, time):
    """x after `time` with u held, the work lost and ∫y, to twelve digits."""
    terms, n, m = d.lyapunov.terms, d.loop.plant.n, d.loop.plant.m
    G, R = (sp.lambdify(d.loop.plant.x, A, "numpy") for A in (d.loop.plant.G, d.loop.plant.R))

    def rate(_, s):
        slope = np.asarray(terms.grad_H(s[:n]), float).ravel()
        f = np.asarray(terms.drift(s[:n]), float).ravel() + np.asarray(G(*s[:n]), float) @ u
        lost = slope @ np.asarray(R(*s[:n]), float) @ slope
        return np.concatenate([f, [lost], np.asarray(G(*s[:n]), float).T @ slope])

    start = np.concatenate([x, np.zeros(1 + m)])
    end = solve_ivp(rate, (0, time), start, "DOP853", rtol=1e-13, atol=1e-14).y[:, -1]
    return end[:n], end[n], end[n + 1 :]


def without_damping(d):
    return replace(d, damping=np.zeros_like(d.damping))


def controller_slope(bare, xi):
    """∇Hc of a design without damping: its u is −Gcᵀ∇Hc."""
    Gc = np.array(bare.loop.controller.Gc, float)
    return -np.linalg.solve(Gc.T, bare.control(bare.z_star[: bare.loop.plant.n], xi)[0])


def gradient_steps(d, source, x, xi, time):
    """Every ξ on the way of the steps at x."""
    kept, m, way = kept_casimirs(d), source.substeps, [xi]
    for _ in range(m):
        way.append(way[-1] + time / m * np.asarray(kept.rate(x, way[-1]), float).ravel())
    return way


def test_what_the_outputs_are_rates_of():
    q1, q2 = sp.symbols("q1 q2", real=True)
    loop, casimirs = links()
    assert integrated_outputs(loop, casimirs.functions) == (q1 + q2 / 4, 2 * q2)
    slope = sp.Matrix(integrated_outputs(loop, casimirs.functions)).jacobian(loop.plant.x)
    assert (slope * loop.plant.G).is_zero_matrix
    assert sp.simplify(slope * (loop.plant.J - loop.plant.R) - loop.plant.G.T).is_zero_matrix


@pytest.mark.parametrize(
    ("name", "why"),
    [("dc_motor", "moves by itself"), ("parallel_rlc", "not the rate of a function")],
)
def test_other_plants_are_refused_in_two_lines(name, why):
    loop = load_model(EXAMPLES / f"{name}.py").loop
    with pytest.raises(OptionError, match=why) as refused:
        integrated_outputs(loop, find_casimirs(loop).functions)
    assert len(str(refused.value).splitlines()) == 2


def test_other_forms_and_no_sample_time_are_refused():
    d = made()
    with pytest.raises(OptionError, match="without --sample-time"):
        Source(d, integrator="casimir")
    with pytest.raises(OptionError, match="At most"):
        Source(d, integrator="casimir", sample_time=1e6)
    for sum_form in (Form(Network(1, (3,)), Network(1, (3,)), (Network(1, ()),)),):
        with pytest.raises(OptionError, match="curvature"):
            Source(design(pendulum_loop(), sum_form), integrator="casimir", sample_time=0.1)


@pytest.mark.parametrize("which", ["pendulum", "links"])
@pytest.mark.parametrize("real", ["double", "float"])
def test_c_does_what_python_does(which, real):
    """Random measurements at random periods, several updates for one, and the longest period."""
    d, rng = made(which, seed=1), np.random.default_rng(2)
    options = {"integrator": "casimir", "sample_time": 0.25, "real": real}
    source, number = Source(d, **options), Source(d, **options).number
    compiled = compile_controller(d, flags=STRICT, **options)
    after = next_state(source)
    xs = number.rounded(rng.normal(size=(40, d.loop.plant.n)))
    dts = number.rounded(np.array([0, *rng.uniform(0, 0.25, 38), 50.0]))
    us, xis, flags = compiled.samples(d.xi_star, xs, dts)
    assert set(flags) == {0}
    tolerance = {"double": 1e-12, "float": 2e-4}[real]
    xi = number.rounded(d.xi_star)
    assert_array_equal(xis[0], xi)
    for k in range(1, 40):
        xi = after(xs[k - 1], xi, dts[k], xs[k])
        assert_allclose(xis[k], xi, rtol=tolerance, atol=tolerance)
        u = d.control(xs[k], xi)[0]
        assert_allclose(us[k], u, rtol=tolerance, atol=tolerance * (1 + np.abs(u).max()))


@pytest.mark.parametrize("real", ["double", "float"])
def test_what_is_kept_is_exact(real):
    """Where no time passes, ξ comes back to the bit with x; several updates are one."""
    d = made("links")
    options = {"integrator": "casimir", "sample_time": 0.25, "real": real}
    compiled, rng = compile_controller(d, flags=STRICT, **options), np.random.default_rng(0)
    xs = rng.normal(size=(50, 4))
    xs = np.vstack([xs, xs[::-1]])
    _, xis, _ = compiled.samples(d.xi_star, xs, np.zeros(100))
    assert_array_equal(xis[1:50], xis[50:99][::-1])
    one, many = compiled.running(), compiled.running()
    for running in (one, many):
        assert running.step(xs[0], 0.0)[1] == 0
    for k in range(1, 20):
        for _ in range(8):
            assert compiled._function("update")(many.state, compiled.real(2**-6)) == 0
        assert_array_equal(one.step(xs[k], 2**-3)[0], many.step(xs[k], 0.0)[0])
        assert_array_equal(one.xi, many.xi)


def test_float_keeps_what_rounding_takes_away():
    """Many steps of damping far below the spacing of what is kept add up."""
    d, ends = made(), {}
    x, dts = np.array([0.5, 0.25]), np.array([0.0, *np.full(1500, 2.0**-29)])
    for real in ("double", "float"):
        options = {"integrator": "casimir", "sample_time": 0.25, "real": real}
        xis = compile_controller(d, **options).samples([1.0], [x] * 1501, dts)[1]
        ends[real] = xis[-1, 0] - xis[0, 0]
    assert abs(ends["double"]) > 1e-5
    assert abs(ends["double"]) / 1500 < np.finfo(np.float32).eps / 4
    assert ends["float"] == pytest.approx(ends["double"], abs=2e-7)


def test_a_controller_that_starts_anew_forgets_what_it_kept():
    d = made()
    compiled = compile_controller(d, integrator="casimir", sample_time=0.25, flags=STRICT)
    used, fresh = compiled.running([0.5, 0.1]), compiled.running()
    for k in range(5):
        used.step([0.1 * k, 0.3], 0.125)
    assert used.xi != pytest.approx(d.xi_star)
    compiled._function("init")(used.state)
    assert_array_equal(used.xi, fresh.xi)
    for k in range(5):
        x = [0.2 - 0.1 * k, 0.3]
        assert_array_equal(used.step(x, 0.125)[0], fresh.step(x, 0.125)[0])
        assert_array_equal(used.xi, fresh.xi)


def test_a_rejected_sample_changes_nothing():
    d = made()
    compiled = compile_controller(d, integrator="casimir", sample_time=0.25, flags=STRICT)
    running, other = compiled.running(), compiled.running()
    for each in (running, other):
        each.step([0.5, 0.1], 0.0)
        assert compiled._function("update")(each.state, compiled.real(0.125)) == 0
    u = (ctypes.c_double * 1)()
    bad = compiled._array([np.nan, 0.0], 2)
    assert compiled._function("output")(running.state, bad, u) == REJECTED
    assert u[0] == 0
    assert running.step([0.7, np.inf], 0.125)[1] == REJECTED
    assert running.step([0.7, 0.2], -1.0)[1] == REJECTED
    assert_array_equal(running.step([0.7, 0.2], 0.125)[0], other.step([0.7, 0.2], 0.125)[0])
    assert_array_equal(running.xi, other.xi)


@pytest.mark.parametrize("which", ["pendulum", "links"])
@pytest.mark.parametrize("seed", [0, 1])
def test_the_energy_balance_is_exact(which, seed):
    """ΔV = −∫∇HᵀR∇H + vᵀ∫y + ½ΔξᵀH̄Δξ over a hold, whatever its length; then the steps of ξ."""
    d, rng = made(which, seed), np.random.default_rng(seed)
    n, nodes = d.loop.plant.n, np.polynomial.legendre.leggauss(40)
    theta, weights = (nodes[0] + 1) / 2, nodes[1] / 2
    Gc = np.array(d.loop.controller.Gc, float)
    gamma, bare = kept_casimirs(d).gamma, without_damping(d)
    for time in (0.01, 0.3, 1.0):
        x, xi = rng.normal(size=n), rng.normal(size=d.loop.controller.nc)
        u = d.control(x, xi)[0]
        v = u + Gc.T @ controller_slope(bare, xi)
        end, lost, outputs = motion(d, x, u, time)
        moved = Gc @ outputs
        assert_allclose(
            moved, (np.asarray(gamma(end), float) - np.asarray(gamma(x), float)).ravel(), atol=1e-10
        )
        H_bar = np.zeros(2 * (len(xi),))
        for t, w in zip(theta, weights, strict=True):
            h = 1e-5
            H = np.array(
                [
                    (
                        controller_slope(bare, xi + t * moved + h * e)
                        - controller_slope(bare, xi + t * moved - h * e)
                    )
                    / (2 * h)
                    for e in np.eye(len(xi))
                ]
            )
            H_bar += 2 * w * (1 - t) * H
        wanted = -lost + v @ outputs + moved @ H_bar @ moved / 2
        change = d.V(np.concatenate([end, xi + moved])) - d.V(np.concatenate([x, xi]))
        assert change == pytest.approx(wanted, abs=1e-9)
        assert abs(change) > 1e-5


@pytest.mark.parametrize("which", ["pendulum", "links"])
def test_each_step_of_xi_goes_down(which):
    """By half of what damping takes in that time at least, and the bound of ∂²V/∂ξ² is above it."""
    d, rng = uncoupled(made(which, seed=1)), np.random.default_rng(3)
    n, kept = d.loop.plant.n, kept_casimirs(uncoupled(made(which, seed=1)))
    source = Source(d, integrator="casimir", sample_time=2.0)
    assert source.substeps > 1
    h = 2.0 / source.substeps
    assert h * kept.fastest < 1
    Gc = np.array(d.loop.controller.Gc, float)
    for _ in range(50):
        x, xi = 2 * rng.normal(size=n), 2 * rng.normal(size=d.loop.controller.nc)
        hessian = d.lyapunov.hessian(np.concatenate([x, xi]))[n:, n:]
        curvature = np.linalg.eigvals(Gc @ d.Dc @ Gc.T @ hessian).real.max()
        assert curvature < kept.fastest * np.linalg.norm(d.Dc, 2) * np.linalg.norm(
            np.linalg.inv((d.Dc + d.Dc.T) / 2), 2
        )
        way = gradient_steps(d, source, x, xi, 2.0)
        for before, after in pairwise(way):
            w = Gc.T @ d.lyapunov.gradient(np.concatenate([x, before]))[n:]
            change = d.V(np.concatenate([x, after])) - d.V(np.concatenate([x, before]))
            assert change <= -h * w @ d.Dc @ w / 2 + 1e-12


@pytest.mark.parametrize("time", [0.02, 0.3])
@pytest.mark.parametrize("which", ["pendulum", "links"])
def test_the_radius_is_that_of_the_loop_in_c(which, time):
    """The Jacobian of samples made by necc_step and an accurate plant, by central differences."""
    d = made(which, seed=1)
    n, nc, z = d.loop.plant.n, d.loop.controller.nc, d.z_bar
    compiled = compile_controller(d, integrator="casimir", sample_time=time, flags=STRICT)

    def sample(z):
        state = compiled._state(z[n:])
        running = compiled.running()
        running.state[: len(state)] = state
        u, _ = running.step(z[:n], 0.0)
        x = motion(d, z[:n], u, time)[0]
        running.step(x, time)
        return np.concatenate([x, running.xi])

    assert np.abs(sample(z) - z).max() < 1e-9
    h = 1e-5
    columns = [(sample(z + h * e) - sample(z - h * e)) / (2 * h) for e in np.eye(n + nc)]
    radius = np.abs(np.linalg.eigvals(np.array(columns).T)).max()
    assert spectral_radius(d, time, "casimir") == pytest.approx(radius, abs=1e-6)


def test_V_rises_at_some_state_for_every_period():
    """R = 0, y = 0, ∂V/∂ξ = 0: by ⅛T⁴ẏᵀHc″ẏ, so that no claim of decrease could be proved."""
    d, rest = uncoupled(made()), made().z_bar
    bare = without_damping(d)
    for xi in rest[2] + np.array([0.3, -0.2]):
        lo, hi = rest[0] - 3.0, rest[0] + 3.0  # ∂V/∂ξ falls with q
        slope = lambda q: d.lyapunov.gradient(np.array([q, 0.0, xi]))[2]  # noqa: B023, E731
        for _ in range(200):
            middle = (lo + hi) / 2
            lo, hi = (lo, middle) if slope(lo) * slope(middle) <= 0 else (middle, hi)
        x = np.array([lo, 0.0])
        u = d.control(x, [xi])[0]
        alpha = u[0] - np.sin(lo)
        h = 1e-4
        slopes = [controller_slope(bare, np.array([xi + sign * h]))[0] for sign in (1, -1)]
        bend = (slopes[0] - slopes[1]) / (2 * h)
        for time in (0.02, 0.05):
            end, _, outputs = motion(d, x, u, time)
            rise = d.V(np.concatenate([end, xi + outputs])) - d.V(np.concatenate([x, [xi]]))
            assert rise == pytest.approx(time**4 * alpha**2 * bend / 8, rel=0.1)


def test_the_local_limit_has_a_side():
    """Each of the two schemes is stable at longer periods somewhere: it is no ranking."""
    d = made()
    assert largest_stable_time(d, "casimir") > largest_stable_time(d)
    stiff = sprung_pendulum()
    times = {i: largest_stable_time(stiff, i) for i in ("heun", "casimir")}
    assert all(time is not None for time in times.values())
