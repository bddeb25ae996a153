"""Three coupled tanks that one pump feeds: water runs from the first to the second to the third.

Flows go with the root of the differences of the levels, and −∇H is what each tank gains.
Source: Amira, DTS200 Laboratory Setup Three-Tank-System, for the sizes: 154 cm², pipes of 0.5 cm²
with outflow coefficients about one half, tanks 0.62 m high, pump 0.1 l/s.
Try: necc-design three_tanks.py
"""

import sympy as sp

x = h = sp.symbols("h1:4", positive=True)  # levels, m
area, pipe = sp.Rational("0.0154"), sp.Rational("5e-5")  # m²
loss = [sp.Rational(c, 100) for c in (46, 48, 58)]  # outflow coefficients
g = sp.Rational("9.81")

name = "Three coupled tanks"
J = sp.zeros(3, 3)
R = sp.eye(3) / area
G = sp.Matrix([1 / area, 0, 0])
heads = h[0] - h[1], h[1] - h[2], h[2]
pull = sp.Rational(2, 3) * pipe * sp.sqrt(2 * g)
H = sum(c * pull * head ** sp.Rational(3, 2) for c, head in zip(loss, heads, strict=True))

units = dict.fromkeys(h, "m")
flow = sp.Rational("4e-5")  # m³/s at the target
held = [(flow / (c * pipe)) ** 2 / (2 * g) for c in loss]
target = {h[0]: sum(held), h[1]: held[1] + held[2], h[2]: held[2]}
domain = {
    h[0]: (sp.Rational("0.3"), sp.Rational("0.6")),
    h[1]: (sp.Rational("0.16"), sp.Rational("0.3")),
    h[2]: (sp.Rational("0.01"), sp.Rational("0.16")),
}
u_limits = [(0, sp.Rational("1e-4"))]  # m³/s
