"""SEPIC from a 12 V battery to 15 V at 1.5 A; averaged model.

Coil resistances left out (typical numbers).
"""

import sympy as sp

phi1, q1, phi2, q2, d = sp.symbols("phi1 q1 phi2 q2 d", real=True)
L1, L2, C1, C2 = (sp.Rational(s) for s in ("47e-6", "47e-6", "10e-6", "220e-6"))
load, supply, volts = 10, 12, 15
name = "SEPIC"
x, u = (phi1, q1, phi2, q2), (d,)
J = sp.Matrix(
    [
        [0, d - 1, 0, d - 1],
        [1 - d, 0, -d, 0],
        [0, d, 0, d - 1],
        [1 - d, 0, 1 - d, 0],
    ]
)
R = sp.diag(0, 0, 0, sp.Rational(1, load))
E = sp.Matrix([supply, 0, 0, 0])
H = phi1**2 / (2 * L1) + q1**2 / (2 * C1) + phi2**2 / (2 * L2) + q2**2 / (2 * C2)
out = sp.Rational(volts, load)
target = {phi1: L1 * out * volts / supply, q1: C1 * supply, phi2: L2 * out, q2: C2 * volts}
units = {phi1: "Wb", q1: "C", phi2: "Wb", q2: "C"}
u_limits = [(0, 1)]
