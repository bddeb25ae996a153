"""Half bridge between a battery of 48 V and a bus of 100 V with a load of constant current.

Coil resistance, a bleeder on the bus, 10 A drawn: typical numbers of a 1 kW stage.
"""

import sympy as sp

phi, q, d = sp.symbols("phi q d", real=True)
L, C = sp.Rational("200e-6"), sp.Rational("1e-3")
r, bleed, drawn, battery, bus = sp.Rational("0.05"), 1000, 10, 48, 100
name = "Bidirectional half bridge"
x, u = (phi, q), (d,)
J = sp.Matrix([[0, d - 1], [1 - d, 0]])
R = sp.diag(r, sp.Rational(1, bleed))
E = sp.Matrix([battery, -drawn])
H = phi**2 / (2 * L) + q**2 / (2 * C)
power = bus * (drawn + sp.Rational(bus, bleed))
current = (battery - sp.sqrt(battery**2 - 4 * r * power)) / (2 * r)
target = {phi: L * current, q: C * bus}
units = {phi: "Wb", q: "C"}
u_limits = [(0, 1)]
