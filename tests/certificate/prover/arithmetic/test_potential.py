"""V over boxes encloses the V that is exported."""

import numpy as np
import pytest
from helpers.constructed import (
    make_design,
    pendulum,
)
from hypothesis import given, settings
from hypothesis import strategies as st

from necc_casadi.certificate.prover.arithmetic.intervals import Interval
from necc_casadi.certificate.prover.arithmetic.potential import Potential
from necc_casadi.lyapunov.networks import MonotonePhi, Network
from necc_casadi.lyapunov.parameterization import Form

FORMS = [
    Form(Network(1, (16,)), Network(1, (24,))),
    Form(Network(1, (16, 16), "sin", quadratic=True), Network(1, (24, 24), "squareplus")),
    Form(Network(1, (8,)), Network(1, (8,)), betas=(Network(1, (8,)),)),
    Form(Network(1, (8,)), Network(1, (8,), quadratic=True), phi=MonotonePhi(4)),
]


@pytest.mark.parametrize("form", FORMS)
@settings(max_examples=8, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), radius=st.floats(0, 0.4))
def test_enclosures_of_V_hold_the_exported_V(form, seed, radius):
    """CasADi's V, the one that is exported, at random points of random boxes."""
    rng = np.random.default_rng(seed)
    design = make_design(pendulum(), ("pi/4", 0), form, form.initial(rng), [0.5])
    middle = rng.uniform(-2, 2, (3, 3))
    jet = Potential(design).jet(Interval(middle - radius, middle + radius))
    slope = Potential(design).slope(Interval(middle - radius, middle + radius))
    V = design.lyapunov
    for box in range(3):
        z = middle[box] + radius * rng.uniform(-1, 1, 3)
        for enclosure, f in [
            (jet.value, V.V), (jet.grad, V.gradient), (jet.hess, V.hessian), (slope, V.phi_slope)
        ]:  # fmt: skip
            exact = np.asarray(f(z), float).reshape(enclosure.shape[1:])
            assert np.all(enclosure.lo[box] <= exact + 1e-11)
            assert np.all(enclosure.hi[box] >= exact - 1e-11)
