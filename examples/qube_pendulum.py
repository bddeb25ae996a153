"""Pendulum of a desktop servo, 24 g and 129 mm, with the torque at its own axis, stood upright.

Source: Quanser, QUBE-Servo 2 user manual, for mass and length of the rod; the rod is uniform.
Try: necc-design qube_pendulum.py --target pi
"""

import sympy as sp

q, p = sp.symbols("q p", real=True)  # angle from hanging, angular momentum
mass, length, g = sp.Rational("0.024"), sp.Rational("0.129"), sp.Rational("9.81")
inertia = mass * length**2 / 3  # kg m², a rod at its end
moment = mass * g * length / 2  # N m

name = "QUBE-size pendulum"
x = (q, p)
J = sp.Matrix([[0, 1], [-1, 0]])
R = sp.diag(0, sp.Rational("5e-5"))  # N m s, of the bearing
G = sp.Matrix([0, 1])
H = p**2 / (2 * inertia) + moment * (1 - sp.cos(q))

units = {q: "rad", p: "kg m²/s"}
target = {q: sp.pi, p: 0}
