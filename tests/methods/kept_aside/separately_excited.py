"""Separately excited DC motor, armature and field voltages as inputs.

Constant load torque (typical 5 kW).
"""

import sympy as sp

fa, ff, p = sp.symbols("psi_a psi_f p", real=True)
Ra, Rf, La, Lf, k = sp.Rational("0.6"), 120, sp.Rational("12e-3"), 60, sp.Rational("1.2")
inertia, b, load = sp.Rational("0.1"), sp.Rational("0.01"), 20
name = "Separately excited motor"
x = (fa, ff, p)
c = k / Lf
J = sp.Matrix([[0, 0, -c * ff], [0, 0, 0], [c * ff, 0, 0]])
R = sp.diag(Ra, Rf, b)
G = sp.Matrix([[1, 0], [0, 1], [0, 0]])
E = sp.Matrix([0, 0, -load])
H = fa**2 / (2 * La) + ff**2 / (2 * Lf) + p**2 / (2 * inertia)
w, i_f = 150, 1
ia = (load + b * w) / (k * i_f)
target = {fa: La * ia, ff: Lf * i_f, p: inertia * w}
domain = {ff: (10, 110), fa: (-1, 1), p: (0, 30)}
units = {fa: "Wb", ff: "Wb", p: "kg m2/s"}
