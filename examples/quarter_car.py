"""Quarter of a car with a force between body and wheel: raise the body by 20 mm.

The force acts on both masses, so that only the deflection of the suspension can be shaped; tyre and
spring carry the rest.
Source: Rajamani, Vehicle Dynamics and Control (2012), chapter 10, active suspensions, with numbers
typical of a passenger car.
Try: necc-design quarter_car.py --target z_b=0.02,z_w=0
"""

import sympy as sp

# heights of body and wheel above rest, their momenta
z_b, z_w, p_b, p_w = sp.symbols("z_b z_w p_b p_w", real=True)
body, wheel = 300, 40  # kg
spring, tyre, damper = 16000, 190000, 1000  # N/m, N/m, N s/m

name = "Quarter car"
x = (z_b, z_w, p_b, p_w)
J = sp.Matrix([[0, 0, 1, 0], [0, 0, 0, 1], [-1, 0, 0, 0], [0, -1, 0, 0]])
R = sp.diag(sp.zeros(2, 2), damper * sp.Matrix([[1, -1], [-1, 1]]))
G = sp.Matrix([0, 0, 1, -1])
H = p_b**2 / (2 * body) + p_w**2 / (2 * wheel)
H += spring * (z_b - z_w) ** 2 / 2 + tyre * z_w**2 / 2

units = {z_b: "m", z_w: "m", p_b: "kg m/s", p_w: "kg m/s"}
target = {z_b: sp.Rational("0.02"), z_w: 0, p_b: 0, p_w: 0}
