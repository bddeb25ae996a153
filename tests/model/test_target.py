"""Targets: every form of the text, exact equilibria, ambiguity, and text that is none."""

import numpy as np
import pytest
import sympy as sp
from helpers.symbolic_plants import EXAMPLES, load
from hypothesis import example, given, settings
from hypothesis import strategies as st

from necc_casadi.errors import TargetError
from necc_casadi.model.model_file import load_model
from necc_casadi.model.plant import make_plant
from necc_casadi.model.target import (
    free_coordinates,
    nearest_equilibrium,
    parse_target,
    solve_target,
    target_from_model,
)

q, p = sp.symbols("q p", real=True)


@pytest.mark.parametrize(
    "text", ["pi/4", " pi / 4 ", "q=pi/4", "q = pi/4 , p = 0", "pi/4,0", "0.25*pi", "pi/4,1-1",
             "asin(sqrt(2)/2)", "p=0,q=pi/4"]
)  # fmt: skip
def test_every_form_names_the_same_point(pendulum, text):
    x_star = parse_target(pendulum.loop.plant, text)
    assert list(x_star) == [q, p]
    assert sp.simplify(x_star[q] - sp.pi / 4) == 0
    assert x_star[p] == 0


def test_decimals_and_signs_are_exact(pendulum):
    assert parse_target(pendulum.loop.plant, "-0.1")[q] == sp.Rational(-1, 10)
    assert parse_target(pendulum.loop.plant, "-pi/4")[q] == -sp.pi / 4
    assert parse_target(pendulum.loop.plant, "+1e-3")[q] == sp.Rational(1, 1000)


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("", "target_value"),
        (",", "target_value"),
        ("q", "target_value"),
        ("q=", "target_value"),
        ("=1", "target_value"),
        ("angle=1", "target_value"),
        ("q=1,0", "target_value"),
        ("q=p", "target_value"),
        ("1/0", "target_value"),
        ("nan", "target_value"),
        ("1e400", "target_value"),
        ("sqrt(-1)", "target_value"),
        ("2^3", "target_value"),
        ("__import__('os')", "target_value"),
        ("...", "target_value"),
        ("0x10", "target_value"),
        ("q=1,q=2", "duplicate_state"),
        ("1,2,3", "target_length"),
        ("p=0", "target_ambiguous"),
    ],
)
def test_texts_that_name_no_point(pendulum, text, code):
    with pytest.raises(TargetError) as caught:
        parse_target(pendulum.loop.plant, text)
    assert caught.value.code == code
    assert "\n" not in caught.value.fault
    assert caught.value.remedy


@given(st.text(max_size=25))
@example("pi/4,\0")
@example("\udcff")
@example("(" * 500)
@example("q=" * 30)
@example("1,(2,3)")
@example("sin(1,2)")
@settings(max_examples=150, deadline=None)
def test_any_text_is_a_point_or_a_target_error(text):
    plant = make_plant((q, p), sp.Matrix([[0, 1], [-1, 0]]), sp.zeros(2, 2), sp.Matrix([0, 1]),
                       p**2 / 2 - sp.cos(q))  # fmt: skip
    try:
        x_star = parse_target(plant, text)
    except TargetError as problem:
        refused = problem
    else:
        assert set(x_star) == {q, p}
        assert all(np.isfinite(float(v)) for v in x_star.values())
        return
    assert refused.code.startswith(("target_", "duplicate_state"))
    assert "\n" not in refused.fault


def test_a_bare_value_for_two_possible_states_is_ambiguous():
    """On q² + p² = const-like sets both coordinates vary: the text must name one."""
    H = q**2 / 2 + p**2 / 2 + q * p
    plant = make_plant((q, p), sp.zeros(2, 2), sp.diag(0, 1), sp.Matrix([1, 0]), H)
    free, dimension = free_coordinates(plant)
    assert (free, dimension) == ([q, p], 1)
    with pytest.raises(TargetError) as caught:
        parse_target(plant, "1")
    assert caught.value.code == "target_ambiguous"
    assert "q=1 or p=1" in caught.value.remedy
    assert parse_target(plant, "q=1") == {q: 1, p: -1}


def test_several_equilibria_are_listed():
    H = p**4 / 4 - p**2 / 2 + q**2 / 2
    plant = make_plant((q, p), sp.Matrix([[0, 1], [-1, 0]]), sp.zeros(2, 2), sp.Matrix([0, 1]), H)
    with pytest.raises(TargetError) as caught:
        parse_target(plant, "q=1")
    assert caught.value.code == "target_ambiguous"
    assert all(f"p={v}" in caught.value.fault for v in (-1, 0, 1))
    assert parse_target(plant, "q=1,p=-1") == {q: 1, p: -1}


@given(st.fractions(-3, 3, max_denominator=12), st.fractions(-3, 3, max_denominator=12))
@settings(max_examples=25, deadline=None)
def test_solved_states_are_equilibria(crane_plant, a, b):
    q1, q2, *_ = crane_plant.x
    values = [sp.Rational(v.numerator, v.denominator) for v in (a, b)]
    given_values = dict(zip((q1, q2), values, strict=True))
    x_star = solve_target(crane_plant, given_values)
    assert {s: x_star[s] for s in given_values} == given_values
    for equation in crane_plant.equilibrium_equations:
        assert sp.simplify(equation.subs(x_star)) == 0


@pytest.fixture(scope="module")
def crane_plant(crane):
    return crane.loop.plant


def test_the_target_of_a_model_file(pendulum):
    plant = pendulum.loop.plant
    assert target_from_model(plant, {"q": sp.pi / 3}) == {q: sp.pi / 3, p: 0}
    for wrong in ({"angle": sp.Integer(1)}, {"q": p}, {"q": sp.I}):
        with pytest.raises(TargetError) as caught:
            target_from_model(plant, wrong)
        assert caught.value.code == "target_value"


def test_the_nearest_equilibrium_is_one(pendulum):
    x = nearest_equilibrium(pendulum.loop.plant, {q: sp.Rational(1, 2), p: sp.Rational(3, 2)})
    np.testing.assert_allclose(x, [0.5, 0.0], atol=1e-12)


def test_complex_roots_are_no_equilibria():
    """A hardening spring under a weight: one real root of a cubic, two that are not."""
    q1, q2, p1, p2 = sp.symbols("q1 q2 p1 p2", real=True)
    J = sp.Matrix(4, 4, lambda i, j: (j == i + 2) - (i == j + 2))
    spring = 16000 * (q1 - q2) ** 2 / 2 + 80000 * (q1 - q2) ** 4
    H = p1**2 / 500 + p2**2 / 80 + spring + 2450 * q1 + 392 * q2
    plant = make_plant((q1, q2, p1, p2), J, sp.zeros(4), sp.Matrix([0, 0, 1, 0]), H)
    x_star = parse_target(plant, "q1=1/20")
    force = -sp.diff(H, q2).subs(x_star)
    assert abs(float(force)) < 1e-9
    assert x_star[q2].evalf(30).is_real


def test_a_target_with_every_state_given_solves_no_equations():
    """They may take minutes to form; with a state that is not given they are needed."""
    plant = load("cart_pole")[0]
    values = {str(s): sp.Integer(0) for s in plant.x}
    assert target_from_model(plant, values) == dict.fromkeys(plant.x, 0)
    assert "equilibrium_equations" not in vars(plant)
    del values["p_x"]
    assert target_from_model(plant, values) == dict.fromkeys(plant.x, 0)
    assert "equilibrium_equations" in vars(plant)


def test_of_several_equilibria_that_fit_the_target_of_the_model_is_meant():
    """The wheel's pendulum rests at 0 and at π whatever φ is; the file says which is meant."""
    model = load_model(EXAMPLES / "inertia_wheel.py")
    theta, phi = model.system.x[:2]
    with pytest.raises(TargetError) as several:
        parse_target(model.system, "phi=0")
    assert several.value.code == "target_ambiguous"
    meant = parse_target(model.system, "phi=0", model.target)
    assert meant[theta] == meant[phi] == 0
    with pytest.raises(TargetError):  # the file says nothing about this place
        parse_target(model.system, "phi=1", model.target)
    assert parse_target(model.system, "phi=1,theta=pi", model.target)[theta] == sp.pi
