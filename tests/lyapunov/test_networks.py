"""Networks: CasADi against the documented formula in plain numpy; units; Φ₁ > 0."""

import casadi as ca
import numpy as np
import pytest
from helpers import reference
from hypothesis import given, settings
from hypothesis import strategies as st

from necc_casadi.lyapunov.networks import ACTIVATIONS, MonotonePhi, Network

networks = st.builds(
    Network,
    inputs=st.integers(1, 4),
    hidden=st.lists(st.integers(1, 7), max_size=3).map(tuple),
    activation=st.sampled_from(sorted(ACTIVATIONS)),
    quadratic=st.booleans(),
)


def compiled(net) -> ca.Function:
    w, v = ca.MX.sym("w", net.size), ca.MX.sym("v", net.inputs)
    return ca.Function("f", [w, v], [net(w, v)])


@given(net=networks, seed=st.integers(0, 2**32 - 1))
@settings(max_examples=60, deadline=None)
def test_a_network_is_its_documented_formula(net, seed):
    rng = np.random.default_rng(seed)
    w, v = rng.normal(size=net.size), rng.normal(size=net.inputs)
    assert float(compiled(net)(w, v)) == pytest.approx(reference.network(net, w, v), rel=1e-12)


@given(net=networks, seed=st.integers(0, 2**32 - 1))
@settings(max_examples=40, deadline=None)
def test_layers_and_quadratic_part_are_the_same_weights(net, seed):
    w = np.random.default_rng(seed).normal(size=net.size)
    kappa, center = net.quadratic_part(w)
    parts = [part.ravel() for layer in net.layers(w) for part in layer]
    assert np.array_equal(np.concatenate([*parts, kappa, center]), w)
    assert kappa.size == center.size == (net.inputs if net.quadratic else 0)


@given(net=networks, seed=st.integers(0, 2**32 - 1), energy=st.floats(0.01, 100))
@settings(max_examples=40, deadline=None)
def test_units_scale_input_and_output_of_a_network(net, seed, energy):
    rng = np.random.default_rng(seed)
    length = rng.uniform(0.1, 10, net.inputs)
    sigma, tau = net.units(length, energy)
    w_hat, v = net.initial(rng), rng.normal(size=net.inputs) * length
    expected = energy * reference.network(net, w_hat, v / length)
    assert reference.network(net, sigma * w_hat + tau, v) == pytest.approx(expected, rel=1e-9)


@given(
    seed=st.integers(0, 2**32 - 1),
    e=st.floats(-5, 5),
    k=st.floats(-5, 5),
    energy=st.floats(0.1, 10),
)
@settings(max_examples=40, deadline=None)
def test_units_of_the_neural_phi(seed, e, k, energy):
    net = MonotonePhi(5)
    rng = np.random.default_rng(seed)
    sigma, tau = net.units(np.ones(2), energy)
    w_hat = net.initial(rng)
    expected = energy * reference.phi(net, w_hat, e / energy, k / energy)
    assert reference.phi(net, sigma * w_hat + tau, e, k) == pytest.approx(expected, rel=1e-9)


@given(seed=st.integers(0, 2**32 - 1), spread=st.floats(0, 5))
@settings(max_examples=60, deadline=None)
def test_the_neural_phi_has_slope_delta_at_least_for_any_weights(seed, spread):
    net = MonotonePhi(6)
    rng = np.random.default_rng(seed)
    w, v = rng.normal(size=net.size) * spread, rng.normal(size=2) * spread
    s = ca.MX.sym("v", 2)
    value = net(ca.DM(w), s)
    f = ca.Function("f", [s], [value, ca.gradient(value, s)])
    phi, gradient = f(v)
    assert float(phi) == pytest.approx(reference.phi(net, w, *v), rel=1e-12, abs=1e-12)
    assert float(gradient[0]) >= net.delta


@pytest.mark.parametrize("quadratic", [False, True])
def test_the_two_published_sizes(quadratic):
    extra = 2 if quadratic else 0
    one = Network(1, (64,), quadratic=quadratic).size + Network(1, (32,), quadratic=quadratic).size
    two = (
        Network(1, (64, 64), quadratic=quadratic).size
        + Network(1, (32, 32), quadratic=quadratic).size
    )
    assert (one, two) == (290 + 2 * extra, 5506 + 2 * extra)


def test_a_positive_quadratic_part_stays_positive_in_training():
    net = Network(2, (4,), quadratic=True)
    lower = net.lower(0.3)
    assert np.all(lower[-4:-2] == 0.3)
    assert np.all(np.isneginf(np.delete(lower, [-4, -3])))
    assert np.all(net.initial(np.random.default_rng(0)) >= lower)
