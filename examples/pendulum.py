"""Pendulum with torque input, held away from its hanging position.

Source: van der Schaft, L2-Gain and Passivity Techniques in Nonlinear Control
(2017), Example 7.1.12; Xu, Zakwan, Ferrari-Trecate, eq. PendulumPlant.
Try: necc-design pendulum.py --target pi/4
"""

import sympy as sp

q, p = sp.symbols("q p", real=True)  # angle, momentum

name = "Pendulum"
x = (q, p)
J = sp.Matrix([[0, 1], [-1, 0]])
R = sp.zeros(2, 2)
G = sp.Matrix([0, 1])
H = p**2 / 2 + 1 - sp.cos(q)

units = {q: "rad", p: "kg m²/s"}
