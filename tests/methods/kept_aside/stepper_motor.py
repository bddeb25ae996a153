"""PM stepper of two phases, 50 teeth.

Held between two full steps against a load torque through both windings.

Model: Zribi, Chiasson, Position control of a PM stepper motor by exact linearization, IEEE TAC 36
(1991); numbers typical of NEMA 17.
"""

import sympy as sp

a, b, th, p = sp.symbols("psi_a psi_b theta p", real=True)
r, L, Km, N = sp.Rational("2.4"), sp.Rational("4e-3"), sp.Rational("0.3"), 50
inertia, B0, load = sp.Rational("5.4e-6"), sp.Rational("1e-4"), sp.Rational("0.05")
name = "PM stepper"
x = (a, b, th, p)
S, C = Km * sp.sin(N * th), Km * sp.cos(N * th)
J = sp.Matrix([[0, 0, 0, S], [0, 0, 0, -C], [0, 0, 0, 1], [-S, C, -1, 0]])
R = sp.diag(r, r, 0, B0)
G = sp.Matrix([[1, 0], [0, 1], [0, 0], [0, 0]])
H = (a**2 + b**2) / (2 * L) + p**2 / (2 * inertia) + load * th
# currents i_a = 1 A (holds), i_q = load/Km with angle 0 -> torque C i_b - S i_a = load
target = {a: L * 1, b: L * load / Km, th: 0, p: 0}
domain = {th: (-sp.pi / 200, sp.pi / 200)}
units = {a: "Wb", b: "Wb", th: "rad", p: "kg m2/s"}
u_limits = [(-24, 24)] * 2
