"""Four tanks, two pumps, and outflows that go with the root of the level: hold the lower levels.

Flows are ∇H, so that J and R are constant: H sums the integrals of the outflows over the levels.
Source: Johansson, The Quadruple-Tank Process, IEEE Transactions on Control Systems Technology 8
(2000), operating point P₋.
Try: necc-design quadruple_tank.py
"""

import sympy as sp

x = h = sp.symbols("h1:5", positive=True)  # levels, m
area = [sp.Rational(a, 10**7) for a in (28000, 32000, 28000, 32000)]  # m²
hole = [sp.Rational(a, 10**7) for a in (71, 57, 71, 57)]  # m²
gain = sp.Rational("3.33e-6"), sp.Rational("3.35e-6")  # m³/(s V)
split = sp.Rational("0.7"), sp.Rational("0.6")  # of each pump, to the lower tank
g = sp.Rational("9.81")

name = "Quadruple tank"
share = sp.diag(*(1 / a for a in area))
F = share * sp.Matrix([[-1, 0, 1, 0], [0, -1, 0, 1], [0, 0, -1, 0], [0, 0, 0, -1]])
J, R = (F - F.T) / 2, -(F + F.T) / 2
G = share * sp.Matrix(
    [
        [split[0] * gain[0], 0],
        [0, split[1] * gain[1]],
        [0, (1 - split[1]) * gain[1]],
        [(1 - split[0]) * gain[0], 0],
    ]
)
H = sum(
    sp.Rational(2, 3) * a * sp.sqrt(2 * g) * s ** sp.Rational(3, 2)
    for a, s in zip(hole, h, strict=True)
)

units = dict.fromkeys(h, "m")
volts = 3, 3  # of the pumps at the target
upper = (1 - split[1]) * gain[1] * volts[1], (1 - split[0]) * gain[0] * volts[0]
flows = [split[k] * gain[k] * volts[k] + upper[k] for k in (0, 1)] + list(upper)
target = {s: (flow / a) ** 2 / (2 * g) for s, flow, a in zip(h, flows, hole, strict=True)}
domain = dict.fromkeys(h, (sp.Rational("0.002"), sp.Rational("0.2")))
u_limits = [(0, 10), (0, 10)]  # V
