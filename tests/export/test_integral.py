"""Integral action in C: ζ comes off u, follows the position error and keeps its limits."""

import subprocess
from dataclasses import replace

import numpy as np
import pytest
import sympy as sp
from helpers.export_cases import COMPILERS, STRICT
from helpers.velocity import arm, pendulum

from necc_casadi.certificate.prover.certify import certify
from necc_casadi.export.c_project import export_c
from necc_casadi.export.compiled import compile_controller
from necc_casadi.export.header import header
from necc_casadi.export.integral_margin import integral_margin
from necc_casadi.export.sampled_loop import analyse_sampling, spectral_radius
from necc_casadi.export.source import Source
from necc_casadi.synthesis.integral import with_integral


@pytest.fixture(scope="module", params=[pendulum, arm], ids=["pendulum", "arm"])
def made(request):
    return with_integral(request.param())


@pytest.mark.parametrize("real", ["double", "float"])
def test_a_step_moves_zeta_by_the_position_error(made, real):
    compiled = compile_controller(made, real=real, flags=STRICT)
    m, tolerance = made.loop.plant.m, {"double": 1e-12, "float": 1e-4}[real]
    y = np.float32(np.concatenate([made.z_star[:m] + 0.25, np.full(m, -0.5)])).astype(float)
    xi, zeta = made.xi_star + 0.1, np.full(m, 0.25)
    u, kept, flags = compiled.step([*xi, *zeta], y, 0.01)
    assert flags == 0
    wanted, rate = made.measured_controller.call([y, np.concatenate([xi, zeta])])
    assert u == pytest.approx(np.asarray(wanted).ravel(), rel=tolerance)
    moved = zeta + 0.01 * np.asarray(rate, float).ravel()[m:]
    assert kept[m:] == pytest.approx(moved, rel=tolerance)
    state = made.lyapunov.state(y)
    inputs = np.array(made.loop.plant.G[m:, :].evalf(), float)
    error = inputs.T @ (state[:m] - made.z_star[:m]) + made.integral.tau * inputs.T @ y[m:]
    assert moved == pytest.approx(zeta + 0.01 * made.integral.gain * error)
    _, kept, _ = compiled.step([*xi, *(0.999 * made.integral.limit)], y + 50.0, 10.0)
    assert kept[m:] == pytest.approx(made.integral.limit)
    _, kept, _ = compiled.step([*xi, *(-made.integral.limit)], y - 50.0, 10.0)
    assert kept[m:] == pytest.approx(-made.integral.limit)


def test_zeta_goes_on_where_casimirs_are_kept(made):
    """ζ advances with the x of the last sample, as with the other methods; ξ follows x."""
    options = {"integrator": "casimir", "sample_time": 0.01}
    m, rng = made.loop.plant.m, np.random.default_rng(0)
    one, other = compile_controller(made, flags=STRICT, **options), compile_controller(made)
    ys = made.z_star[: 2 * m] + 0.1 * rng.normal(size=(5, 2 * m))
    start, dts = [*made.xi_star, *np.full(m, 0.125)], [0, *np.full(4, 0.01)]
    runs = [code.samples(start, ys, dts) for code in (one, other)]
    assert np.array_equal(runs[0][1][:, m:], runs[1][1][:, m:])
    assert np.array_equal(runs[0][0][0], runs[1][0][0])
    law = made.measured_controller
    u = [
        np.asarray(law.call([y, kept])[0], float).ravel()
        for y, kept in zip(ys, runs[0][1], strict=True)
    ]
    assert runs[0][0] == pytest.approx(np.array(u), rel=1e-12, abs=1e-12)
    radii = [spectral_radius(made, 1e-3, name) for name in ("casimir", "heun")]
    assert radii[0] == pytest.approx(radii[1], abs=1e-5)
    assert radii[0] < 1


def test_bad_measurements_leave_zeta_alone(made):
    compiled, m = compile_controller(made), made.loop.plant.m
    kept = [*made.xi_star, *np.full(m, 0.25)]
    for bad in (np.nan, np.inf):
        y = np.full(2 * m, 0.1)
        y[0] = bad
        u, after, flags = compiled.step(kept, y, 0.01)
        assert (flags, list(u), list(after)) == (2, [0.0] * m, kept)


def test_float_keeps_what_rounding_takes_from_zeta(made):
    """Steps far below the spacing of ζ add up."""
    compiled, m = compile_controller(made, real="float"), made.loop.plant.m
    y = np.concatenate([made.z_star[:m] + 0.25, np.zeros(m)])
    zeta, dt, steps = np.full(m, 0.25), 1e-9 * made.units.time, 20_000
    state = compiled._state([*made.xi_star, *zeta])
    u = (compiled.real * m)()
    rate = np.asarray(made.measured_controller.call([y, np.concatenate([made.xi_star, zeta])])[1])
    rate, spacing = rate.ravel()[m:].astype(float), np.spacing(np.float32(0.25))
    assert (np.abs(rate * dt) < spacing / 4).all()
    for _ in range(steps):
        compiled._function("step")(state, compiled._array(y, 2 * m), u, compiled.real(dt))
    moved = np.array(list(state)[m : 2 * m]) - zeta
    np.testing.assert_allclose(moved, (steps - 1) * dt * rate, rtol=1e-3, atol=spacing)
    assert np.abs(moved).max() > 5 * spacing


def test_the_code_leaves_no_offset(made):
    """The compiled controller beside the plant, under a constant force."""
    compiled, V = compile_controller(made), made.lyapunov
    m, n = made.loop.plant.m, made.loop.plant.n
    T = made.units.time / 200

    def rate(x, u):
        drift = np.asarray(V.terms.drift(x), float).ravel()
        return drift + np.asarray(V.terms.directions(x), float) @ u

    x = made.z_star[:n] + 0.2
    kept = np.concatenate([compiled.init(), np.zeros(m)])
    for _ in range(24_000):
        u, kept, _ = compiled.step(kept, V.measured(x), T)
        u = u + 0.3
        k1 = rate(x, u)
        k2 = rate(x + T / 2 * k1, u)
        k3 = rate(x + T / 2 * k2, u)
        x = x + T / 6 * (k1 + 2 * k2 + 2 * k3 + rate(x + T * k3, u))
        if np.abs(x[:m] - made.z_star[:m]).max() < 1e-9 and np.abs(k1).max() < 1e-9:
            break
    assert np.abs(x[:m] - made.z_star[:m]).max() < 1e-9


def test_the_files_compile_run_and_say_it(made, tmp_path):
    export_c(made, tmp_path, measured=False)
    for name in ("selftest", "main"):
        command = [COMPILERS[0], *STRICT, f"{name}.c", "necc.c", "-o", name, "-lm"]
        subprocess.run(command, cwd=tmp_path, check=True)
    subprocess.run(["./selftest"], cwd=tmp_path, check=True)
    run = subprocess.run(["./main", "3"], cwd=tmp_path, check=True, capture_output=True, text=True)
    assert "zeta1" in run.stdout.splitlines()[0]
    text = header(Source(made))
    assert "#define NECC_HAS_INTEGRAL 1" in text
    assert f"tau = {made.integral.tau:.6g}" in text
    plain = header(Source(replace(made, integral=None)))
    assert "NECC_HAS_INTEGRAL 0" in plain
    assert "zeta" not in plain


def test_the_sampled_loop_has_zeta_among_its_states(made):
    """Its slowest mode is that of the continuous loop, for a short sample."""
    T = made.units.time / 1000
    radius = spectral_radius(made, T)
    assert radius == pytest.approx(np.exp(made.abscissa * T), rel=1e-5)
    assert analyse_sampling(made, T).largest_stable > T


@pytest.mark.parametrize("real", ["double", "float"])
def test_the_margin_of_the_code_is_that_of_python(real):
    made = with_integral(pendulum(), disturbance=[(-0.2, 0.3)])
    certificate = certify(made, disturbance=[(sp.Rational(-1, 5), sp.Rational(3, 10))])
    margin = integral_margin(made, certificate)
    compiled = compile_controller(made, certificate=certificate, real=real, flags=STRICT)
    rng, low = np.random.default_rng(0), 0
    for _ in range(30):
        y, xi, zeta = rng.uniform(-4, 4, 2), rng.uniform(-4, 4, 1), rng.uniform(-1, 1, 1)
        wanted, found = margin(y, xi, zeta), compiled.margin(y, [*xi, *zeta])
        assert found == pytest.approx(wanted, abs={"double": 1e-9, "float": 1e-2}[real])
        low += wanted == -1
    assert 0 < low < 30
    assert compiled.margin(made.z_star[:2], [*made.xi_star, 0.0]) > 0.9
    assert compiled.margin([np.nan, 0.0], [0.0, 0.0]) == -1
    assert compiled.margin([0.75, 1e300], [0.0, 0.0]) == -1
    text = header(Source(made, certificate=certificate))
    assert "NECC_HAS_MARGIN 1" in text
    assert "every zeta* in [-0.2, 0.3]" in " ".join(text.split())
