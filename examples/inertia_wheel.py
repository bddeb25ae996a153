"""Pendulum with a flywheel at its end; the motor acts between pendulum and wheel.

θ is the angle of the pendulum from upright, φ that of the wheel, both against the frame.
Source: Block, Åström, Spong, The Reaction Wheel Pendulum, Morgan & Claypool (2007), for the model
and its parameters.
Try: necc-design inertia_wheel.py --target 0
"""

import sympy as sp

theta, phi, p_theta, p_phi = sp.symbols("theta phi p_theta p_phi", real=True)
m_rod, m_wheel, l_rod, l_wheel = sp.symbols("m_rod m_wheel l_rod l_wheel", positive=True)
rod, wheel = sp.symbols("I_rod I_wheel", positive=True)
g = sp.Rational("9.81")
body = rod + m_rod * l_rod**2 + m_wheel * l_wheel**2
moment = (m_rod * l_rod + m_wheel * l_wheel) * g  # N m

name = "Inertia wheel pendulum"
params = {
    m_rod: sp.Rational("0.2164"),  # kg
    m_wheel: sp.Rational("0.085"),
    l_rod: sp.Rational("0.1173"),  # m, from the pivot
    l_wheel: sp.Rational("0.127"),
    rod: sp.Rational("2.233e-4"),  # kg m²
    wheel: sp.Rational("2.495e-5"),
}
x = (theta, phi, p_theta, p_phi)
J = sp.Matrix([[0, 0, 1, 0], [0, 0, 0, 1], [-1, 0, 0, 0], [0, -1, 0, 0]])
R = sp.zeros(4, 4)
G = sp.Matrix([0, 0, -1, 1])
H = p_theta**2 / (2 * body) + p_phi**2 / (2 * wheel) + moment * (1 + sp.cos(theta))

units = {theta: "rad", phi: "rad", p_theta: "kg m²/s", p_phi: "kg m²/s"}
target = {theta: 0, phi: 0, p_theta: 0, p_phi: 0}
