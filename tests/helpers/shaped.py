"""Plants whose losses hide what has to be shaped."""

from types import SimpleNamespace

import sympy as sp

from necc_casadi.casimirs.find import find_casimirs
from necc_casadi.methods.method import Method
from necc_casadi.methods.shaping import power_shaping
from necc_casadi.model.closed_loop import interconnect
from necc_casadi.model.controller import default_controller
from necc_casadi.model.plant import Plant, make_plant
from necc_casadi.verdict.judge import judge


def parallel_rlc():
    """The dissipation obstacle of the textbooks."""
    q, phi = sp.symbols("q phi", real=True)
    J, R = sp.Matrix([[0, 1], [-1, 0]]), sp.diag(sp.Rational(1, 2), 0)
    plant = make_plant((q, phi), J, R, sp.Matrix([0, 1]), q**2 / 2 + phi**2 / 2, name="RLC")
    return plant, {q: sp.Integer(1), phi: sp.Rational(1, 2)}


def lossy_motor():
    """A winding with resistance, friction, and a pendulum as the load, held aslant."""
    phi, theta, p = sp.symbols("phi theta p", real=True)
    k, J0 = sp.Rational(1, 2), sp.Matrix([[0, 0, -1], [0, 0, 2], [1, -2, 0]]) / 2
    R = sp.diag(sp.Rational(1, 2), 0, sp.Rational(1, 10))
    H = phi**2 / 2 + p**2 / 2 + 1 - sp.cos(theta)
    plant = make_plant((phi, theta, p), J0, R, sp.Matrix([1, 0, 0]), H, name="Motor")
    current = sp.sin(sp.Rational(1, 2)) / k
    return plant, {phi: current, theta: sp.Rational(1, 2), p: sp.Integer(0)}


def machine():
    """A synchronous machine in the frame of its rotor, lossy, held at a current: J turns a pair."""
    d, q, p = sp.symbols("psi_d psi_q p", real=True)
    J = sp.Matrix([[0, 0, q], [0, 0, -(d + 1)], [-q, d + 1, 0]])
    R = sp.diag(sp.Rational(1, 2), sp.Rational(1, 2), sp.Rational(1, 10))
    G = sp.Matrix([[1, 0], [0, 1], [0, 0]])
    plant = make_plant((d, q, p), J, R, G, d**2 + q**2 + p**2 / 2 + 2 * p, name="Machine")
    return plant, {d: sp.Integer(0), q: sp.Rational(3, 20), p: sp.Integer(1)}


def shaped_problem(plant: Plant, x_star):
    """The loop of power shaping at a target, and what the published loop says there."""
    published = interconnect(plant, default_controller(plant))
    refused = judge(published, find_casimirs(published, (), x_star), x_star)
    method = power_shaping(plant, x_star)
    assert isinstance(method, Method), method
    return SimpleNamespace(
        loop=method.loop,
        casimirs=method.casimirs,
        verdict=method.verdict,
        x_star=x_star,
        published=refused,
    )
