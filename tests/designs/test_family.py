"""Families: what a design does for other set-points and plants, by the physical loop itself."""

import numpy as np
import pytest
import sympy as sp
from helpers.problems import problem, solve

from necc_casadi.designs.family import Family, lift
from necc_casadi.errors import OutputError
from necc_casadi.model.family_loop import NoFamily
from necc_casadi.model.model_file import load_model
from necc_casadi.model.parametric import Parametric
from necc_casadi.model.ranges import Ranges
from necc_casadi.synthesis.options import Options

S = sp.Rational
SMALL = Options(hidden_k=(6,), hidden_h=(5,))

PENDULUM = """
import sympy as sp
q, p = sp.symbols("q p")
m, g, b, k = sp.symbols("m g b k")
x = (q, p)
J = sp.Matrix([[0, 1], [-1, 0]])
R = sp.diag(0, b)
G = sp.Matrix([0, k])
H = p**2 / (2 * m) + m * g * (1 - sp.cos(q))
params = {m: 1, g: 1, b: sp.Rational(1, 10), k: 1}
"""

#: Two carts on one track, each driven; the spring between them is not known.
CARTS = """
import sympy as sp
q1, q2, p1, p2, k, b1, b2 = sp.symbols("q1 q2 p1 p2 k b1 b2")
x = (q1, q2, p1, p2)
J = sp.Matrix([[0, 0, 1, 0], [0, 0, 0, 1], [-1, 0, 0, 0], [0, -1, 0, 0]])
R = sp.zeros(4, 4)
G = sp.Matrix([[0, 0], [0, 0], [b1, 0], [0, b2]])
H = p1**2 / 2 + p2**2 / 4 + k * (q2 - q1)**2 / 2
params = {k: 2, b1: 1, b2: 1}
"""

#: The force on the first mass comes through the spring alone: a load moves where it can rest.
TWO_MASSES = """
import sympy as sp
q1, q2, p1, p2, load = sp.symbols("q1 q2 p1 p2 load")
x = (q1, q2, p1, p2)
J = sp.Matrix([[0, 0, 1, 0], [0, 0, 0, 1], [-1, 0, 0, 0], [0, -1, 0, 0]])
R = sp.zeros(4, 4)
G = sp.Matrix([0, 0, 0, 1])
H = p1**2 / 2 + p2**2 / 2 + (q1 - q2)**2 / 2 + load * q1
params = {load: 0}
"""

EVERYTHING = Ranges(
    {"q": (S(-5, 2), S(5, 2))},
    {
        "m": (S(9, 10), S(11, 10)),
        "g": (S(19, 20), S(21, 20)),
        "b": (sp.Integer(0), S(1, 5)),
        "k": (S(4, 5), S(6, 5)),
    },
    ((S(-1, 5), S(1, 5)),),
)


def made_of(folder, text, target):
    path = folder / "plant.py"
    path.write_text(text, encoding="utf-8")
    return problem(load_model(path), target)


@pytest.fixture(scope="module")
def task(tmp_path_factory):
    return made_of(tmp_path_factory.mktemp("family"), PENDULUM, "pi/4")


@pytest.fixture(scope="module")
def made(task):
    return solve(task, SMALL)


@pytest.fixture(scope="module")
def family(task, made) -> Family:
    found = lift(made, EVERYTHING, task.model.parametric)
    assert isinstance(found, Family), found.sentence
    return found


def drawn(family, rng):
    """Numbers within the ranges, by name."""
    return {p.name: rng.uniform(*map(float, p.range)) for p in family.parameters}


def test_at_its_own_set_point_it_is_the_controller_of_the_design(family, made):
    rng = np.random.default_rng(0)
    for x, xi in zip(rng.normal(size=(5, 2)), rng.normal(size=(5, 1)), strict=True):
        for ours, own in zip(family.control(x, xi, [np.pi / 4]), made.control(x, xi), strict=True):
            np.testing.assert_allclose(ours, own, rtol=0, atol=1e-14)


def test_the_gradient_condition_holds_for_every_set_point_and_all_weights(family, made):
    """By finite differences of V, with weights that no training has seen."""
    from dataclasses import replace

    rng = np.random.default_rng(1)
    wild = Family(replace(made, weights=made.weights + 0.3), family.moved)
    at = made.z_star
    base = wild.member().lyapunov.gradient(at)
    for r in rng.uniform(-2.5, 2.5, 4):
        V = wild.member({"q": r}).lyapunov.V
        slope = [(V(at + h) - V(at - h)) / 2e-5 for h in 1e-5 * np.eye(3)]
        np.testing.assert_allclose(slope, base, rtol=0, atol=1e-8)


def test_a_member_is_the_physical_loop_with_measured_velocity(family, made):
    """Plant θ, disturbance d and set-point r put together by hand, at random states."""
    rng = np.random.default_rng(2)
    for _ in range(8):
        v = drawn(family, rng)
        q, p, xi = rng.normal(size=3)
        measured = [q, p / v["m"]]  # nominal mass 1: momentum and velocity are one number
        u, xi_dot = family.control(measured, [xi], [v["q"]])
        torque = v["k"] * (u[0] + v["d_u"])
        speed = p / v["m"]
        physical = [speed, -v["m"] * v["g"] * np.sin(q) - v["b"] * speed + torque, xi_dot[0]]
        member = family.member(v)
        seen = np.array([*(np.array([q, p]) - family.shift(v)), xi])
        np.testing.assert_allclose(member.lyapunov.vector_field(seen), physical, atol=1e-12)
        fall = member.lyapunov.gradient(seen) @ np.array(physical)
        assert fall < 1e-12


def test_v_of_all_parameters_is_that_of_each_member(family):
    rng = np.random.default_rng(3)
    v, z = drawn(family, rng), rng.normal(size=3)
    theta = [v[p.name] for p in family.parameters]
    np.testing.assert_allclose(
        float(family.V_function(z, theta)), family.member(v).V(z), rtol=1e-13
    )


def test_it_is_read_as_it_was_written(family, made, tmp_path):
    made.save(tmp_path / "design.json")
    family.save(tmp_path / "family.json")
    again = Family.load(tmp_path)
    assert again.text == family.text
    v = {"q": 1.5, "m": 1.07}
    assert again.member(v).V([0.3, 0.1, 0.2]) == family.member(v).V([0.3, 0.1, 0.2])
    (tmp_path / "family.json").write_text(family.text.replace(made.hash, "0" * 64))
    with pytest.raises(OutputError, match="another design"):
        Family.load(tmp_path)


def test_domain_and_limits_are_seen_from_the_set_point(tmp_path):
    task = made_of(tmp_path, PENDULUM + "domain = {q: (-3, 3)}\nu_limits = [(-2, 2)]\n", "1/2")
    family = lift(solve(task, SMALL), Ranges({"q": (S(-1), S(1))}), task.model.parametric)
    plant = family.member({"q": 1.0}).loop.plant
    assert plant.domain["q"] == (S(-7, 2), S(5, 2))
    held = np.sin(1.0) - np.sin(0.5)
    np.testing.assert_allclose(plant.u_limits, [(-2 - held, 2 - held)])


def refused(found, reason, piece):
    assert isinstance(found, NoFamily)
    assert found.reason == reason
    assert piece in found.sentence


def test_other_gains_of_single_inputs_are_not_covered(tmp_path):
    task = made_of(tmp_path, CARTS, "1,2")
    made = solve(task, SMALL)
    known = lift(made, Ranges(uncertain={"k": (S(1), S(3))}), task.model.parametric)
    assert isinstance(known, Family)
    found = lift(made, Ranges(uncertain={"b1": (S(1, 2), S(2))}), task.model.parametric)
    refused(found, "not_covered", "b1")


def test_a_load_that_moves_the_equilibrium_is_refused_with_the_witness(tmp_path):
    task = made_of(tmp_path, TWO_MASSES, "q2=0")
    ranges = Ranges(uncertain={"load": (S(-1), S(1))})
    found = lift(solve(task, SMALL), ranges, task.model.parametric)
    refused(found, "refused", "load = 1")
    assert found.witness == {"load": 1}


def test_a_neural_phi_is_no_family(designs):
    refused(lift(designs["neural"], Ranges({"q": (S(0), S(1))})), "not_covered", "Φ is a network")


def test_dissipation_in_a_shaped_coordinate_is_refused(tmp_path):
    """A Casimir that holds for R = 0 there holds for no other value."""
    task = made_of(tmp_path, PENDULUM, "0")
    known, e = task.model.parametric, sp.Symbol("e", real=True)
    leaky = Parametric(
        known.J, known.R + sp.diag(e, 0), known.G, known.H, {**known.values, "e": sp.Integer(0)}
    )
    ranges = Ranges(uncertain={"e": (sp.Integer(0), S(1, 10))})
    refused(lift(solve(task, SMALL), ranges, leaky), "refused", "no Casimir")


def test_friction_that_may_be_negative_is_not_proved(task, made):
    found = lift(made, Ranges(uncertain={"b": (S(-1, 10), S(1))}), task.model.parametric)
    refused(found, "undecided", "R ⪰ 0")


def test_the_dc_motor_moves_along_its_equilibria(tmp_path):
    """Current and angle move together: x*(r) is no single coordinate."""
    from helpers.problems import PENDULUM as EXAMPLE

    task = problem(load_model(EXAMPLE.parent / "dc_motor.py"), None)
    family = lift(solve(task, SMALL), Ranges({"theta": (S(-1), S(1))}))
    rest = family.x_star({"theta": 0.5})
    np.testing.assert_allclose(rest, [np.sin(0.5), 0, 0.5])
    member = family.member({"theta": 0.5})
    np.testing.assert_allclose(
        member.lyapunov.gradient(member.z_star), family.member().lyapunov.gradient(member.z_star),
        rtol=0, atol=1e-12,
    )  # fmt: skip


def test_a_parameter_that_is_called_as_a_disturbance_is_no_family(tmp_path):
    text = PENDULUM.replace("k = sp", "k, d_u = sp").replace('b k")', 'b k d_u")')
    text = text.replace("k: 1}", "k: 1, d_u: 1}")
    task = made_of(tmp_path, text.replace("m * g *", "m * g * d_u *"), "pi/4")
    ranges = Ranges({}, {"d_u": (S(9, 10), S(11, 10))}, ((S(-1, 10), S(1, 10)),))
    found = lift(solve(task, SMALL), ranges, task.model.parametric)
    assert isinstance(found, NoFamily)
    assert "d_u names a parameter" in found.text
