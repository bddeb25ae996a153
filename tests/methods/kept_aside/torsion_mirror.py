"""Electrostatic torsion mirror held beyond pull-in by its charge through a resistor.

Source: Degani et al., Pull-in Study of an Electrostatic Torsion Microactuator, JMEMS 7 (1998),
for the model; numbers typical.
"""

import sympy as sp

theta, p, Q = sp.symbols("theta p Q", real=True)
K, inertia, b = sp.Rational("5e-9"), sp.Rational("1e-16"), sp.Rational("1e-13")
eps, w, Lx, d, r = (
    sp.Rational("8.854e-12"),
    sp.Rational("1e-3"),
    sp.Rational("5e-4"),
    sp.Rational("2e-5"),
    10**6,
)
tm = d / Lx
C = eps * w / theta * sp.log(tm / (tm - theta))
name = "Torsion mirror"
x = (theta, p, Q)
J = sp.Matrix([[0, 1, 0], [-1, 0, 0], [0, 0, 0]])
R = sp.diag(0, b, sp.Rational(1, r))
G = sp.Matrix([0, 0, sp.Rational(1, r)])
H = K * theta**2 / 2 + p**2 / (2 * inertia) + Q**2 / (2 * C)
held = sp.Rational(3, 5) * tm
slope = sp.diff(1 / C, theta).subs(theta, held)
target = {theta: held, p: 0, Q: sp.sqrt(-2 * K * held / slope)}
domain = {theta: (tm / 10, sp.Rational(9, 10) * tm)}
units = {theta: "rad", p: "kg m2/s", Q: "C"}
