"""Desktop servo whose voltage holds a rod 60° from hanging: winding resistance, friction and load.

The winding dissipates as long as the rod is held, so the loop has no Casimir and refuses the
target. Power shaping holds it; its function γ weighs flux and angle by the resistance.
Source: Quanser, QUBE-Servo 2 user manual, for motor (8.4 Ω, 1.16 mH, 0.042 N m/A, rotor 4 mg m²)
and rod (24 g, 129 mm).
Try: necc-design servo_pendulum.py --target theta=pi/3
"""

import sympy as sp

phi, theta, p = sp.symbols("phi theta p", real=True)  # flux, angle from hanging, angular momentum
resistance, coil, k = sp.symbols("resistance coil k", positive=True)
mass, length, friction = sp.symbols("mass length friction", positive=True)
g = sp.Rational("9.81")
inertia = sp.Rational("4.6e-6") + mass * length**2 / 3  # kg m², rotor with hub, and rod
moment = mass * g * length / 2  # N m

name = "Servo with pendulum load"
params = {
    resistance: sp.Rational("8.4"),  # Ω
    coil: sp.Rational("1.16e-3"),  # H
    k: sp.Rational("0.042"),  # N m/A
    mass: sp.Rational("0.024"),  # kg
    length: sp.Rational("0.129"),  # m
    friction: sp.Rational("2e-5"),  # N m s, of the bearings
}
x = (phi, theta, p)
J = sp.Matrix([[0, 0, -k], [0, 0, 1], [k, -1, 0]])
R = sp.diag(resistance, 0, friction)
G = sp.Matrix([1, 0, 0])
H = phi**2 / (2 * coil) + p**2 / (2 * inertia) + moment * (1 - sp.cos(theta))

units = {phi: "Wb", theta: "rad", p: "kg m²/s"}
held = sp.pi / 3
target = {phi: coil * moment * sp.sin(held) / k, theta: held, p: 0}
u_limits = [(-15, 15)]  # V
