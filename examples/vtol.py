"""Aircraft with vectored thrust, hovering in a vertical plane; drag is left out.

F₁ is the sideways force at the nozzle, which also turns the craft, F₂ the thrust along its axis.
Source: Åström, Murray, Feedback Systems, Princeton (2008), example 2.9, for the ducted fan:
4 kg, 0.0475 kg m², nozzle at 0.25 m.
Try: necc-design vtol.py --target x=0,y=0
"""

import sympy as sp

s, h, theta, p_s, p_h, p_theta = sp.symbols("x y theta p_x p_y p_theta", real=True)
mass, inertia, arm = sp.symbols("mass inertia arm", positive=True)
g = sp.Rational("9.8")

name = "VTOL aircraft"
params = {mass: 4, inertia: sp.Rational("0.0475"), arm: sp.Rational("0.25")}  # kg, kg m², m
x = (s, h, theta, p_s, p_h, p_theta)
J = sp.Matrix(sp.BlockMatrix([[sp.zeros(3), sp.eye(3)], [-sp.eye(3), sp.zeros(3)]]))
R = sp.zeros(6, 6)
forces = [[sp.cos(theta), -sp.sin(theta)], [sp.sin(theta), sp.cos(theta)], [arm, 0]]
G = sp.Matrix([[0, 0], [0, 0], [0, 0], *forces])
H = (p_s**2 + p_h**2) / (2 * mass) + p_theta**2 / (2 * inertia) + mass * g * h

units = {s: "m", h: "m", theta: "rad", p_s: "kg m/s", p_h: "kg m/s", p_theta: "kg m²/s"}
target = {s: 0, h: 0, theta: 0, p_s: 0, p_h: 0, p_theta: 0}
