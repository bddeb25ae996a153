"""Lossless chain of three masses between two walls, driven in the middle.

The outer masses can swing against each other while the middle one rests: no input ever sees that
motion, so every design is only stable, and the tool says so with this witness.
Source: van der Schaft, Jeltsema, Port-Hamiltonian Systems Theory: An Introductory Overview (2014).
Try: necc-design symmetric_chain.py --target q2=1
"""

import sympy as sp

q1, q2, q3, p1, p2, p3 = sp.symbols("q1:4 p1:4", real=True)  # displacements, momenta

name = "Symmetric chain"
x = (q1, q2, q3, p1, p2, p3)
J = sp.zeros(6, 6)
J[:3, 3:], J[3:, :3] = sp.eye(3), -sp.eye(3)
R = sp.zeros(6, 6)
G = sp.Matrix([0, 0, 0, 0, 1, 0])
H = (p1**2 + p2**2 + p3**2 + q1**2 + (q2 - q1) ** 2 + (q3 - q2) ** 2 + q3**2) / 2

units = {q1: "m", q2: "m", q3: "m", p1: "kg m/s", p2: "kg m/s", p3: "kg m/s"}
target = {q1: sp.Rational(1, 2), q2: 1, q3: sp.Rational(1, 2), p1: 0, p2: 0, p3: 0}
