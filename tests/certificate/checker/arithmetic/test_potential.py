"""The second evaluator of V encloses the V that is exported."""

import json

import flint
import numpy as np
import pytest
from helpers.constructed import (
    make_design,
    trained_like_pendulum,
)

from necc_casadi.certificate.checker.arithmetic.potential import Energy
from necc_casadi.certificate.checker.model import StoredDesign
from necc_casadi.lyapunov.networks import MonotonePhi, Network
from necc_casadi.lyapunov.parameterization import Form

FORMS = [
    Form(Network(1, (8,)), Network(1, (12,), quadratic=True)),
    Form(Network(1, (6, 6), "sin"), Network(1, (6, 6), "squareplus"), (Network(1, (4,)),)),
    Form(Network(1, (5,), quadratic=True), Network(1, (5,)), phi=MonotonePhi(4)),
]


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("radius", [0.0, 0.1])
def test_second_evaluator_encloses_the_exported_V(form, radius):
    rng = np.random.default_rng(3)
    design = make_design(
        trained_like_pendulum().loop.plant, ("pi/4", 0), form, form.initial(rng), [0.5]
    )
    energy = Energy(StoredDesign(json.loads(design.text)), range(3))
    for _ in range(3):
        middle = rng.uniform(-1, 1, 3)
        box = tuple((float(v - radius), float(v + radius)) for v in middle)
        value, gradient = energy.value(box), energy.gradient(box)
        below, above = energy.hessian(box), energy.hessian(box, -1)
        for _ in range(5):
            z = middle + radius * rng.uniform(-1, 1, 3)
            assert abs(value.mid() - design.V(z)) <= value.rad() + 1e-12
            exact = np.asarray(design.lyapunov.gradient(z), float).ravel()
            for g, e in zip(gradient, exact, strict=True):
                assert abs(g.mid() - e) <= g.rad() + 1e-12
            H = np.asarray(design.lyapunov.hessian(z), float)
            for L, sign in ((below, 1), (above, -1)):
                mid = np.array([[float(v.mid()) for v in row] for row in L.tolist()])
                slack = sum(float(v.rad()) for v in L.entries())
                assert np.linalg.eigvalsh(sign * (H - mid))[0] >= -slack - 1e-10


@pytest.mark.parametrize("form", FORMS)
def test_the_gradient_at_a_point_has_as_many_digits_as_are_asked_for(form):
    """Digits beyond doubles, and those of doubles as the exported V has them."""
    rng = np.random.default_rng(5)
    design = make_design(
        trained_like_pendulum().loop.plant, ("pi/4", 0), form, form.initial(rng), [0.5]
    )
    model = StoredDesign(json.loads(design.text))
    exact = np.asarray(design.lyapunov.gradient(design.z_star), float).ravel()
    with flint.ctx.workprec(128):
        gradient = Energy(model, range(3)).gradient_at(model.target_balls())
    for g, e in zip(gradient, exact, strict=True):
        assert float(g.rad()) < 1e-32
        assert float(abs(g - e)) < 1e-13
