"""Ball that rolls on a beam; the motor turns the beam, θ is its angle from the horizontal.

Every place of the ball is an equilibrium of the level beam, and none is held by shaping the
energy of the beam alone.
Source: Hauser, Sastry, Kokotović, Nonlinear Control via Approximate Input-Output Linearization:
the Ball and Beam Example, IEEE Transactions on Automatic Control 37 (1992), with its parameters.
Try: necc-design ball_and_beam.py --target 0
"""

import sympy as sp

r, theta, p_r, p_theta = sp.symbols("r theta p_r p_theta", real=True)
ball, radius, spin, beam = sp.symbols("ball radius I_ball I_beam", positive=True)
g = sp.Rational("9.81")

rolling = ball + spin / radius**2
turning = beam + spin + ball * r**2
name = "Ball and beam"
params = {
    ball: sp.Rational("0.05"),  # kg
    radius: sp.Rational("0.01"),  # m
    spin: sp.Rational("2e-6"),  # kg m²
    beam: sp.Rational("0.02"),
}
x = (r, theta, p_r, p_theta)
J = sp.Matrix([[0, 0, 1, 0], [0, 0, 0, 1], [-1, 0, 0, 0], [0, -1, 0, 0]])
R = sp.zeros(4, 4)
G = sp.Matrix([0, 0, 0, 1])
H = p_r**2 / (2 * rolling) + p_theta**2 / (2 * turning) + ball * g * r * sp.sin(theta)

units = {r: "m", theta: "rad", p_r: "kg m/s", p_theta: "kg m²/s"}
target = {r: 0, theta: 0, p_r: 0, p_theta: 0}
