"""Plant: gradient, equilibrium equations and holding input, each by a second route."""

import numpy as np
import pytest
import sympy as sp
from helpers import reference
from hypothesis import given, settings
from hypothesis import strategies as st

from necc_casadi.errors import ModelError
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


@given(
    entries=st.lists(st.fractions(-3, 3, max_denominator=8), min_size=9, max_size=9),
    shift=st.fractions(0, 1, max_denominator=8),
)
@settings(max_examples=60, deadline=None)
def test_definiteness_of_R_agrees_with_eigenvalues(entries, shift):
    """Constant R: accepted iff numpy sees no negative eigenvalue, exact rationals throughout."""
    x = sp.symbols("a b c", real=True)
    half = sp.Matrix(3, 3, [sp.Rational(v.numerator, v.denominator) for v in entries])
    R = half * half.T - sp.Rational(shift.numerator, shift.denominator) * sp.eye(3)
    lowest = np.linalg.eigvalsh(np.array(R.evalf(), float))[0]
    H = sum(s**2 for s in x)

    def build():
        return make_plant(x, sp.zeros(3, 3), R, sp.Matrix([0, 0, 1]), H)

    if lowest > 1e-9 or shift == 0:
        assert all(prop.proved for prop in build().properties)
    elif lowest < -1e-9:
        with pytest.raises(ModelError) as caught:
            build()
        assert caught.value.code == "r_not_psd"


@given(st.lists(st.fractions(-3, 3, max_denominator=8), min_size=9, max_size=9))
@settings(max_examples=40, deadline=None)
def test_skewness_is_decided_exactly(entries):
    x = sp.symbols("a b c", real=True)
    A = sp.Matrix(3, 3, [sp.Rational(v.numerator, v.denominator) for v in entries])
    H = sum(s**2 for s in x)
    G = sp.Matrix([0, 0, 1])
    assert make_plant(x, A - A.T, sp.zeros(3, 3), G, H).J == A - A.T
    if sp.zeros(3, 3) != A + A.T:
        with pytest.raises(ModelError) as caught:
            make_plant(x, A, sp.zeros(3, 3), G, H)
        assert caught.value.code == "j_not_skew"


def test_identities_hidden_in_the_entries_are_seen():
    J = sp.Matrix([[0, sp.sin(2 * q)], [-2 * sp.sin(q) * sp.cos(q), 0]])
    R = sp.diag(0, sp.sin(q) ** 2 + sp.cos(q) ** 2)
    plant = make_plant((q, p), J, R, sp.Matrix([0, 1]), p**2)
    assert all(prop.proved for prop in plant.properties)
