"""The sampled loop under rounding, noise and delay: what is proved of a step, and responses."""

from dataclasses import replace

import numpy as np
import pytest
import sympy as sp
from helpers.export_cases import design as drawn
from helpers.export_cases import pendulum_loop
from helpers.sampled import plant_after
from helpers.velocity import crank

from necc_casadi.certificate.claims.certificate import Certificate
from necc_casadi.certificate.claims.disturbed import Disturbances
from necc_casadi.certificate.claims.rounding import Program
from necc_casadi.certificate.claims.sampled import SampledRegion
from necc_casadi.certificate.prover.arithmetic.intervals import Interval
from necc_casadi.certificate.prover.arithmetic.potential import Potential
from necc_casadi.certificate.prover.certify import certify, with_sampled_loop
from necc_casadi.certificate.prover.sampled import prove
from necc_casadi.certificate.prover.sampled.disturbance import Computed, Disturbed
from necc_casadi.certificate.prover.sampled.disturbed import prove_disturbed
from necc_casadi.certificate.prover.sampled.measured import Measured
from necc_casadi.certificate.prover.sampled.rounding import Rounding, programs
from necc_casadi.certificate.prover.sampled.step import Step
from necc_casadi.designs.design import Design
from necc_casadi.export.compiled import Running, compile_controller
from necc_casadi.lyapunov.networks import Network
from necc_casadi.lyapunov.parameterization import Form

#: Large enough to be seen.
NOISE, ERROR = np.array([2e-3, 1e-3]), np.array([1e-2])


def W(design, Q, z):
    g = design.lyapunov.gradient(z)
    return design.lyapunov.V(z) + np.einsum("bi,ij,bj->b", g, Q, g) / 2


def disturbed(design, Q, period, alpha=None):
    """A loop with noise and errors of u, in double."""
    S = design.lyapunov.hessian(design.z_bar)
    frame = np.linalg.inv(np.linalg.cholesky(S))
    reach = np.full(1, 0.0 if alpha is None else 0.3)
    return Disturbed(
        Step(Potential(design), "heun"), Measured(design), Q, frame, NOISE, ERROR, 2.0**-53,
        period / 100, period, alpha, reach,
    )  # fmt: skip


def after(design, z, s, noise, error, e=0.0):
    """z⁺ of a step with x, or (q, q̇), measured with noise and u off by an error, and by e."""
    n, law = design.loop.plant.n, design.lyapunov
    y, xi = law.measured(z[:, :n]) + noise, z[:, n:]
    u, first = design.control(y, xi)
    predicted = xi + s[:, None] * first
    second = design.control(y, predicted)[1]
    moved = xi + s[:, None] / 2 * (first + second)
    return np.hstack([plant_after(design, z[:, :n], u + error + e, s), moved])


Q = np.array([[0.05, 0.1, 0.05], [0.1, -0.1, 0.05], [0.05, 0.05, 0.1]])


def computed(loop, design, z):
    """No rounding to speak of, anywhere."""
    return Computed(Interval(z.min(0) - 9, z.max(0) + 9), np.full(1, 1e-12), np.full(1, 1e-12))


@pytest.mark.parametrize("fed", ["states", "velocities"])
@pytest.mark.parametrize("period", [0.01, 0.05])
def test_w_falls_where_the_slope_is_beyond_delta_and_rises_little_elsewhere(
    default_design, period, fed
):
    """By simulation of the plant and of the law, errors at their bounds in all corners."""
    design, rng = default_design.natural, np.random.default_rng(0)
    design = crank() if fed == "velocities" else design
    loop = disturbed(design, Q, period)
    z = design.z_bar + rng.uniform(-1, 1, (400, 3)) * 10.0 ** rng.uniform(-3, 0, (400, 1))
    s = rng.uniform(0.02, 1.0, 400) * period
    rate = 0.5 * float(loop.largest_rate(design.z_bar[None], np.array([period]))[0])
    falls = loop.over(Interval(z, z), Interval(s, s), rate, computed(loop, design, z))
    g = np.linalg.norm(design.lyapunov.gradient(z) @ loop.frame.T, axis=1)
    beyond = falls.proved & (g > falls.least)
    assert beyond.mean() > 0.1
    assert (falls.proved & (g < falls.least)).mean() > 0.1
    worst = np.full(400, -np.inf)
    for signs in np.ndindex(2, 2, 2):
        a, b, c = 2 * np.array(signs) - 1
        end = after(design, z, s, NOISE * [a, b], ERROR * c)
        worst = np.maximum(worst, W(design, Q, end) - W(design, Q, z))
    assert (worst[beyond] < 0).all()
    assert (worst[falls.proved] <= falls.rise[falls.proved]).all()
    assert (worst > 0).any()  # errors of this size do make W rise


@pytest.mark.parametrize("fed", ["states", "velocities"])
def test_with_a_delay_s_falls(default_design, fed):
    """S = W + αT|e|², e the change of u within a sample, for any e within reach."""
    design, rng, period, alpha = default_design.natural, np.random.default_rng(1), 0.03, 8.0
    design = crank() if fed == "velocities" else design
    loop = disturbed(design, Q, period, alpha)
    z = design.z_bar + rng.uniform(-1, 1, (400, 3)) * 10.0 ** rng.uniform(-2, 0, (400, 1))
    s, e = rng.uniform(0.02, 1.0, 400) * period, rng.uniform(-0.3, 0.3, (400, 1))
    rate = 0.5 * float(loop.largest_rate(design.z_bar[None], np.array([period]))[0])
    assert rate > 0
    base = computed(loop, design, z)
    earlier = np.full(1, 1.0) * 3e-3  # |∂u/∂x| r is below this
    rounding = Computed(base.box, base.inputs, base.rates, earlier)
    falls = loop.over(Interval(z, z), Interval(s, s), rate, rounding)
    g = np.linalg.norm(design.lyapunov.gradient(z) @ loop.frame.T, axis=1)
    size = np.sqrt(g**2 + (alpha / (2 * rate)) * (e[:, 0] ** 2))
    beyond = falls.proved & (size > falls.least)
    assert beyond.mean() > 0.2

    def S(z, e):
        return W(design, Q, z) + alpha * period * (e**2).sum(-1)

    for sign in (-1.0, 1.0):
        end = after(design, z, s, NOISE * sign, ERROR * sign, e)
        fresh, later = (design.lyapunov.control_law(v[:, :2], v[:, 2:])[0] for v in (z, end))
        change = S(end, fresh - later) - S(z, e)
        assert (change[beyond] < 0).all()
        assert (change[falls.proved] <= falls.rise[falls.proved]).all()


def test_programs_compute_the_law(default_design):
    """The operations that the certificate names, in NumPy, against the law of the design."""
    first, second = programs(default_design)
    assert isinstance(first, Program)
    rng, design = np.random.default_rng(0), default_design
    for z in design.z_bar + rng.uniform(-1, 1, (5, 3)):
        c = z[0] - z[2]
        hc, k = (net for net in design.form.networks[:2])
        weights = design.form.split(design.weights)
        step = 1e-6

        def slope(net, w, v):
            def value(x):
                (A, b), (out, last) = net.layers(w)
                kappa, o = net.quadratic_part(w)
                flat = float(out[0] @ np.tanh(A[:, 0] * x + b) + last[0])
                return flat + (float(kappa[0] * (x - o[0]) ** 2 / 2) if net.quadratic else 0.0)

            return (value(v + step) - value(v - step)) / (2 * step)  # noqa: B023

        known = [*z, slope(hc, weights[0], z[2]), slope(k, weights[1], c)]
        for name, places, constant in second.steps:
            a = [known[p] for p in places]
            value = {"const": lambda: constant, "add": lambda: a[0] + a[1],  # noqa: B023
                     "sub": lambda: a[0] - a[1], "mul": lambda: a[0] * a[1],  # noqa: B023
                     "neg": lambda: -a[0]}[name]()  # noqa: B023  # fmt: skip
            known.append(value)
        u, rate = design.control(z[None, :2], z[None, 2:])
        found = [known[p] for p in second.outputs]
        np.testing.assert_allclose(found, [u[0, 0], rate[0, 0]], atol=1e-8)


# --- the whole ------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def certified(default_design) -> Certificate:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(prove, "_TRIALS", 0)
        return with_sampled_loop(default_design, certify(default_design), 0.05, "heun")


@pytest.fixture(scope="module")
def fed_with_velocities() -> tuple[Design, SampledRegion]:
    """A plant whose inertia moves, and a part of its space."""
    design = crank()
    part = replace(certify(design), level_above_minimum=0.3)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(prove, "_TRIALS", 0)
        return design, prove.prove_sampled(design, part, 0.05, "heun")


@pytest.mark.slow
@pytest.mark.parametrize("fed", ["states", "velocities"])
@pytest.mark.parametrize("delayed", [False, True])
def test_the_compiled_code_stays_where_it_is_proved_to(
    default_design, certified, fed_with_velocities, delayed, fed
):
    """Starts anywhere in the region, periods at random, noise at its bounds; in float."""
    design, region, n = default_design, certified.sampled, 2
    if fed == "velocities":
        design, region = fed_with_velocities
    noise = dict(zip(design.measurement.names, [1e-4, 2e-4], strict=True))
    asked = Disturbances("float", noise, {"u": 1e-4}, delayed=delayed)
    found = prove_disturbed(design, region, 0.05, asked)
    natural, box = design.natural, np.array(region.box)
    assert max(found.radius) < 0.01
    rng, metric = np.random.default_rng(0), np.array(region.metric)
    bottom = float(natural.lyapunov.V(natural.z_bar))
    z = rng.uniform(*box.T, (4000, 3)).astype(np.float32).astype(float)
    z = z[W(natural, metric, z) - bottom < found.height][:60]
    code = compile_controller(design, real="float")
    runs = [Running(code, code._state(v[n:])) for v in z]
    x, s, late = z[:, :n], np.zeros(len(z)), None
    for k in range(900):
        errors = np.array(list(noise.values())) * rng.choice([-1.0, 1.0], x.shape)
        errors[::2] = np.array(list(noise.values()))  # one corner for ever
        y = design.lyapunov.measured(x) + errors
        steps = [run.step(v, dt) for run, v, dt in zip(runs, y, s, strict=True)]
        assert not any(flags for _, flags in steps)
        u = np.array([u for u, _ in steps])
        here = np.hstack([x, [run.xi for run in runs]])
        assert (W(natural, metric, here) - bottom < found.height * (1 + 1e-6)).all()
        assert ((here > box[:, 0]) & (here < box[:, 1])).all()
        applied = u if late is None or not delayed else late
        late, s = u, rng.choice([found.period, found.period / 3, 2 * found.shortest], len(z))
        s = s.astype(np.float32).astype(float)
        x = plant_after(natural, x, applied + 1e-4 * rng.choice([-1.0, 1.0], u.shape), s, steps=4)
        if k >= 880:
            off = np.abs(here - natural.z_bar).max(0)
            assert (off <= found.radius).all()
    assert (off >= 1e-3 * np.array(found.radius)).all()  # and not by orders of magnitude


@pytest.mark.slow
def test_more_noise_is_a_larger_radius_and_too_much_is_none(default_design, certified):
    def radius(size):
        asked = Disturbances("float", {"q": size, "p": size})
        found = prove_disturbed(default_design, certified.sampled, 0.05, asked)
        return found if isinstance(found, str) else np.array(found.radius)

    small, large = radius(1e-4), radius(1e-3)
    assert ((5 * small < large) & (large < 20 * small)).all()
    assert radius(1.0) == (
        "near the minimum the disturbances are as large as what they are to leave"
    )


def test_laws_that_are_not_covered_are_refused_in_words():
    """With β, C is no single network of the Casimirs."""
    net = Network(1, (4,))
    made = drawn(pendulum_loop(), Form(net, net, betas=(net,)))
    refused = prove_disturbed(made, None, 0.01, Disturbances())
    assert refused == "the law that the C code computes is not of the kind that is covered"


def test_what_is_measured_or_told_otherwise_is_refused_by_its_name(default_design):
    loop = default_design.loop
    plant = replace(loop.plant, inertia=sp.ImmutableMatrix([[2]]))  # its p is q̇ times 1
    fed = replace(default_design, loop=replace(loop, plant=plant))
    assert "p = M(q)q̇ is not proved" in prove_disturbed(fed, None, 0.01, Disturbances())
    moving = replace(default_design, setpoints={"q": (-1, 1)})
    assert "at run time" in prove_disturbed(moving, None, 0.01, Disturbances())


def test_the_bound_of_float_is_many_times_that_of_double(default_design):
    z = default_design.natural.z_bar
    box = Interval(z - 1, z + 1)
    made = programs(default_design)
    single, double = (
        np.concatenate(Rounding(default_design, number, *made).over(box))
        for number in ("float", "double")
    )
    assert ((single / double > 2.0**28) & (single / double < 2.0**30)).all()
