"""Two-stage LC filter behind a bridge.

Losses in coils and load (typical audio output stage, 20 V).
"""

import sympy as sp

q1, q2, f1, f2 = sp.symbols("q1 q2 phi1 phi2", real=True)
L1, L2, C1, C2 = (sp.Rational(s) for s in ("15e-6", "4.7e-6", "1e-6", "680e-9"))
r1, r2, load = sp.Rational("0.04"), sp.Rational("0.02"), 8
name = "Two-stage filter"
x = (q1, q2, f1, f2)
J = sp.Matrix([[0, 0, 1, -1], [0, 0, 0, 1], [-1, 0, 0, 0], [1, -1, 0, 0]])
R = sp.diag(0, sp.Rational(1, load), r1, r2)
G = sp.Matrix([0, 0, 1, 0])
H = q1**2 / (2 * C1) + q2**2 / (2 * C2) + f1**2 / (2 * L1) + f2**2 / (2 * L2)
i = sp.Rational(20, load)
target = {q2: 20 * C2, f2: L2 * i, f1: L1 * i, q1: C1 * (20 + r2 * i)}
units = {q1: "C", q2: "C", f1: "Wb", f2: "Wb"}
u_limits = [(-40, 40)]
