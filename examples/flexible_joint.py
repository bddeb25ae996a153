"""Link held upright by a motor behind a spring softer than gravity, friction on both sides.

Source: Spong, Modeling and Control of Elastic Joint Robots, Journal of Dynamic Systems,
Measurement, and Control 109 (1987), with numbers typical of a small laboratory arm.
Try: necc-design flexible_joint.py --target q=0
"""

import sympy as sp

q, theta, p_q, p_t = sp.symbols("q theta p_q p_theta", real=True)  # link, motor; from upright
mass, rotor, spring = sp.symbols("mass rotor spring", positive=True)
bearing, gear = sp.symbols("bearing gear", positive=True)
reach, g = sp.Rational("0.3"), sp.Rational("9.81")  # m, m/s²
link = mass * reach**2

name = "Upright flexible joint"
params = {
    mass: sp.Rational("0.4"),  # kg
    rotor: sp.Rational("0.01"),  # kg m²
    spring: sp.Rational("0.8"),  # N m/rad, gravity's is 1.18
    bearing: sp.Rational("0.01"),  # N m s
    gear: sp.Rational("0.05"),
}
x = (q, theta, p_q, p_t)
J = sp.Matrix([[0, 0, 1, 0], [0, 0, 0, 1], [-1, 0, 0, 0], [0, -1, 0, 0]])
R = sp.diag(0, 0, bearing, gear)
G = sp.Matrix([0, 0, 0, 1])
H = p_q**2 / (2 * link) + p_t**2 / (2 * rotor) + spring * (q - theta) ** 2 / 2
H += mass * g * reach * (1 + sp.cos(q))

units = {q: "rad", theta: "rad", p_q: "kg m²/s", p_t: "kg m²/s"}
target = {q: 0, theta: 0, p_q: 0, p_t: 0}
