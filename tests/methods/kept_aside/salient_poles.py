"""Hydro generator with salient poles on a long line: the excitation holds 50 degrees.

Per unit (typical).
"""

import sympy as sp

delta, w, E_q = sp.symbols("delta omega E_q", real=True)
base = 100 * sp.pi
Hc, D, T = sp.Rational("4"), sp.Rational("0.05"), sp.Rational("5.2")
line, Xd, Xq, Xp = (sp.Rational(s) for s in ("0.4", "1.1", "0.7", "0.3"))
grid, power = 1, sp.Rational("0.8")
X, Xt, Xs = Xd + line, Xp + line, Xq + line
inertia, friction = 2 * Hc / base, D
name = "Salient-pole generator"
x = (delta, w, E_q)
J = sp.Matrix([[0, 1 / inertia, 0], [-1 / inertia, 0, 0], [0, 0, 0]])
R = sp.diag(0, friction / inertia**2, (X - Xt) / T)
G = sp.Matrix([0, 0, 1 / T])
H = inertia * w**2 / 2 - power * delta - grid * E_q * sp.cos(delta) / Xt
H += -sp.Rational(1, 4) * grid**2 * (1 / Xs - 1 / Xt) * sp.cos(2 * delta)
H += X * E_q**2 / (2 * Xt * (X - Xt))
held = 5 * sp.pi / 18
reluctance = grid**2 / sp.Integer(2) * (1 / Xs - 1 / Xt) * sp.sin(2 * held)
target = {delta: held, w: 0, E_q: (power - reluctance) * Xt / (grid * sp.sin(held))}
domain = {delta: (0, sp.pi / 2), w: (-4, 4), E_q: (sp.Rational("0.5"), 2)}
units = {delta: "rad", w: "rad/s", E_q: "p.u."}
