"""Mechanical plants by inertia, potential, inputs and friction: x, J, R, G and H made of them."""

import pytest
import sympy as sp
from helpers.problems import PENDULUM as EXAMPLE

from necc_casadi.errors import ModelError
from necc_casadi.model.model_file import load_model
from necc_casadi.symbolic.zero import is_zero

PENDULUM = """
import sympy as sp
q, m, l, g, d = sp.symbols("q m l g d")
M = m * l**2
V = m * g * l * (1 - sp.cos(q))
B = 1
friction = d
params = {m: 2, l: 0.5, g: 9.81, d: 0.1}
"""
ARM = """
import sympy as sp
q1, q2 = sp.symbols("q1 q2")
q = (q1, q2)
g = 9.81
h = sp.Rational(1, 3) + sp.cos(q2) / 2
M = [[sp.Rational(5, 3) + sp.cos(q2), h], [h, sp.Rational(1, 3)]]
V = g * (1.5 * (1 - sp.cos(q1)) + (1 - sp.cos(q1 + q2)) / 2)
B = sp.eye(2)
"""


def load(folder, text, overrides=None):
    path = folder / "own.py"
    path.write_text(text, encoding="utf-8")
    return load_model(path, overrides)


def test_the_arm_by_its_inertia_is_the_arm_of_the_examples(tmp_path):
    made = load(tmp_path, ARM).loop.plant
    known = load_model(EXAMPLE.with_name("two_link_arm.py")).loop.plant
    assert made.states == ("q1", "q2", "p_q1", "p_q2")
    renamed = dict(zip(known.x, made.x, strict=True))
    assert (made.J, made.R, made.G) == (known.J, known.R, known.G)
    assert is_zero(made.H - known.H.xreplace(renamed)) is True
    assert made.H.count_ops() <= known.H.count_ops() + 5


def test_a_pendulum_with_parameters(tmp_path):
    model = load(tmp_path, PENDULUM, {"m": "4"})
    plant = model.loop.plant
    q, p = plant.x
    assert plant.states == ("q", "p_q")
    assert p.is_real
    assert sp.Matrix([[0, 1], [-1, 0]]) == plant.J
    assert sp.diag(0, sp.Rational(1, 10)) == plant.R
    assert sp.Matrix([0, 1]) == plant.G
    assert sp.expand(plant.H - p**2 / 2 - sp.Rational("19.62") * (1 - sp.cos(q))) == 0
    assert all(known.proved for known in plant.properties)


def test_parameters_are_kept_as_symbols_too(tmp_path):
    model = load(tmp_path, PENDULUM)
    formal = model.parametric
    m, length, g, d = sp.symbols("m l g d", real=True)
    q, p = model.system.x
    known = p**2 / (2 * m * length**2) + m * g * length * (1 - sp.cos(q))
    assert sp.simplify(formal.H - known) == 0
    assert sp.diag(0, d) == formal.R
    at = formal.at(formal.values)
    assert (at.J, at.R, at.G) == (model.system.J, model.system.R, model.system.G)
    assert is_zero(at.H - model.system.H) is True
    assert load(tmp_path, ARM).parametric is None


def test_coordinates_that_are_not_coupled_have_energies_of_their_own(tmp_path):
    text = ARM.replace("[h,", "[0,").replace(", h]", ", 0]")
    H = load(tmp_path, text).loop.plant.H
    assert H.coeff(sp.Symbol("p_q2", real=True), 2) == sp.Rational(3, 2)


def test_momenta_are_called_by_name(tmp_path):
    text = """
units = {q: "rad", "p_q": "kg m²/s"}
domain = {"p_q": (-2, 2)}
sizes = {"p_q": 3, "u": 5}
target = {q: 1, "p_q": 0}
u_limits = [(-10, 10)]
"""
    made = load(tmp_path, PENDULUM + text)
    assert made.target == {"q": 1, "p_q": 0}
    plant = made.system
    assert plant.units == {"q": "rad", "p_q": "kg m²/s"}
    assert plant.domain == {"p_q": (-2, 2)}
    assert plant.sizes == {"p_q": 3, "u": 5}
    assert plant.u_limits == ((-10, 10),)


def test_a_constant_source_stands_beside_the_inputs(tmp_path):
    made = load(tmp_path, PENDULUM + "E = [0, 3]").system
    assert list(made.E) == [0, 3]


def test_q_M_V_and_B_are_the_files_own_affair_beside_another_form(tmp_path):
    form = """
p = sp.Symbol("p")
x, J, R, G = (q, p), sp.Matrix([[0, 1], [-1, 0]]), sp.zeros(2), [0, 1]
H = p**2 / (2 * M) + V
"""
    assert load(tmp_path, PENDULUM + form).system.states == ("q", "p")
    affine = "\np = sp.Symbol('p')\nx, f, G = (q, p), [p / M, -V.diff(q)], [0, B]"
    assert load(tmp_path, PENDULUM + affine).system.states == ("q", "p")
    with pytest.raises(ModelError, match="does not define J"):
        load(tmp_path, PENDULUM + form + "del J")


def test_a_name_near_to_friction_is_told(tmp_path):
    (note,) = load(tmp_path, PENDULUM.replace("friction", "fricton")).notes
    assert "did you mean friction?" in note


@pytest.mark.parametrize(
    ("code", "text", "piece"),
    [
        ("shape", "q = 3", "q = 3"),
        ("shape", 'q = ("q1", "q2")', "q[0] = q1 is not a symbol"),
        ("duplicate_state", "q = (q1, q1)", "q1 stands twice"),
        ("shape", "M = sp.eye(3)", "M has shape 3×3, but q has 2 coordinates"),
        ("shape", "M = 2", "M has shape 1×1"),
        ("shape", "M = None", "M = None is not a matrix"),
        ("shape", "B = sp.eye(3)", "B has shape 3×3"),
        ("shape", "B = sp.zeros(2, 0)", "B has shape 2×0"),
        ("shape", "friction = 0.1", "friction has shape 1×1"),
        ("model_file", "M[0][1] = 0", "M must be symmetric: M[0,1] = 0"),
        ("model_file", "M = sp.diag(1, -1)", "M must be positive definite: M[1,1] = -1"),
        ("singular", "M = sp.ones(2, 2)", "M has rank 1"),
        ("h_not_scalar", "V = sp.Matrix([q1, q2])", "V is a 2×1 matrix"),
        ("h_not_scalar", "V = [q1]", "V = [q1]"),
        ("h_not_scalar", "V = None", "V = None"),
        ("undefined_symbol", 'V = sp.Symbol("p_q1")', "V contains p_q1"),
        ("undefined_symbol", 'M = sp.Symbol("m") * sp.eye(2)', "M[0,0] contains m"),
        ("non_smooth", "V = abs(q1)", "V contains Abs"),
        ("r_not_psd", "friction = sp.diag(1, -1)", "friction[1,1] = -1"),
        ("r_not_symmetric", "friction = [[1, 1], [0, 1]]", "friction[0,1] = 1"),
        ("g_rank", "B = [[1, 1], [1, 1]]", "B has rank 1"),
        ("name_clash", 'params = {"p_q1": 1}', "p_q1"),
    ],
)
def test_faults_name_the_entry(tmp_path, code, text, piece):
    with pytest.raises(ModelError) as caught:
        load(tmp_path, ARM + text)
    assert caught.value.code == code
    assert piece in caught.value.fault
    assert "\n" not in caught.value.fault + caught.value.remedy
