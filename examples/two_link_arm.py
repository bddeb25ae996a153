"""Planar arm of two uniform rods (1 kg, 1 m each) in the vertical plane, both joints driven.

Each joint has its Casimir qᵢ − ξᵢ. The momenta stay invisible, so the Hessian's least eigenvalue
cannot exceed 1/λ_max of the inertia matrix, about 0.43 at this target: a = 0.5 is out of reach.
Source: Murray, Li, Sastry, A Mathematical Introduction to Robotic Manipulation (1994), chapter 4.
Try: necc-design two_link_arm.py --target q1=pi/4,q2=-pi/3
"""

import sympy as sp

q1, q2, p1, p2 = sp.symbols("q1 q2 p1 p2", real=True)  # joint angles, conjugate momenta
g = sp.Rational("9.81")

a1, a2, b = sp.Rational(5, 3), sp.Rational(1, 3), sp.Rational(1, 2)  # inertia of the rods
M11, M12, M22 = a1 + 2 * b * sp.cos(q2), a2 + b * sp.cos(q2), a2
det = a1 * a2 - a2**2 - b**2 * sp.cos(q2) ** 2  # M11 M22 − M12²
kinetic = (M22 * p1**2 - 2 * M12 * p1 * p2 + M11 * p2**2) / (2 * det)
potential = g * (sp.Rational(3, 2) * (1 - sp.cos(q1)) + (1 - sp.cos(q1 + q2)) / 2)

name = "Two-link arm"
x = (q1, q2, p1, p2)
J = sp.Matrix([[0, 0, 1, 0], [0, 0, 0, 1], [-1, 0, 0, 0], [0, -1, 0, 0]])
R = sp.zeros(4, 4)
G = sp.Matrix([[0, 0], [0, 0], [1, 0], [0, 1]])
H = kinetic + potential

units = {q1: "rad", q2: "rad", p1: "kg m²/s", p2: "kg m²/s"}
target = {q1: sp.pi / 4, q2: -sp.pi / 3, p1: 0, p2: 0}
domain = {p1: (-4, 4), p2: (-2, 2)}  # joint rates up to about 2 rad/s
