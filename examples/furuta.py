"""Rotary pendulum: a motor turns an arm, and a pendulum swings across the arm's end.

φ is the angle of the arm, θ that of the pendulum from upright.
Source: Quanser, QUBE-Servo 2 user manual, for the rods (arm 95 g, 85 mm; pendulum 24 g, 129 mm);
Furuta, Yamakita, Kobayashi, Swing-up Control of Inverted Pendulum Using Pseudo-State Feedback,
Journal of Systems and Control Engineering 206 (1992), for the model; bearings without friction.
Try: necc-design furuta.py
"""

import sympy as sp

phi, theta, p_phi, p_theta = sp.symbols("phi theta p_phi p_theta", real=True)
arm, arm_length, rod, rod_length = sp.symbols("arm arm_length rod rod_length", positive=True)
g = sp.Rational("9.81")

swing = rod * rod_length**2 / 3  # kg m², a rod at its end
M11 = arm * arm_length**2 / 3 + rod * arm_length**2 + swing * sp.sin(theta) ** 2
M12 = rod * arm_length * rod_length / 2 * sp.cos(theta)
det = sp.expand(M11 * swing - M12**2)

name = "Furuta pendulum"
params = {
    arm: sp.Rational("0.095"),  # kg
    arm_length: sp.Rational("0.085"),  # m
    rod: sp.Rational("0.024"),
    rod_length: sp.Rational("0.129"),
}
x = (phi, theta, p_phi, p_theta)
J = sp.Matrix([[0, 0, 1, 0], [0, 0, 0, 1], [-1, 0, 0, 0], [0, -1, 0, 0]])
R = sp.zeros(4, 4)
G = sp.Matrix([0, 0, 1, 0])
H = (swing * p_phi**2 - 2 * M12 * p_phi * p_theta + M11 * p_theta**2) / (2 * det)
H += rod * g * rod_length / 2 * (1 + sp.cos(theta))

domain = {phi: (-3, 3), theta: (-1.2, 1.2)}
units = {phi: "rad", theta: "rad", p_phi: "kg m²/s", p_theta: "kg m²/s"}
target = {phi: 0, theta: 0, p_phi: 0, p_theta: 0}
