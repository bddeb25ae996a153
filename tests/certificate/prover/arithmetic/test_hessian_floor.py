"""Bounds of networks below their curvature for all arguments, on both sides."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from necc_casadi.certificate.checker.arithmetic.hessian_floor import curvature_above
from necc_casadi.certificate.checker.arithmetic.hessian_floor import hessian_floor as floor_in_balls
from necc_casadi.certificate.checker.arithmetic.networks import Net
from necc_casadi.certificate.prover.arithmetic.hessian_floor import (
    hessian_ceiling,
    hessian_floor,
    scalar_hessian_floor,
)
from necc_casadi.lyapunov.networks import Network

SHAPES = [(2, (9,)), (2, (7, 5)), (1, (6, 6)), (3, (4, 5, 3)), (1, ())]


def hessians(network, weights, points):
    """∇²f by reverse differentiation in CasADi, (B, d, d)."""
    import casadi as ca

    v = ca.MX.sym("v", network.inputs)
    f = ca.Function("H", [v], [ca.hessian(network(ca.DM(weights), v), v)[0]])
    return np.array([np.asarray(f(point), float) for point in points])


def in_balls(network, weights) -> Net:
    shape = {
        "inputs": network.inputs, "hidden": list(network.hidden),
        "activation": network.activation, "quadratic": network.quadratic,
    }  # fmt: skip
    return Net.from_weights(shape, list(map(float, weights)))[0]


def lower_ends(matrix) -> np.ndarray:
    return np.array([[float(v.mid()) for v in row] for row in matrix.tolist()])


@pytest.mark.parametrize("activation", ["tanh", "sin", "squareplus"])
@pytest.mark.parametrize(("inputs", "hidden"), SHAPES)
@settings(max_examples=4, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), quadratic=st.booleans())
def test_curvature_stays_above_the_floor(activation, inputs, hidden, seed, quadratic):
    rng = np.random.default_rng(seed)
    network = Network(inputs, hidden, activation, quadratic)
    weights = 2 * network.initial(rng)
    bends = hessians(network, weights, rng.normal(size=(60, inputs)) * 3)
    floors = hessian_floor(network, weights), floor_in_balls(in_balls(network, weights), activation)
    middles = floors[0].mid, lower_ends(floors[1])
    assert np.allclose(*middles, rtol=1e-3, atol=1e-3)  # two ways to one bound
    for floor in middles:
        assert np.linalg.eigvalsh(bends - floor).min() >= -1e-9
    assert np.linalg.eigvalsh(hessian_ceiling(network, weights).hi - bends).min() >= -1e-9


def test_one_layer_is_bounded_as_sharply_as_one_neuron_allows():
    """f = tanh(v₁ + v₂) bends by at most 4/(3√3) along (1, 1)."""
    network = Network(2, (1,))
    floor = hessian_floor(network, np.array([1.0, 1.0, 0.0, 1.0, 0.0])).mid
    ceiling = hessian_ceiling(network, np.array([1.0, 1.0, 0.0, 1.0, 0.0])).mid
    assert np.allclose(ceiling, -floor, rtol=1e-12)
    assert floor == pytest.approx(-4 / 27**0.5 * np.ones((2, 2)), rel=2e-4)


@pytest.mark.parametrize("hidden", [(5, 4), (16, 16), (6, 5, 4)])
@settings(max_examples=4, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), gain=st.floats(0.1, 3))
def test_the_bend_of_a_scalar_network_over_all_reals(hidden, seed, gain):
    """Between the least curvature at many points and a tolerance below it; balls agree."""
    rng = np.random.default_rng(seed)
    network = Network(1, hidden, quadratic=True)
    weights = gain * network.initial(rng)
    kappa = network.quadratic_part(weights)[0][0]
    far = np.sinh(np.linspace(-8, 8, 2001))[:, None]
    lowest = min(0.0, hessians(network, weights, far).min() - kappa)
    bend = scalar_hessian_floor(network, weights, 1e-2)
    assert lowest - 0.05 * abs(lowest) - 2e-2 <= bend <= lowest + 1e-9
    net = in_balls(network, weights)
    assert curvature_above(net, bend - 1e-2)
    if lowest < -1e-6:
        assert not curvature_above(net, 0.9 * lowest)
    assert not curvature_above(net, 0.0)


def test_a_first_layer_that_never_saturates_is_not_bounded():
    """A neuron that does not see its input bends nothing; one that barely does, far out."""
    network = Network(1, (2, 2), quadratic=True)
    weights = np.ones(network.size)
    weights[0] = 1e-30
    assert scalar_hessian_floor(network, weights, 1e-2) is not None
    weights[:2] = 1e-4
    assert scalar_hessian_floor(network, weights, 1e-2) > -0.1
