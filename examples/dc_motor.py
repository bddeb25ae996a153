"""Lossless DC motor that turns a pendulum load; the voltage acts on the flux, not on the angle.

One integrator has no Casimir at all. A resonator, a controller with two states, makes
φ + kθ visible: any angle can be held.
Source: van der Schaft, Jeltsema, Port-Hamiltonian Systems Theory: An Introductory Overview (2014).
Try: necc-design dc_motor.py --target theta=pi/4
"""

import sympy as sp

phi, p, theta = sp.symbols("phi p theta", real=True)  # flux, angular momentum, angle
k = 1  # torque per current

name = "Lossless DC motor"
x = (phi, p, theta)
J = sp.Matrix([[0, -k, 0], [k, 0, -1], [0, 1, 0]])
R = sp.zeros(3, 3)
G = sp.Matrix([1, 0, 0])
H = phi**2 / 2 + p**2 / 2 + 1 - sp.cos(theta)

units = {phi: "Wb", p: "kg m²/s", theta: "rad"}
target = {phi: sp.sin(sp.pi / 4), p: 0, theta: sp.pi / 4}

xi = sp.symbols("xi1 xi2", real=True)
Jc = sp.Matrix([[0, -1], [1, 0]])
Rc = sp.zeros(2, 2)
Gc = sp.Matrix([0, 1])
