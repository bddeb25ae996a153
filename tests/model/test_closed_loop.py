"""Closed loop: the interconnection, derived a second time from the two systems' equations."""

import numpy as np
import pytest
import sympy as sp

from necc_casadi.errors import ModelError
from necc_casadi.model.closed_loop import interconnect
from necc_casadi.model.controller import default_controller, make_controller


def test_interconnection_is_what_substitution_gives(crane):
    """Put u = −y_c + v, u_c = y + v_c into both systems, with ∇H, ∇Hc as free symbols."""
    plant = crane.loop.plant
    xi = sp.symbols("a b c", real=True)
    a = xi[0]
    Jc = sp.Matrix([[0, a, 1], [-a, 0, 2], [-1, -2, 0]])
    Rc = sp.diag(0, 1, a**2)
    Gc = sp.Matrix([[1, 0], [a, 1], [0, 3]])
    loop = interconnect(plant, make_controller(plant, xi, Jc, Rc, Gc))
    grad_H = sp.Matrix(sp.symbols("h1:5"))
    grad_Hc = sp.Matrix(sp.symbols("k1:4"))
    v, v_c = sp.Matrix(sp.symbols("v1:3")), sp.Matrix(sp.symbols("w1:3"))
    y, y_c = plant.G.T * grad_H, Gc.T * grad_Hc
    x_dot = (plant.J - plant.R) * grad_H + plant.G * (-y_c + v)
    xi_dot = (Jc - Rc) * grad_Hc + Gc * (y + v_c)
    by_hand = sp.Matrix.vstack(x_dot, xi_dot)
    inputs = sp.Matrix.vstack(v, v_c)
    packed = loop.M * sp.Matrix.vstack(grad_H, grad_Hc) + loop.ports * inputs
    assert sp.expand(packed - by_hand) == sp.zeros(7, 1)
    assert loop.J == -loop.J.T
    assert loop.R == loop.R.T
    assert loop.M == loop.J - loop.R


def test_the_default_controller_is_one_integrator_per_input(crane):
    controller = default_controller(crane.loop.plant)
    assert controller.states == ("xi1", "xi2")
    assert controller.Jc.is_zero_matrix
    assert controller.Rc.is_zero_matrix
    assert sp.eye(2) == controller.Gc


def test_the_pendulums_loop_is_the_papers(pendulum):
    assert sp.Matrix([[0, 1, 0], [-1, 0, -1], [0, 1, 0]]) == pendulum.loop.J
    assert sp.zeros(3, 3) == pendulum.loop.R
    assert [str(c) for c in pendulum.casimirs.functions] == ["q - xi1"]


def test_casimirs_of_the_fixtures_solve_the_condition(pendulum, crane):
    for task in (pendulum, crane):
        M = sp.lambdify([task.loop.z], sp.Matrix(task.loop.M), "numpy")
        z = np.random.default_rng(0).normal(size=task.loop.n)
        for c in task.casimirs.functions:
            slope = sp.lambdify([task.loop.z], [sp.diff(c, s) for s in task.loop.z], "numpy")
            np.testing.assert_allclose(np.array(slope(z), float) @ np.array(M(z), float), 0)


@pytest.mark.parametrize(
    ("code", "matrices"),
    [
        ("jc_not_skew", ([[1]], [[0]], [[1]])),
        ("rc_not_psd", ([[0]], [[-1]], [[1]])),
        ("gc_rank", ([[0]], [[0]], [[0]])),
        ("shape", ([[0, 0], [0, 0]], [[0]], [[1]])),
        ("shape", ([[0]], [[0]], [[1, 1]])),
        ("undefined_symbol", ([[0]], [[sp.Symbol("q", real=True) ** 2]], [[1]])),
    ],
)
def test_bad_controllers(pendulum, code, matrices):
    """The controller's structure may depend on ξ only, not on the plant's states."""
    xi = (sp.Symbol("s", real=True),)
    with pytest.raises(ModelError) as caught:
        make_controller(pendulum.loop.plant, xi, *map(sp.Matrix, matrices))
    assert caught.value.code == code
