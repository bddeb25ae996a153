"""Iron ball below a magnet that a voltage drives through the coil's resistance.

The coil's current is a state here; in maglev.py a fast inner loop sets it.
Source: Quanser, Magnetic Levitation Plant (MAGLEV) user manual: ball 68 g, coil with sense resistor
11 Ω and 412.5 mH, force constant 6.53·10⁻⁵ N m²/A², ball 6 mm below the core.
Try: necc-design maglev_voltage.py --target q=0.006
"""

import sympy as sp

flux, q, p = sp.symbols("lambda q p", real=True)  # linked flux, air gap (downwards), momentum
mass, g = sp.Rational("0.068"), sp.Rational("9.81")
resistance, coil, force = 11, sp.Rational("0.4125"), sp.Rational("6.5308e-5")
inductance = coil + force / q

name = "Voltage-fed magnetic levitation"
x = (flux, q, p)
J = sp.Matrix([[0, 0, 0], [0, 0, 1], [0, -1, 0]])
R = sp.diag(resistance, 0, 0)
G = sp.Matrix([1, 0, 0])
H = flux**2 / (2 * inductance) + p**2 / (2 * mass) - mass * g * q

units = {flux: "Wb", q: "m", p: "kg m/s"}
held = sp.Rational("0.006")
current = held * sp.sqrt(2 * mass * g / force)
target = {flux: (coil + force / held) * current, q: held, p: 0}
domain = {q: (sp.Rational("0.002"), sp.Rational("0.014"))}
u_limits = [(-24, 24)]  # V
