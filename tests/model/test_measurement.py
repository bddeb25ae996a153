"""What the controller measures: (q, q̇) of mechanical plants, their energy and its slopes in it."""

import numpy as np
import pytest
import sympy as sp
from helpers.problems import PENDULUM as EXAMPLE

from necc_casadi.errors import ModelError
from necc_casadi.model.measurement import Measurement
from necc_casadi.model.model_file import load_model

ARM = """
import sympy as sp
q1, q2 = sp.symbols("q1 q2")
q = (q1, q2)
h = sp.Rational(1, 3) + sp.cos(q2) / 2
M = [[sp.Rational(5, 3) + sp.cos(q2), h], [h, sp.Rational(1, 3)]]
V = 3 * (1 - sp.cos(q1)) + (1 - sp.cos(q1 + q2)) / 2
B = sp.eye(2)
units = {q1: "rad", q2: "rad", "p_q1": "kg m²/s"}
"""
CART_POLE = """
import sympy as sp
s, a = sp.symbols("s a")
q = (s, a)
M = [[2, sp.cos(a)], [sp.cos(a), 1]]
V = sp.cos(a)
B = [[1], [0]]
"""


def load(folder, text):
    path = folder / "own.py"
    path.write_text(text, encoding="utf-8")
    return load_model(path)


def numbers(known, entries, values):
    symbols = dict(zip(known, values, strict=True))
    return np.array([float(sp.sympify(e).subs(symbols).evalf(30)) for e in entries])


@pytest.mark.parametrize("text", [ARM, CART_POLE], ids=["arm", "cart-pole"])
def test_energy_slopes_and_rates_are_those_of_the_momenta(tmp_path, text):
    plant = load(tmp_path, text).loop.plant
    known = Measurement(plant)
    rng = np.random.default_rng(0)
    for _ in range(5):
        y = rng.uniform(-2, 2, plant.n)
        x = numbers(known.y, known.state, y)
        assert numbers(known.y, [known.energy], y) == pytest.approx(numbers(plant.x, [plant.H], x))
        assert numbers(known.y, known.slopes, y) == pytest.approx(numbers(plant.x, plant.grad_H, x))
        assert numbers(plant.x, known.output, x) == pytest.approx(y)


def test_velocities_are_what_a_plant_of_m_v_and_b_measures(tmp_path):
    known = Measurement(load(tmp_path, ARM).loop.plant)
    assert known.names == ("q1", "q2", "q1_dot", "q2_dot")
    assert known.units == {"q1": "rad", "q2": "rad", "q1_dot": "rad/s", "q2_dot": "rad/s"}
    states = Measurement(load(tmp_path, ARM + 'measured = "state"').loop.plant)
    assert states.names == ("q1", "q2", "p_q1", "p_q2")
    assert states.state == states.output == states.y == states.plant.x
    assert states.units["p_q1"] == "kg m²/s"


def test_a_canonical_plant_can_be_measured_so(tmp_path):
    text = EXAMPLE.with_name("two_link_arm.py").read_text(encoding="utf-8")
    assert load(tmp_path, text).loop.plant.inertia is None
    inertia = load(tmp_path, text + '\nmeasured = "velocity"').loop.plant.inertia
    q2 = sp.Symbol("q2", real=True)
    h = sp.Rational(1, 3) + sp.cos(q2) / 2
    wanted = sp.Matrix([[sp.Rational(5, 3) + sp.cos(q2), h], [h, sp.Rational(1, 3)]])
    assert sp.simplify(inertia - wanted) == sp.zeros(2, 2)


@pytest.mark.parametrize(
    ("more", "piece"),
    [
        ("J = sp.Matrix([[0, 2], [-2, 0]])", "are not (q, p)"),
        ("H = p**4 + q**2", "not quadratic in p"),
        ("H = p**2 / 2 + p + q**2", "not quadratic in p"),
        ('measured = "velocities"', "measured = 'velocities'"),
        ("measured = 3", "measured = 3"),
        ("del J, R, H\nf = sp.Matrix([p, 0])", "gives no momenta"),
    ],
)
def test_what_has_no_velocities_says_so(tmp_path, more, piece):
    text = EXAMPLE.read_text(encoding="utf-8") + '\nmeasured = "velocity"\n' + more
    with pytest.raises(ModelError) as fault:
        load(tmp_path, text)
    assert fault.value.code == "model_file"
    assert piece in str(fault.value)
