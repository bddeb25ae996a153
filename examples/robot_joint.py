"""Shoulder joint of a robot arm of 8 kg, held out against gravity by a geared motor of 80 N m.

Numbers are those of a data sheet: the inertia seen at the joint with the rotor behind its gear, the
moment of the weight, viscous friction and the limit of the torque.
Source: Spong, Hutchinson, Vidyasagar, Robot Modeling and Control (2006), chapter 6, with numbers
typical of a joint of that size.
Try: necc-design robot_joint.py --target q=0.6
"""

import sympy as sp

q, p = sp.symbols("q p", real=True)  # angle from hanging, angular momentum
inertia = sp.Rational("1.2")  # kg m², link and rotor times the gear ratio squared
moment = sp.Rational("31.4")  # N m, m g l of the link
friction = sp.Rational("2.5")  # N m s, viscous

name = "Robot joint"
x = (q, p)
J = sp.Matrix([[0, 1], [-1, 0]])
R = sp.diag(0, friction)
G = sp.Matrix([0, 1])
H = p**2 / (2 * inertia) + moment * (1 - sp.cos(q))

units = {q: "rad", p: "kg m²/s"}
u_limits = [(-80, 80)]
target = {q: sp.Rational("0.6"), p: 0}
