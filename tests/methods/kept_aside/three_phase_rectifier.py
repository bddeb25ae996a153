"""Three-phase rectifier at 400 V, 50 Hz, in dq coordinates (power invariant), bus of 700 V.

Unity power factor.

Typical numbers of 10 kW: 5 mH and 0.1 Ohm per phase, 1.1 mF, load of 50 Ohm.
"""

import sympy as sp

phi_d, phi_q, q, m_d, m_q = sp.symbols("phi_d phi_q q m_d m_q", real=True)
L, C, r, load = sp.Rational("5e-3"), sp.Rational("1.1e-3"), sp.Rational("0.1"), 50
grid, bus, w = 400, 700, 100 * sp.pi
name = "Three-phase rectifier"
x, u = (phi_d, phi_q, q), (m_d, m_q)
J = sp.Matrix([[0, w * L, -m_d], [-w * L, 0, -m_q], [m_d, m_q, 0]])
R = sp.diag(r, r, sp.Rational(1, load))
E = sp.Matrix([grid, 0, 0])
H = (phi_d**2 + phi_q**2) / (2 * L) + q**2 / (2 * C)
current = (grid - sp.sqrt(grid**2 - 4 * r * sp.Rational(bus**2, load))) / (2 * r)
target = {phi_d: L * current, phi_q: 0, q: C * bus}
units = {phi_d: "Wb", phi_q: "Wb", q: "C"}
u_limits = [(-sp.Rational("0.7"), sp.Rational("0.7"))] * 2
