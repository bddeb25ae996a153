"""Free numbers of structures: by the cost of the linearised loop, found again from its symbols."""

import numpy as np
import pytest
import sympy as sp
from helpers.symbolic_plants import EXAMPLES, load

from necc_casadi.methods.constant import constant_structure
from necc_casadi.methods.linear_target import linear_target
from necc_casadi.methods.mechanical import mechanical_structures
from necc_casadi.methods.mechanical_model import mechanical_model
from necc_casadi.methods.mechanical_response import mechanical_response
from necc_casadi.model.closed_loop import interconnect
from necc_casadi.model.controller import default_controller
from necc_casadi.model.cost import bryson
from necc_casadi.model.matching import Matching
from necc_casadi.model.model_file import load_model
from necc_casadi.model.sizes import natural_sizes
from necc_casadi.symbolic.derivatives import at
from necc_casadi.symbolic.floats import float_matrix


def target_of(plant, values=None):
    return {s: sp.sympify((values or {}).get(str(s), 0)) for s in plant.x}


def aim(plant, target):
    sizes = natural_sizes(interconnect(plant, default_controller(plant)), (), target)
    return sizes, linear_target(plant, target, sizes, bryson)


def response_of(plant, target):
    model = mechanical_model(plant)
    found = (mechanical_response(model, row, target, bryson) for row in model.free_rows(target))
    return next(r for r in found if r is not None and r.slope)


@pytest.mark.parametrize("name", ["cart_pole", "inertia_wheel", "vtol"])
def test_a_mechanical_structure_may_cost_what_lqr_does(name):
    plant = load(name)[0]
    response = response_of(plant, target_of(plant, {"x": 1} if name == "cart_pole" else {}))
    b, Lambda, cost = response.best
    assert cost == pytest.approx(1, abs=1e-3)
    assert response.g_perp @ b > 0
    assert b[response.r] < 0
    assert np.linalg.eigvalsh(response.inertia(b, Lambda))[0] > 0


def test_no_loop_costs_less_than_lqr():
    plant = load("cart_pole")[0]
    response = response_of(plant, target_of(plant, {"x": 1}))
    rng = np.random.default_rng(0)
    for _ in range(20):
        b = np.array([1.1 + rng.exponential(), -1.0])
        numbers = (rng.exponential(size=(1, 1)) + 0.1 for _ in range(3))
        assert response.over_lqr(b, *numbers) >= 1 - 1e-9


def test_the_loop_is_that_of_the_structure_as_it_is_written_down():
    """(F_d − G_dDG_dᵀ)∇²(H₀ + ½Θγ²) at the target, from the symbols of the structure."""
    plant = load("cart_pole")[0]
    target = target_of(plant, {"x": 1})
    response = response_of(plant, target)
    matching = next(m for m in mechanical_structures(plant, target) if isinstance(m, Matching))
    structure, (gamma,) = matching.plant, matching.shaping
    away = gamma - gamma.subs(target)
    N = float_matrix(at(sp.Matrix([sp.diff(gamma, s) for s in plant.x]), target))
    F, Q = (
        float_matrix(at(sp.Matrix(matrix), target))
        for matrix in (
            structure.J - structure.R, sp.hessian(structure.H + 3 * away**2 / 2, plant.x)
        )
    )  # fmt: skip
    M = np.linalg.inv(float_matrix(at(mechanical_model(plant).inverse_mass, target)))
    G = F @ N
    closed = (F - 0.7 * G @ G.T) @ Q
    M_d = F[:2, 2:] @ np.linalg.inv(M)
    e = response.g_perp * response.units[response.r] / response.units
    b = M_d @ e
    sizes, linear = aim(plant, target)
    x, time = sizes.units.state[:4], sizes.units.time
    Lambda = (M_d - np.outer(b, b) / (e @ b))[:1, :1]
    assert (response.units == 1).all()
    seen = response.over_lqr(b * time**2, Lambda * time**2, 3 * np.eye(1), 0.7 * np.eye(1) / time)
    assert linear.over_lqr(closed * x / x[:, None] * time) == pytest.approx(seen, rel=1e-6)


def test_the_feedback_of_a_constant_structure_is_that_of_lqr_at_the_target():
    model = load_model(EXAMPLES / "maglev_voltage.py")
    plant = model.system
    target = {s: model.target[str(s)] for s in plant.x}
    sizes, linear = aim(plant, target)
    units = sizes.units
    K = linear.best.K * units.input[:, None] / units.state[:3]
    matching = constant_structure(plant.drift, plant.directions, plant.x, target, cheap=K)
    assert matching.holds
    slopes = float_matrix(at(sp.Matrix(matching.u0).jacobian(plant.x), target))
    np.testing.assert_allclose(slopes, -K, rtol=0.05)
    usual = constant_structure(plant.drift, plant.directions, plant.x, target)
    other = float_matrix(at(sp.Matrix(usual.u0).jacobian(plant.x), target))
    assert np.abs(other / K + 1).max() > 0.5
