"""Closed loop: the interconnection, derived a second time from the two systems' equations."""

import sympy as sp

from necc_casadi.model.closed_loop import interconnect
from necc_casadi.model.controller import make_controller


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


def test_the_pendulums_loop_is_the_papers(pendulum):
    assert sp.Matrix([[0, 1, 0], [-1, 0, -1], [0, 1, 0]]) == pendulum.loop.J
    assert sp.zeros(3, 3) == pendulum.loop.R
    assert [str(c) for c in pendulum.casimirs.functions] == ["q - xi1"]
