"""Links in a vertical plane with fewer motors than joints: what is refused, and by which condition.

Numbers of the two links: Spong, The Swing Up Control Problem for the Acrobot, IEEE Control Systems
Magazine 15 (1995).
"""

import pytest
import sympy as sp

from necc_casadi.methods.find import find_method
from necc_casadi.methods.mechanical_model import mechanical_model
from necc_casadi.model.model_file import load_model

TWO_LINKS = """
import sympy as sp
q1, q2 = sp.symbols("q1 q2", real=True)  # rad: first link from upright, elbow
m1, m2, l1, c1, c2 = 1, 1, 1, sp.Rational("0.5"), 1  # kg, m
I1, I2, g = sp.Rational("0.083"), sp.Rational("0.33"), sp.Rational("9.81")  # kg m², m/s²
q = (q1, q2)
M22 = m2 * c2**2 + I2
M12 = M22 + m2 * l1 * c2 * sp.cos(q2)
M11 = m1 * c1**2 + m2 * l1**2 + M22 + 2 * m2 * l1 * c2 * sp.cos(q2) + I1
M = sp.Matrix([[M11, M12], [M12, M22]])
V = (m1 * c1 + m2 * l1) * g * sp.cos(q1) + m2 * c2 * g * sp.cos(q1 + q2)
target = {s: 0 for s in q} | {f"p_{s}": 0 for s in q}
"""
MOTOR = {"acrobot": "B = sp.Matrix([0, 1])", "pendubot": "B = sp.Matrix([1, 0])"}
FRICTION = 'friction = sp.diag(sp.Rational("0.05"), sp.Rational("0.02"))  # N m s'


def asked(tmp_path, *pieces):
    """The model of these pieces of text, and what is found about its target."""
    path = tmp_path / "links.py"
    path.write_text("\n".join(pieces), encoding="utf-8")
    model = load_model(path)
    return model, find_method(model, {s: model.target[str(s)] for s in model.system.x})


def reasons(found, method):
    return [refusal for refusal in found.refusals if refusal.name == method]


@pytest.mark.parametrize("name", MOTOR)
def test_two_links_with_one_motor_are_refused_by_the_force_that_no_input_opposes(tmp_path, name):
    """Its value in each form of the row depends on both angles, which no family integrates."""
    model, found = asked(tmp_path, TWO_LINKS, MOTOR[name])
    assert found.chosen is None
    assert found.refused
    assert found.published.verdict.reason == "invisible_negative_curvature"
    assert all(refusal.proved for refusal in reasons(found, "shaping"))
    mechanical = reasons(found, "mechanical")
    assert len({refusal.reason.split(":")[0] for refusal in mechanical}) == 3
    assert all("s depends on q1 and q2" in refusal.reason for refusal in mechanical)
    assert not any(refusal.proved for refusal in mechanical)
    plant = mechanical_model(model.system)
    upright = dict.fromkeys(plant.q, 0)
    for row in plant.free_rows(dict.fromkeys(model.system.x, sp.Integer(0))):
        assert row.dependence(plant.q).count("s depends on q1 and q2") == 1
        assert all(sp.diff(row.s, q).subs(upright) != 0 for q in plant.q)


@pytest.mark.parametrize("name", MOTOR)
def test_the_target_that_is_refused_is_one_that_linear_feedback_holds(tmp_path, name):
    """The refusal is of these methods: the linearised plant is controllable."""
    model, _ = asked(tmp_path, TWO_LINKS, MOTOR[name])
    plant = model.system
    rest = dict.fromkeys(plant.x, 0)
    A = sp.Matrix((plant.J - plant.R) * plant.grad_H).jacobian(plant.x).subs(rest)
    reached = sp.Matrix.hstack(*(A**k * plant.G for k in range(plant.n)))
    assert reached.rank() == plant.n


def test_friction_is_named_by_the_row_and_not_by_a_joint_that_has_a_motor(tmp_path):
    _, found = asked(tmp_path, TWO_LINKS, MOTOR["pendubot"], FRICTION)
    (refusal,) = reasons(found, "mechanical")
    assert refusal.reason == "friction in the row that no input enters is not covered"
    assert not refusal.proved


THREE_LINKS = """
import sympy as sp
q = q1, q2, q3 = sp.symbols("q1:4", real=True)  # rad, of each link from upright
m = sp.Rational("1.2"), sp.Rational("0.8"), sp.Rational("0.5")  # kg, uniform rods
l = sp.Rational("0.4"), sp.Rational("0.35"), sp.Rational("0.3")  # m
g = sp.Rational("9.81")
moved = [sum(m[i + 1:]) for i in range(3)]
def inertia(i, j):
    i, j = sorted((i, j))
    return (m[j] * l[j] * (sp.Rational(1, 3) if i == j else sp.Rational(1, 2)) + moved[j] * l[j]) * l[i]
M = sp.Matrix(3, 3, lambda i, j: inertia(i, j) * sp.cos(q[i] - q[j]))
V = sum((m[i] / 2 + moved[i]) * l[i] * g * sp.cos(q[i]) for i in range(3))
B = sp.Matrix([1, 0, 0])
target = {s: 0 for s in q} | {f"p_{s}": 0 for s in q}
"""  # noqa: E501


@pytest.mark.slow
def test_two_passive_joints_are_refused_with_what_each_method_lacks(tmp_path):
    """Long expressions are no obstacle to a proof at points that there is no constant F_d."""
    _, found = asked(tmp_path, THREE_LINKS)
    assert found.chosen is None
    assert found.published.verdict.reason == "invisible_negative_curvature"
    (mechanical,) = reasons(found, "mechanical")
    assert "G is not that of 2 forces on 3 coordinates" in mechanical.reason
    (constant,) = reasons(found, "constant")
    assert "in these coordinates" in constant.reason
    assert not mechanical.proved
    assert constant.proved


@pytest.mark.slow
def test_one_passive_joint_of_three_is_refused_before_the_inertia_is_inverted(tmp_path):
    _, found = asked(tmp_path, THREE_LINKS, "B = sp.Matrix([[1, -1], [0, 1], [0, 0]])")
    assert found.chosen is None
    (mechanical,) = reasons(found, "mechanical")
    assert "kinetic energy is too long" in mechanical.reason
    assert not mechanical.proved
