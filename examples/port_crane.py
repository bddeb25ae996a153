"""Trolley of a ship-to-shore crane, a container of 20 t on ropes of 15 m: travel 20 m, no swing.

The force of the trolley's drive is the input; the trolley's position is shaped and the swing
follows, damped through the coupling.
Source: Spong, Hutchinson, Vidyasagar, Robot Modeling and Control (2006), for the equations of a
cart with a pendulum; numbers typical of a container crane.
Try: necc-design port_crane.py --target s=20,theta=0
"""

import sympy as sp

s, theta, p_s, p_theta = sp.symbols("s theta p_s p_theta", real=True)
trolley, load, rope, g = 6000, 20000, 15, sp.Rational("9.81")  # kg, kg, m, m/s²

M11, M12, M22 = trolley + load, load * rope * sp.cos(theta), load * rope**2
det = load * rope**2 * (trolley + load * sp.sin(theta) ** 2)  # M11 M22 − M12²

name = "Port crane"
x = (s, theta, p_s, p_theta)
J = sp.Matrix([[0, 0, 1, 0], [0, 0, 0, 1], [-1, 0, 0, 0], [0, -1, 0, 0]])
R = sp.zeros(4, 4)
G = sp.Matrix([0, 0, 1, 0])
H = (M22 * p_s**2 - 2 * M12 * p_s * p_theta + M11 * p_theta**2) / (2 * det)
H += load * g * rope * (1 - sp.cos(theta))

units = {s: "m", theta: "rad", p_s: "kg m/s", p_theta: "kg m²/s"}
target = {s: 20, theta: 0, p_s: 0, p_theta: 0}
