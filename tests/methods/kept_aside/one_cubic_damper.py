"""Two equal masses on equal springs beside an actuated one; only one of them has a damper.

Of cubic force.
"""

import sympy as sp

q1, q2, q3, p1, p2, p3 = sp.symbols("q1 q2 q3 p1 p2 p3", real=True)
m, k, c = sp.Rational("0.5"), 200, 4
name = "Twin masses with one cubic damper"
x = (q1, q2, q3, p1, p2, p3)
J = sp.Matrix(sp.BlockMatrix([[sp.zeros(3), sp.eye(3)], [-sp.eye(3), sp.zeros(3)]]))
R = sp.diag(0, 0, 0, c * (p1 / m) ** 2, 0, 0)
G = sp.Matrix([0, 0, 0, 0, 1, 0])
H = (p1**2 + p2**2 + p3**2) / (2 * m) + k * (q1**2 + q3**2 + (q2 - q1) ** 2 + (q3 - q2) ** 2) / 2
target = {
    q1: sp.Rational("0.02"),
    q2: sp.Rational("0.04"),
    q3: sp.Rational("0.02"),
    p1: 0,
    p2: 0,
    p3: 0,
}
units = {q1: "m", q2: "m", q3: "m"}
