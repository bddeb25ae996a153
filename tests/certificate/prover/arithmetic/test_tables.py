"""Networks that are looked up: every value on a box, and little more."""

import numpy as np
import pytest
from helpers.constructed import make_design, pendulum
from hypothesis import given, settings
from hypothesis import strategies as st

from necc_casadi.certificate.prover.arithmetic.intervals import Interval, point
from necc_casadi.certificate.prover.arithmetic.networks import network_jet
from necc_casadi.certificate.prover.arithmetic.tables import TabledPotential
from necc_casadi.lyapunov.networks import Network
from necc_casadi.lyapunov.parameterization import Form


def looked_up(network, weights, X):
    form = Form(Network(1, (4,)), Network(1, (4,)))
    potential = TabledPotential(
        make_design(pendulum(), ("pi/4", 0), form, np.zeros(form.size), [0.5])
    )
    return potential._tables(network, weights, X)


@pytest.mark.parametrize("inputs", [1, 2])
@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 10_000), flat=st.booleans())
def test_what_is_looked_up_holds_the_network(inputs, seed, flat):
    """Boxes of very different widths at once, also with a side of no width, at 0."""
    rng = np.random.default_rng(seed)
    network = Network(inputs, (8,), quadratic=True)
    weights = network.initial(rng)
    middle = rng.uniform(-1, 1, (12, inputs))
    half = 10.0 ** rng.uniform(-4, 0, (12, inputs))
    if flat and inputs > 1:
        middle[:, 0] = half[:, 0] = 0.0
    found = looked_up(network, weights, Interval(middle - half, middle + half))
    for _ in range(10):
        z = middle + half * rng.uniform(-1, 1, middle.shape)
        true = network_jet(network, weights, point(z))
        for name in ("value", "grad", "hess"):
            box, exact = getattr(found, name), getattr(true, name)
            assert (box.lo <= exact.hi).all()
            assert (exact.lo <= box.hi).all()


def test_a_wide_box_of_two_inputs_is_enclosed_tightly():
    """What neurons do together: entry by entry over the whole box it is twice as much, or more."""
    rng = np.random.default_rng(0)
    network = Network(2, (64,), quadratic=True)
    weights, X = network.initial(rng) * 2, Interval(np.full((1, 2), -2.0), np.full((1, 2), 2.0))
    found = looked_up(network, weights, X).hess
    plain = network_jet(network, weights, X).hess
    z = np.stack(np.meshgrid(*[np.linspace(-2, 2, 60)] * 2), -1).reshape(-1, 2)
    true = network_jet(network, weights, point(z)).hess.mid
    spread = true.max(0) - true.min(0)
    width = (found.hi - found.lo)[0]
    assert (width < 2 * spread).all()
    assert (width < (plain.hi - plain.lo)[0] / 2).all()
