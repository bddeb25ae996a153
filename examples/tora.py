"""TORA: a cart on a spring, damped by an eccentric rotor that a torque turns.

At θ = 0 the rotor's swing couples to the cart and asymptotic stability is within reach. At
θ = 90° (--target theta=pi/2) it does not: the cart oscillates and no torque feels it, so every
design is only stable.
Source: Wan, Bernstein, Coppola, Global Stabilization of the Oscillating Eccentric Rotor,
Nonlinear Dynamics 10 (1996).
Try: necc-design tora.py --target theta=0
"""

import sympy as sp

q, theta, p_q, p_theta = sp.symbols("q theta p_q p_theta", real=True)
total, coupling, inertia = 2, sp.Rational(1, 2), 1  # mass, m·e, rotor inertia; spring 1

M12 = coupling * sp.cos(theta)
det = total * inertia - M12**2

name = "TORA"
x = (q, theta, p_q, p_theta)
J = sp.Matrix([[0, 0, 1, 0], [0, 0, 0, 1], [-1, 0, 0, 0], [0, -1, 0, 0]])
R = sp.zeros(4, 4)
G = sp.Matrix([0, 0, 0, 1])
H = (inertia * p_q**2 - 2 * M12 * p_q * p_theta + total * p_theta**2) / (2 * det) + q**2 / 2

units = {q: "m", theta: "rad", p_q: "kg m/s", p_theta: "kg m²/s"}
target = {q: 0, theta: 0, p_q: 0, p_theta: 0}
