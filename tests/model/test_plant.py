"""Plant: gradient, equilibrium equations and holding input, each by a second route."""

import numpy as np
import sympy as sp
from helpers import reference

from necc_casadi.model.plant import make_plant
from necc_casadi.symbolic.derivatives import gradient

q, p = sp.symbols("q p", real=True)
CANONICAL = sp.Matrix([[0, 1], [-1, 0]])


def test_gradient_by_finite_differences(pendulum, crane):
    for task in (pendulum, crane):
        plant = task.loop.plant
        H, slope = (sp.lambdify([plant.x], f, "numpy") for f in (plant.H, list(plant.grad_H)))
        for seed in range(3):
            x = np.random.default_rng(seed).normal(size=plant.n)
            np.testing.assert_allclose(slope(x), reference.jacobian(H, x).ravel(), atol=1e-9)
        assert gradient(plant.H, plant.x) == plant.grad_H


def test_the_holding_input_holds(pendulum, crane):
    """(J − R)∇H + G u* = 0 at the target, exactly."""
    for task in (pendulum, crane):
        plant = task.loop.plant
        u = plant.holding_input(task.x_star)
        drift = ((plant.J - plant.R) * plant.grad_H + plant.G * u).subs(task.x_star)
        assert sp.simplify(drift) == sp.zeros(plant.n, 1)


def test_the_pendulum_is_held_by_its_gravity_torque(pendulum):
    assert pendulum.loop.plant.holding_input(pendulum.x_star)[0] == sp.sin(sp.pi / 4)


def test_equilibrium_equations_say_when_a_constant_input_exists(crane):
    """They vanish exactly where (J − R)∇H lies in the range of G, at random states."""
    plant = crane.loop.plant
    rng = np.random.default_rng(0)
    for at_rest in (True, False) * 4:
        x = {s: sp.Rational(int(v), 7) for s, v in zip(plant.x, rng.integers(1, 9, 4), strict=True)}
        if at_rest:
            x |= {s: sp.Integer(0) for s in plant.x[2:]}
        drift = np.array(((plant.J - plant.R) * plant.grad_H).subs(x).evalf(), float).ravel()
        G = np.array(plant.G, float)
        rest = drift - G @ np.linalg.lstsq(G, drift, rcond=None)[0]
        zero = all(e.subs(x) == 0 for e in plant.equilibrium_equations)
        assert zero == (np.linalg.norm(rest) < 1e-12) == at_rest


def test_actuated_everywhere_every_state_is_an_equilibrium():
    plant = make_plant((q, p), CANONICAL, sp.zeros(2, 2), sp.eye(2), q**2 + p**2)
    assert plant.equilibrium_equations == ()
