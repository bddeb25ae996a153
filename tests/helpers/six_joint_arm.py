"""An arm of six joints from its masses and lengths, like a PUMA: twelve plant states."""

import sympy as sp

from necc_casadi.model.plant import Plant, make_plant

#: Upper arm and forearm are uniform rods, in kg and m; wrist and load are a mass at the end.
M2, M3, MW = sp.Integer(12), sp.Integer(6), sp.Integer(3)
L2, L3 = sp.Rational(45, 100), sp.Rational(40, 100)
#: The column's inertia around the vertical, and those of the wrist's joints, in kg m².
I1, WRIST = sp.Rational(3, 2), (sp.Rational(1, 5), sp.Rational(1, 5), sp.Rational(1, 10))
GRAVITY = sp.Rational(981, 100)
TARGET = (sp.pi / 6, sp.pi / 4, -sp.pi / 3, 0, sp.pi / 4, 0)


def six_joint_arm() -> Plant:
    """Yaw of the column, pitch of upper arm above the horizontal, elbow, the wrist's joints."""
    q, p = sp.symbols("q1:7", real=True), sp.symbols("p1:7", real=True)
    c2, c3, c23 = sp.cos(q[1]), sp.cos(q[2]), sp.cos(q[1] + q[2])
    column = I1 + M2 * L2**2 * c2**2 / 3 + M3 * (L2**2 * c2**2 + L2 * L3 * c2 * c23)
    column += M3 * L3**2 * c23**2 / 3 + MW * (L2 * c2 + L3 * c23) ** 2
    upper = (M2 / 3 + M3 + MW) * L2**2
    fore, both = (M3 / 3 + MW) * L3**2, (M3 / 2 + MW) * L2 * L3
    pitch = sp.Matrix([[upper + fore + 2 * both * c3, fore + both * c3], [fore + both * c3, fore]])
    determinant = upper * fore - both**2 * c3**2
    p23 = sp.Matrix(p[1:3])
    kinetic = p[0] ** 2 / (2 * column) + (p23.T * pitch.adjugate() * p23)[0] / (2 * determinant)
    kinetic += sum(v**2 / (2 * inertia) for v, inertia in zip(p[3:], WRIST, strict=True))
    weight = (M2 / 2 + M3 + MW) * L2 * sp.sin(q[1]) + (M3 / 2 + MW) * L3 * sp.sin(q[1] + q[2])
    J = sp.Matrix(sp.BlockMatrix([[sp.zeros(6), sp.eye(6)], [-sp.eye(6), sp.zeros(6)]]))
    G = sp.Matrix.vstack(sp.zeros(6), sp.eye(6))
    return make_plant(
        (*q, *p), J, sp.zeros(12), G, kinetic + GRAVITY * weight, name="Arm of six joints"
    )
