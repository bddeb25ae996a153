"""Pelican, a direct-drive arm of two links in a vertical plane, from its inertia and potential.

Source: Kelly, Santibáñez, Loría, Control of Robot Manipulators in Joint Space (2005), chapter 5,
for the equations and the numbers of the prototype.
Try: necc-design pelican_arm.py --target q1=pi/4,q2=pi/3
"""

import sympy as sp

q1, q2, g = sp.symbols("q1 q2 g")  # q1 from hanging, q2 from the first link
m1, m2, I1, I2 = sp.symbols("m1 m2 I1 I2")
length, c1, c2 = sp.Rational("0.26"), sp.Rational("0.0983"), sp.Rational("0.0229")  # m
params = {m1: 6.5225, m2: 2.0458, I1: 0.1213, I2: 0.0116, g: 9.81}  # kg, kg m², m/s²

q = (q1, q2)
fore = m2 * c2**2 + I2
both = m2 * length * c2 * sp.cos(q2)
upper = m1 * c1**2 + m2 * length**2 + I1 + fore + 2 * both
M = sp.Matrix([[upper, fore + both], [fore + both, fore]])
V = g * (m1 * c1 + m2 * length) * (1 - sp.cos(q1)) + g * m2 * c2 * (1 - sp.cos(q1 + q2))
B = sp.eye(2)

name = "Pelican arm"
inputs = ("tau1", "tau2")
units = {q1: "rad", q2: "rad", "tau1": "N m", "tau2": "N m"}
domain = {q1: (-3, 3), q2: (-3, 3)}
target = {q1: sp.pi / 4, q2: sp.pi / 3}
