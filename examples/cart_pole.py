"""Pole on a cart; the force acts on the cart, θ is measured from upright.

The only Casimir is x − ξ1: the cart's position can be shaped, the pole's angle cannot. Hanging
(θ = π) with the cart anywhere works; upright (--target x=1,theta=0) is refused with a proof.
Source: Bloch, Leonard, Marsden, Controlled Lagrangians and the Stabilization of Mechanical
Systems I, IEEE Transactions on Automatic Control 45 (2000).
Try: necc-design cart_pole.py --target x=1,theta=pi
"""

import sympy as sp

s, theta, p_s, p_theta = sp.symbols("x theta p_x p_theta", real=True)
m_cart, m_pole, length, g = sp.symbols("m_cart m_pole length g", positive=True)

M11, M12, M22 = m_cart + m_pole, m_pole * length * sp.cos(theta), m_pole * length**2
det = m_pole * length**2 * (m_cart + m_pole * sp.sin(theta) ** 2)  # M11 M22 − M12²

name = "Cart-pole"
params = {m_cart: 1, m_pole: sp.Rational(1, 2), length: 1, g: sp.Rational("9.81")}
x = (s, theta, p_s, p_theta)
J = sp.Matrix([[0, 0, 1, 0], [0, 0, 0, 1], [-1, 0, 0, 0], [0, -1, 0, 0]])
R = sp.zeros(4, 4)
G = sp.Matrix([0, 0, 1, 0])
H = (M22 * p_s**2 - 2 * M12 * p_s * p_theta + M11 * p_theta**2) / (2 * det)
H += m_pole * g * length * (1 + sp.cos(theta))

units = {s: "m", theta: "rad", p_s: "kg m/s", p_theta: "kg m²/s"}
target = {s: 1, theta: sp.pi, p_s: 0, p_theta: 0}
