"""Limits of u that scale the damping injection: the C code and the simulations against the law.

The second route is the law written out in NumPy, the largest share found by bisection.
"""

import dataclasses
import subprocess

import casadi as ca
import numpy as np
import pytest
from helpers.constructed import full_damping, quadratic_pendulum, two_link_arm
from helpers.export_cases import STRICT, arm_loop, design
from hypothesis import example, given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from necc_casadi.casimirs.find import find_casimirs
from necc_casadi.export.c_project import export_c
from necc_casadi.export.compiled import compile_controller
from necc_casadi.export.source import Source
from necc_casadi.export.vectors import next_state, share_of_damping
from necc_casadi.lyapunov.damping import acts_alone, is_coupled, without_inputs
from necc_casadi.lyapunov.limits import scaled, share
from necc_casadi.lyapunov.networks import Network
from necc_casadi.lyapunov.parameterization import Form
from necc_casadi.model.closed_loop import interconnect
from necc_casadi.model.controller import default_controller

SATURATED = 1
D_FULL = np.array([[1.0, 0.9], [0.9, 1.0]])


def with_limits(made, limits, damping):
    plant = dataclasses.replace(made.loop.plant, u_limits=limits)
    loop = interconnect(plant, made.loop.controller)
    return dataclasses.replace(made, loop=loop, damping=damping)


def pendulum(limits=((-0.9, 0.4),)):
    """Single input, 𝒟 coupled with ξ and with a skew part."""
    made = quadratic_pendulum()
    return with_limits(made, limits, full_damping(made.damping))


def arm(coupled, limits=((-2.0, 2.5), (-1.0, 1.5))):
    made = design(arm_loop(), Form(Network(2, (5,)), Network(2, (9,))))
    damping = np.zeros((4, 4))
    damping[:2, :2], damping[2:, 2:] = D_FULL, np.diag([2.0, 3.0])
    return with_limits(
        made, limits, full_damping(np.diag(np.diag(damping))) if coupled else damping
    )


CASES = {"pendulum": pendulum, "arm": lambda: arm(False), "coupled arm": lambda: arm(True)}


@pytest.fixture(scope="module", params=CASES)
def made(request):
    return CASES[request.param]()


def by_hand(d, x, xi):
    """(u, ṡ, τ) by the definition: bisection for the largest τ that passes no limit."""
    terms, m = d.lyapunov.terms, d.loop.plant.m
    z = np.concatenate([x, xi])
    gradient = d.lyapunov.gradient(z)
    s = ca.MX.sym("s", len(xi))
    Hc = d.form.controller_energy(ca.DM(d.weights))(s)
    slope = np.asarray(ca.Function("slope", [s], [ca.gradient(Hc, s)])(xi), float).ravel()
    resting = -np.asarray(terms.feedback(z), float) @ slope
    injected = -d.damping @ np.asarray(terms.ports(z), float).T @ gradient
    low, high = np.array(d.loop.plant.u_limits, float).T

    def inside(tau):
        u = resting + tau * injected[:m]
        return np.all((u >= low) | (resting <= low)) and np.all((u <= high) | (resting >= high))

    a, b = 0.0, 1.0
    for _ in range(60):
        middle = (a + b) / 2
        a, b = (middle, b) if inside(middle) else (a, middle)
    tau = 1.0 if inside(1.0) else a
    u = np.clip(resting + tau * injected[:m], low, high)
    if is_coupled(d.damping, m):
        injected = tau * injected
    energy = np.concatenate([np.asarray(terms.grad_H(x), float).ravel(), slope])
    own = np.asarray(terms.own_structure(z), float) @ energy
    return u, own + np.asarray(terms.own_ports(z), float) @ injected, tau


def states(d, count, seed=3):
    rng, n = np.random.default_rng(seed), d.loop.plant.n
    spread = 0.5 * rng.normal(size=(count, len(d.z_star)))
    return [(z[:n], z[n:]) for z in d.z_star + spread]


def test_the_law_is_the_one_by_hand(made):
    """At states where nothing, some and all of the damping is lost."""
    taus = []
    for x, xi in states(made, 60):
        u, rate, tau = by_hand(made, x, xi)
        found = [np.asarray(v, float).ravel() for v in made.limited_controller.call([x, xi])]
        assert_allclose(found[0], u, rtol=1e-9, atol=1e-12)
        assert_allclose(found[1], rate, rtol=1e-9, atol=1e-9)
        assert float(share_of_damping(made)(x, xi)) == pytest.approx(tau, abs=1e-9)
        taus.append(tau)
    assert min(taus) < 0.5
    assert 1.0 in taus


def test_V_falls_where_the_inputs_without_damping_are_inside(made):
    """What damping adds to V̇, w̃ᵀṽ, is −τ w̃ᵀ𝒟w̃ at most, with the v_c that goes along."""
    terms, m = made.lyapunov.terms, made.loop.plant.m
    low, high = np.array(made.loop.plant.u_limits, float).T
    scaled = 0
    for x, xi in states(made, 400):
        z = np.concatenate([x, xi])
        w = np.asarray(terms.ports(z), float).T @ made.lyapunov.gradient(z)
        u = np.asarray(made.control(x, xi)[0], float)
        injected = -made.damping @ w
        resting = u - injected[:m]
        if not np.all((resting > low) & (resting < high)):
            continue
        limited = np.asarray(made.limited_controller.call([x, xi])[0], float).ravel()
        tau = float(share_of_damping(made)(x, xi))
        scaled += tau < 1
        of_xi = w[m:] @ injected[m:] * (tau if is_coupled(made.damping, m) else 1.0)
        added = w[:m] @ (limited - resting) + of_xi
        assert added <= 1e-12 - tau * (1 - 1e-9) * w @ made.damping @ w
    assert scaled > 20


def test_clipping_each_input_would_let_V_rise():
    """D not diagonal: wᵀv = +0.19 with the first input at its limit; scaled it is below 0."""
    w = np.array([1.0, -0.5])
    v, limit = -D_FULL @ w, np.array([0.01, 1.0])
    assert w @ np.clip(v, -limit, limit) > 0.18
    none, rate = ca.MX(2, 1), ca.MX(1, 1)
    u, _ = scaled(ca.MX(ca.DM(v)), rate, none, rate, ca.DM(-limit), ca.DM(limit))
    u = np.asarray(ca.evalf(u), float).ravel()
    assert u[0] == -0.01
    assert w @ u < 0


@pytest.mark.parametrize("real", ["double", "float"])
def test_the_code_scales(made, real):
    """Compiled with every warning an error; u and flags at samples, and ξ by each method."""
    tolerance = 1e-11 if real == "double" else 2e-4
    methods = ("euler", "heun", "rk4") if real == "double" else ("heun",)
    for method in methods:
        source = Source(made, real=real, integrator=method)
        compiled = compile_controller(made, real=real, integrator=method, flags=STRICT)
        following, saturated = next_state(source), 0
        for x, xi in states(made, 25, seed=5):
            x, xi = (source.number.rounded(v) for v in (x, xi))
            us, xis, flags = compiled.samples(xi, np.array([x, x]), np.array([0.0, 0.05]))
            u, _, tau = by_hand(made, x, xi)
            assert_allclose(us[0], u, rtol=tolerance, atol=tolerance)
            low, high = np.array(made.loop.plant.u_limits, float).T
            touched = tau < 1 - tolerance or np.any(np.isin(us[0], [low, high]))
            assert bool(flags[0] & SATURATED) == touched or abs(1 - tau) < 10 * tolerance
            assert_allclose(xis[1], following(x, xi, 0.05, x), rtol=tolerance, atol=tolerance)
            saturated += flags[0] & SATURATED
        assert 3 < saturated < 25


def test_a_project_with_its_self_test(made, tmp_path):
    """The vectors of the exported project hold scaled samples, and its own test passes."""
    export_c(made, tmp_path)
    text = (tmp_path / "necc.h").read_text(encoding="ascii")
    assert "Limits of u scale damping" in text
    assert ("v and vc are taken" in text) == is_coupled(made.damping, made.loop.plant.m)
    sources = [str(tmp_path / name) for name in ("necc.c", "selftest.c")]
    subprocess.run(["cc", "-O1", "-o", str(tmp_path / "t"), *sources, "-lm"], check=True)
    subprocess.run([str(tmp_path / "t")], check=True, capture_output=True)


@pytest.mark.parametrize("coupled", [False, True])
@pytest.mark.parametrize("real", ["double", "float"])
def test_kept_casimirs_with_scaled_damping(tmp_path, coupled, real):
    """The self-test of a code that reads ξ off x: damping of ξ is scaled where it is coupled."""
    loop = interconnect(plant := two_link_arm(), default_controller(plant))
    made = design((loop, find_casimirs(loop)), Form(Network(2, (5,)), Network(2, (9,))))
    made = with_limits(made, ((-2.0, 2.5), (-1.0, 1.5)), arm(coupled).damping)
    export_c(made, tmp_path, integrator="casimir", real=real, sample_time=0.05, measured=False)
    sources = [str(tmp_path / name) for name in ("necc.c", "selftest.c")]
    subprocess.run(["cc", *STRICT, "-o", str(tmp_path / "t"), *sources, "-lm"], check=True)
    subprocess.run([str(tmp_path / "t")], check=True, capture_output=True)


@pytest.mark.parametrize("real", ["double", "float"])
def test_what_is_not_scaled_has_the_bits_of_the_law(made, real):
    """Bounds of rounding are those of the law: with a share of 1 nothing else is rounded."""
    compiled, same = compile_controller(made, real=real, flags=STRICT), 0
    for x, xi in states(made, 200, seed=7):
        us, _, flags = compiled.samples(xi, x[None], np.array([0.0]))
        if not flags[0]:
            assert np.array_equal(us[0], compiled.control(x, xi)[0])
            same += 1
    assert same > 3


def test_infinite_parts_are_rejected(made):
    compiled = compile_controller(made, flags=STRICT)
    x = np.full((1, made.loop.plant.n), 1e308)
    us, _, flags = compiled.samples(made.xi_star, x, np.array([0.0]))
    assert np.all(np.isfinite(us))
    assert flags[0] & 2 or np.all(np.abs(us) <= 3)


def test_a_diagonal_damping_is_clipped():
    """V is scaled only where it has to be: the code of every other design stays as it was."""
    made = quadratic_pendulum()
    limited = with_limits(made, ((-1.0, 1.0),), made.damping)
    assert not limited.scales_damping
    assert with_limits(made, None, full_damping(made.damping)).scales_damping is False
    assert pendulum().scales_damping
    assert arm(False).scales_damping


def test_a_limit_may_be_infinite():
    """Of one side alone: the other has no say, in value and slope."""
    made = pendulum(((-np.inf, 0.4),))
    compiled = compile_controller(made, flags=STRICT)
    seen = set()
    for x, xi in states(made, 20, seed=5):
        u, rate = (np.asarray(v, float).ravel() for v in made.limited_controller.call([x, xi])[:2])
        assert np.all(np.isfinite([*u, *rate]))
        us, _, flags = compiled.samples(xi, x[None], np.array([0.0]))
        assert_allclose(us[0], u, rtol=1e-11, atol=1e-11)
        seen.add(int(flags[0]))
    assert seen == {0, SATURATED}


finite = st.floats(-5, 5).map(lambda a: round(a, 3))


@given(
    st.lists(
        st.tuples(finite, finite, st.floats(0.1, 3), st.floats(0.1, 3)), min_size=1, max_size=4
    )
)
@example([(1.0, -3.0, 1.0, 1.0)])
def test_the_share_is_the_largest_that_fits(rows):
    """With τ no limit is passed that was kept without v; with more than τ one is."""
    resting, v, below, above = np.array(rows).T
    low, high = -below, above
    tau = float(ca.evalf(share(*(ca.MX(ca.DM(a)) for a in (resting, v)), ca.DM(low), ca.DM(high))))

    def passed(tau):
        u = resting + tau * v
        return np.any((u > high + 1e-12) & (resting < high)) or np.any(
            (u < low - 1e-12) & (resting > low)
        )

    assert 0 < tau <= 1
    assert not passed(tau)
    assert tau == 1 or passed(tau + 1e-9 + 2e-12 / np.abs(v[v != 0]).min())


@given(st.integers(1, 3), st.integers(0, 2**32 - 1), st.booleans(), st.booleans())
def test_dampings_are_parted(m, seed, coupled, diagonal):
    """What is left without v has no v, and what it leaves does not act on u."""
    rng = np.random.default_rng(seed)
    damping = np.zeros((2 * m, 2 * m))
    full = rng.uniform(1, 2, (m, m))
    damping[:m, :m] = np.diag(np.diag(full)) if diagonal else full
    damping[m:, m:] = rng.uniform(1, 2, (m, m))
    if coupled:
        damping[:m, m:] = rng.uniform(1, 2, (m, m))
    assert is_coupled(damping, m) == coupled
    assert acts_alone(damping, m) == (not coupled and (diagonal or m == 1))
    left = without_inputs(damping, m)
    assert not left[:m].any()
    assert not left[:, :m].any()
    assert np.array_equal(left[m:, m:], np.zeros((m, m)) if coupled else damping[m:, m:])
