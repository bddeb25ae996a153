"""How a network rises by its shells, on both sides."""

import numpy as np
import pytest
from flint import arb, arb_mat
from scipy.optimize import minimize

from necc_casadi.certificate.checker.arithmetic.networks import Net
from necc_casadi.certificate.checker.region.shells import NetworkCurvature, Shells
from necc_casadi.certificate.prover.region.shells import shells_of_network
from necc_casadi.lyapunov.networks import Network


@pytest.mark.parametrize("seed", [0, 1])
def test_growth_is_below_the_network_and_the_checker_agrees(seed):
    """k(ρ) against sampled values on spheres, in two dimensions; loosened shells are refused."""
    network, rng = Network(2, (8,), quadratic=True), np.random.default_rng(seed)
    weights = network.initial(rng)
    weights[-4:-2] = 2.0, 3.0

    def value(v):
        return float(network(weights, v))

    middle, A = minimize(value, [0.3, -0.2], tol=1e-12).x, np.array([[1.5, 0.2], [0.0, 1.1]])
    found = shells_of_network(network, weights, middle, A, 0.8)
    back = np.linalg.inv(A)
    for rho in (0.05, 0.2, 0.5, 0.8):
        for angle in np.linspace(0, 2 * np.pi, 60):
            v = middle + back @ (rho * np.array([np.cos(angle), np.sin(angle)]))
            assert value(v) - value(middle) >= found.rise(rho) - 1e-12
    assert found.rise(found.radius(0.1)) >= 0.1
    shape = {"inputs": 2, "hidden": [8], "activation": "tanh", "quadratic": True}
    net = Net.from_weights(shape, weights.tolist())[0]
    parts = [middle.tolist(), arb_mat(A.tolist()), found.radii.tolist(), found.nu.tolist()]
    rise = Shells(NetworkCurvature(net), *parts, found.above)
    assert rise.holds()
    assert float(rise.at(arb(0.5)).mid()) == pytest.approx(found.rise(0.5), rel=1e-4)
    assert not Shells(
        NetworkCurvature(net), *parts[:3], [v + 0.3 for v in found.nu], found.above
    ).holds()
