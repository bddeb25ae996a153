"""Rotor between two magnets, one axis, a voltage at each coil.

Typical numbers of a small active magnetic bearing.
"""

import sympy as sp

f1, f2, q, p = sp.symbols("phi1 phi2 q p", real=True)
m, r = sp.Rational("1.5"), sp.Rational("0.8")
gap, k = sp.Rational("0.5e-3"), sp.Rational("1.2566e-6") * 150**2 * sp.Rational("2e-4") / 2
bias = k / gap * 2  # flux of 2 A at the middle
name = "Magnetic bearing"
x = (f1, f2, q, p)
J = sp.zeros(4)
J[2, 3], J[3, 2] = 1, -1
R = sp.diag(r, r, 0, 0)
G = sp.Matrix([[1, 0], [0, 1], [0, 0], [0, 0]])
H = (f1**2 * (gap - q) + f2**2 * (gap + q)) / (2 * k) + p**2 / (2 * m)
target = {f1: bias, f2: bias, q: 0, p: 0}
units = {f1: "Wb", f2: "Wb", q: "m", p: "kg m/s"}
domain = {q: (-sp.Rational("0.4e-3"), sp.Rational("0.4e-3"))}
u_limits = [(-48, 48)] * 2
