"""Series RLC circuit with a voltage source: hold a charge on the capacitor.

The resistor sees no current at rest, and the charge is not where it dissipates: this works.
Source: Ortega, van der Schaft, Mareels, Maschke, Putting Energy Back in Control, IEEE Control
Systems Magazine 21 (2001).
Try: necc-design series_rlc.py --target q=1
"""

import sympy as sp

q, phi = sp.symbols("q phi", real=True)  # charge of the capacitor, flux of the coil

name = "Series RLC"
x = (q, phi)
J = sp.Matrix([[0, 1], [-1, 0]])
R = sp.diag(0, sp.Rational(1, 2))
G = sp.Matrix([0, 1])
H = q**2 / 2 + phi**2 / 2

units = {q: "C", phi: "Wb"}
target = {q: 1, phi: 0}
