"""Arm of 2 kg and 0.5 m, held upright through a soft harmonic drive with friction on both sides.

Typical numbers.
"""

import sympy as sp

q_link, t = sp.symbols("q theta", real=True)
m, a, g = 2, sp.Rational("0.25"), sp.Rational("9.81")
k = 4  # N m/rad, gravity's is 4.9
name = "Upright arm on a soft drive"
q = (q_link, t)
M = sp.diag(sp.Rational(4, 3) * m * a**2, sp.Rational("0.06"))
V = m * g * a * sp.cos(q_link) + k * (q_link - t) ** 2 / 2
B = sp.Matrix([0, 1])
friction = sp.diag(sp.Rational("0.02"), sp.Rational("0.5"))
units = {q_link: "rad", t: "rad"}
target = {q_link: 0, t: 0}
