"""Inputs in J, and sources: the shift, and converters that are held with clipped inputs."""

import dataclasses
import json

import numpy as np
import pytest
import sympy as sp
from helpers.problems import solve
from hypothesis import given, settings
from hypothesis import strategies as st

from necc_casadi.certificate.checker.check import check
from necc_casadi.certificate.prover.certify import certify
from necc_casadi.errors import ModelError
from necc_casadi.methods.find import find_method
from necc_casadi.methods.modulated import at_its_minimum, shifted_plant
from necc_casadi.model.control_affine import ControlAffine
from necc_casadi.model.model_file import load_model
from necc_casadi.model.modulated import Modulated, make_modulated
from necc_casadi.model.target import parse_target
from necc_casadi.simulation.saturated import saturated_field
from necc_casadi.symbolic.zero import is_zero

#: 12 V in, a coil of 1 mH, a capacitor of 100 µF and a load of 20 Ω.
BOOST = """
import sympy as sp
phi, Q, u = sp.symbols("phi Q u", real=True)
x = (phi, Q)
J = sp.Matrix([[0, u - 1], [1 - u, 0]])
R = sp.diag(0, sp.Rational(1, 20))
E = sp.Matrix([12, 0])
H = phi**2 / (2 * sp.Rational(1, 1000)) + Q**2 / (2 * sp.Rational(1, 10000))
u_limits = [(0, 1)]
"""


@pytest.fixture(scope="module")
def boost(tmp_path_factory):
    path = tmp_path_factory.mktemp("models") / "boost.py"
    path.write_text(BOOST, encoding="utf-8")
    return load_model(path)


@pytest.fixture(scope="module")
def held(boost):
    x_star = parse_target(boost.system, "Q=0.0024")
    return find_method(boost, x_star), x_star


@pytest.fixture(scope="module")
def made(held):
    found, x_star = held
    method = found.chosen
    return solve(dataclasses.replace(Task(method.loop, method.casimirs, method.verdict, x_star)))


@dataclasses.dataclass
class Task:
    loop: object
    casimirs: object
    verdict: object
    x_star: dict


def test_the_shift_is_the_plant_itself(boost, held):
    """ẋ of the model at u = ½ + w is (J − R)∇(H + h) + g w, for every w."""
    assert isinstance(boost.system, Modulated)
    found, x_star = held
    assert found.chosen.name == "modulated"
    plant, w = found.chosen.loop.plant, sp.Symbol("w")
    assert plant.preliminary.u0 == sp.ImmutableMatrix([[sp.Rational(1, 2)]])
    u = plant.preliminary.u0[0] + w
    motion = boost.system.motion.subs({boost.system.u[0]: u})
    assert all(is_zero(e) for e in motion - plant.flow - plant.G * w)
    assert all(e == 0 for e in plant.grad_H.subs(x_star))


def test_a_converter_is_held_from_everywhere_with_a_clipped_duty(made, tmp_path):
    certificate = certify(made)
    claims = {c.name: c for c in certificate.claims}
    assert certificate.is_global
    assert claims["clipping"].holds
    assert claims["clipping"].data == {"everywhere": True}
    made.save(tmp_path / "design.json")
    (tmp_path / "certificate.json").write_text(certificate.to_json(), encoding="utf-8")
    results = [r for r in check(tmp_path) if r.name != "code"]
    assert [r.statement for r in results if not r.holds] == []


def test_V_falls_along_clipped_responses_from_far_away(made):
    """Own Runge–Kutta steps of the model with u in [0, 1], 100 sizes from the target."""
    rng = np.random.default_rng(1)
    z = made.z_star + 100 * rng.uniform(-1, 1, (50, 3)) * made.sizes.state
    field, V = saturated_field(made), made.lyapunov
    before, h = V.V(z), 1e-7
    for _ in range(20):
        k1 = np.asarray(field(z.T), float).T
        z = z + h * np.asarray(field((z + h / 2 * k1).T), float).T
        now = V.V(z)
        assert np.all(now <= before + 1e-12 * np.abs(before))
        before = now


@pytest.mark.parametrize(
    "change",
    [
        ("u0", lambda model: model["preliminary"].update(u0=[["0"]])),
        ("f", lambda model: model["preliminary"].update(f=[["0"], ["0"]])),
        ("limits", lambda model: model.update(u_limits=[[0.5, 1.0]])),
    ],
    ids=lambda change: change[0],
)
def test_the_checker_refuses_another_feedback(made, tmp_path, change):
    certificate = certify(made)
    data = json.loads(made.text)
    change[1](data["model"])
    (tmp_path / "design.json").write_text(json.dumps(data), encoding="utf-8")
    (tmp_path / "certificate.json").write_text(certificate.to_json(), encoding="utf-8")
    results = {r.name: r.holds for r in check(tmp_path)}
    assert not results["design"]
    assert not results["clipping" if change[0] == "limits" else "matching"]


def test_a_load_torque_is_a_source():
    """A machine with losses: h is not linear, and u₀ takes what h leaves."""
    d, q, p = sp.symbols("psi_d psi_q p", real=True)
    J = sp.Matrix([[0, 0, q], [0, 0, -(d + 1)], [-q, d + 1, 0]])
    R, G = sp.diag(sp.Rational(1, 2), sp.Rational(1, 2), sp.Rational(1, 10)), sp.eye(3)[:, :2]
    system = make_modulated(
        (d, q, p), (), J, R, G, sp.Matrix([0, 0, -sp.Rational(1, 5)]), d**2 + q**2 + p**2 / 2,
        name="machine",
    )  # fmt: skip
    x_star = parse_target(system, "p=1,psi_d=0")
    plant = shifted_plant(system, x_star)
    assert not isinstance(plant, str)
    assert plant.preliminary.matches(plant.flow, plant.G)
    assert at_its_minimum(plant, x_star) is None


@given(
    st.lists(st.integers(-3, 3), min_size=3, max_size=3),
    st.lists(st.integers(-2, 2), min_size=3, max_size=3),
    st.integers(1, 3),
)
@settings(max_examples=30, deadline=None)
def test_random_converters_are_rewritten_exactly(skew, push, loss):
    """J = J₀ + u J₁ over three states: at any equilibrium the shift leaves the motion as it is."""
    x, u = sp.symbols("x1:4", real=True), sp.Symbol("u", real=True)
    a, b, c = skew
    J0 = sp.Matrix([[0, a, b], [-a, 0, c], [-b, -c, 0]])
    J1 = sp.Matrix([[0, 1, 0], [-1, 0, 1], [0, -1, 0]])
    H = sum(s**2 for s in x) / 2
    system = make_modulated(
        x, (u,), J0 + u * J1, loss * sp.eye(3), None, sp.Matrix(push), H, name="random"
    )
    F = J0 + J1 / 2 - loss * sp.eye(3)
    rest = -F.LUsolve(sp.Matrix(push))  # the equilibrium at u = 1/2
    x_star = dict(zip(x, rest, strict=True))
    if all(e == 0 for e in J1 * rest):
        return
    plant = shifted_plant(system, x_star)
    assert not isinstance(plant, str)
    w = sp.Symbol("w", real=True)
    motion = system.motion.subs(u, plant.preliminary.u0[0] + w)
    assert all(is_zero(e) for e in motion - plant.flow - plant.G * w)


@pytest.mark.parametrize(
    ("line", "code", "named"),
    [
        ("J = sp.Matrix([[0, u**2], [-u**2, 0]])", "model_file", "affine"),
        ("J = sp.Matrix([[0, u], [u, 0]])", "j_not_skew", "J"),
        ("E = sp.Matrix([12, 0, 0])", "shape", "E"),
        ("G = sp.Matrix([[1, 0], [0, 1]])", "shape", "G"),
        ("u_limits = [(0, 1), (0, 1)]", "limits", "u_limits"),
        ("E = sp.Matrix([phi, 0])", "undefined_symbol", "E"),
        ("R = sp.Matrix([[0, u], [0, 0]])", "r_not_symmetric", "R"),
        ("J = sp.zeros(2)", "model_file", "does not define G"),
    ],
)
def test_faults_of_a_model_are_named(tmp_path, line, code, named):
    path = tmp_path / "own.py"
    path.write_text(f"{BOOST}\n{line}\n", encoding="utf-8")
    with pytest.raises(ModelError) as caught:
        load_model(path)
    assert caught.value.code == code
    assert named in str(caught.value)


def test_a_target_at_which_no_input_acts_is_told(boost):
    """At rest ∂ẋ/∂u = (Q, −φ) is 0: no u* is singled out."""
    phi, Q = boost.system.x
    found = find_method(boost, {phi: sp.Integer(0), Q: sp.Integer(0)})
    assert found.chosen is None
    assert not found.refused
    assert any("input" in refusal.reason for refusal in found.refusals)


def test_a_method_is_refused_for_what_it_lacks_itself(tmp_path):
    """The published loop sees no q here; that says nothing of what was asked instead."""
    path = tmp_path / "two.py"
    path.write_text(
        'import sympy as sp\nq, p = x = sp.symbols("q p")\n'
        "J, R, G = sp.Matrix([[0, 1], [-1, 0]]), sp.zeros(2), sp.eye(2)\n"
        "H = p**2 / 2 + 1 - sp.cos(q)\n",
        encoding="utf-8",
    )
    model = load_model(path)
    x_star = parse_target(model.system, "q=1,p=0")
    assert find_method(model, x_star, "interconnection").refused
    for method in ("constant", "modulated", "mechanical"):
        found = find_method(model, x_star, method)
        assert found.chosen is None
        assert not found.refused
    assert find_method(model, x_star, "shaping").chosen.name == "shaping"


def test_another_u_or_E_is_the_files_own_affair(tmp_path):
    path = tmp_path / "beam.py"
    path.write_text(
        "import sympy as sp\n"
        'q, p = x = sp.symbols("q p")\n'
        "E, u = 210, 3\n"
        "J, R, G = sp.Matrix([[0, 1], [-1, 0]]), sp.zeros(2), sp.Matrix([0, 1])\n"
        "H = p**2 / 2 + E * q**2\n",
        encoding="utf-8",
    )
    assert load_model(path).loop.plant.m == 1


def test_a_plant_without_an_energy(tmp_path):
    path = tmp_path / "own.py"
    path.write_text(
        'import sympy as sp\nx = a, b = sp.symbols("a b")\n'
        "f, G = sp.Matrix([b, a - a**3 - b]), sp.Matrix([0, 1])\n",
        encoding="utf-8",
    )
    model = load_model(path)
    assert isinstance(model.system, ControlAffine)
    x_star = parse_target(model.system, "a=1/2")
    found = find_method(model, x_star)
    assert found.published is None
    assert found.chosen.name == "constant"
    plant = found.chosen.loop.plant
    assert plant.preliminary.matches(plant.flow, plant.G)
    with pytest.raises(ModelError, match="no J, R and H"):
        _ = model.loop
