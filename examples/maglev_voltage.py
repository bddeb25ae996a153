"""Iron ball below a magnet that a voltage drives through the coil's resistance.

The linked flux is a state here; in maglev.py a fast inner loop sets the current. Leakage is left
out: all flux crosses the gap, so the force depends on the flux alone.
Source: Ortega, van der Schaft, Mareels, Maschke, Putting Energy Back in Control, IEEE Control
Systems Magazine 21 (2001), for the model, with numbers typical of a small magnet: 500 turns of
4 Ω on 4 cm², a ball of 68 g 6 mm below it.
Try: necc-design maglev_voltage.py --target q=0.006
"""

import sympy as sp

flux, q, p = sp.symbols("phi q p", real=True)  # linked flux, air gap (downwards), momentum
mass, resistance, face, iron = sp.symbols("mass resistance face iron", positive=True)
turns, g = 500, sp.Rational("9.81")
k = sp.Rational("1.2566e-6") * turns**2 * face / 2  # H m
inductance = k / (q + iron)

name = "Voltage-fed magnetic levitation"
params = {
    mass: sp.Rational("0.068"),  # kg
    resistance: 4,  # Ω
    face: sp.Rational("4e-4"),  # m²
    iron: sp.Rational("1e-4"),  # m of gap
}
x = (flux, q, p)
J = sp.Matrix([[0, 0, 0], [0, 0, 1], [0, -1, 0]])
R = sp.diag(resistance, 0, 0)
G = sp.Matrix([1, 0, 0])
H = flux**2 / (2 * inductance) + p**2 / (2 * mass) - mass * g * q

units = {flux: "Wb", q: "m", p: "kg m/s"}
target = {flux: sp.sqrt(2 * k * mass * g), q: sp.Rational("0.006"), p: 0}
domain = {q: (sp.Rational("0.002"), sp.Rational("0.01"))}
u_limits = [(-24, 24)]  # V
