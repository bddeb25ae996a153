"""Chain of N masses, springs and dampers, fixed at its right end; a force acts on the first mass.

One Casimir, q1 − ξ1, moves the whole chain: the springs carry the displacement on. Raise N to
see how the verdict scales.
Source: van der Schaft, Jeltsema, Port-Hamiltonian Systems Theory: An Introductory Overview (2014).
Try: necc-design mass_spring_chain.py --target q1=1
"""

import sympy as sp

N = 4
mass, spring, damper = sp.Integer(1), sp.Integer(1), sp.Rational(1, 5)
q = sp.symbols(f"q1:{N + 1}", real=True)  # displacements
p = sp.symbols(f"p1:{N + 1}", real=True)  # momenta

name = f"Chain of {N} masses"
x = (*q, *p)
J = sp.zeros(2 * N, 2 * N)
J[:N, N:], J[N:, :N] = sp.eye(N), -sp.eye(N)
R = sp.diag(sp.zeros(N, N), damper * sp.eye(N))
G = sp.Matrix([int(i == N) for i in range(2 * N)])
H = sum(v**2 for v in p) / (2 * mass) + spring * q[-1] ** 2 / 2
H += spring * sum((q[i + 1] - q[i]) ** 2 for i in range(N - 1)) / 2

units = {**dict.fromkeys(q, "m"), **dict.fromkeys(p, "kg m/s")}
target = {**{q[i]: sp.Rational(N - i, N) for i in range(N)}, **dict.fromkeys(p, 0)}
