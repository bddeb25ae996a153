"""Double-acting cylinder that a servo valve feeds with a flow: hold 50 mm against a spring load.

The state w is the volume by which the oil is compressed, its pressure β w/V. With an integrator of
that pressure there is no Casimir; with a second controller state w + A q − ξ1 is one. Leakage would
dissipate at rest, which this structure does not allow: it is left out.
Source: Merritt, Hydraulic Control Systems (1967), chapter 6, valve and cylinder, with numbers
typical of a machine tool.
Try: necc-design hydraulic_cylinder.py
"""

import sympy as sp

q, p, w = sp.symbols("q p w", real=True)  # piston, momentum, compressed volume
mass, spring, viscous = 200, 200000, 500  # kg, N/m, N s/m
area = sp.Rational("2e-3")  # m²
bulk, volume = 1400000000, sp.Rational("1e-3")  # Pa, m³

name = "Hydraulic cylinder"
x = (q, p, w)
J = sp.Matrix([[0, 1, 0], [-1, 0, area], [0, -area, 0]])
R = sp.diag(0, viscous, 0)
G = sp.Matrix([0, 0, 1])
H = p**2 / (2 * mass) + spring * q**2 / 2 + bulk * w**2 / (2 * volume)

xi = sp.symbols("xi1:3", real=True)  # volume, and what drives it
Jc, Rc = sp.Matrix([[0, -1], [1, 0]]), sp.zeros(2, 2)
Gc = sp.Matrix([0, 1])

units = {q: "m", p: "kg m/s", w: "m³"}
held = sp.Rational("0.05")
target = {q: held, p: 0, w: spring * held * volume / (area * bulk)}
