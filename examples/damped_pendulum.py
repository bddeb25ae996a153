"""Pendulum with torque input and bearing friction.

Friction acts on the momentum, the angle is what has to be shaped: no dissipation obstacle.
Source: van der Schaft, L2-Gain and Passivity Techniques in Nonlinear Control (2017), chapter 7.
Try: necc-design damped_pendulum.py --target pi/4
"""

import sympy as sp

q, p = sp.symbols("q p", real=True)  # angle, momentum

name = "Damped pendulum"
x = (q, p)
J = sp.Matrix([[0, 1], [-1, 0]])
R = sp.diag(0, sp.Rational(1, 5))
G = sp.Matrix([0, 1])
H = p**2 / 2 + 1 - sp.cos(q)

units = {q: "rad", p: "kg m²/s"}
target = {q: sp.pi / 4, p: 0}
