"""Vertical axis of a machine tool: a head of 40 kg on a ball screw, held and moved by a servo.

The torque of the motor is the input, the way of the head the coordinate: a rotor of J kg m² behind
a screw of pitch h moves like a mass of J (2π/h)², and a torque pushes with 2π/h times itself.
Source: Altintas, Manufacturing Automation (2012), chapter 5, for the equations; numbers typical of
an axis with a screw of 10 mm.
Try: necc-design ball_screw.py --target z=0.2
"""

import sympy as sp

z = sp.Symbol("z")  # way up, m
head, rotor, lead, viscous, g = sp.symbols("head rotor lead viscous g")
params = {head: 40, rotor: 1.5e-3, lead: 0.01, viscous: 4e-3, g: 9.81}  # kg, kg m², m, N m s

q = z
turn = 2 * sp.pi / lead  # rad/m
M = head + rotor * turn**2
V = head * g * z
B = turn
friction = viscous * turn**2

name = "Ball screw"
inputs = ("torque",)
units = {z: "m", "torque": "N m"}
u_limits = [(-7, 7)]
domain = {z: (-0.1, 0.5)}
target = {z: 0.2}
