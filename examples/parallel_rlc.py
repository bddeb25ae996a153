"""Parallel RLC circuit: the resistor lies across the capacitor and never rests.

Holding a charge needs a current for ever. R[0,0] dissipates in the charge itself, the loop has
no Casimir, and the target is refused: the dissipation obstacle.
Source: Ortega, van der Schaft, Mareels, Maschke, Putting Energy Back in Control, IEEE Control
Systems Magazine 21 (2001).
Try: necc-design parallel_rlc.py --target q=1 --check
"""

import sympy as sp

q, phi = sp.symbols("q phi", real=True)  # charge of the capacitor, flux of the coil
r, C, L = sp.symbols("r C L", positive=True)

name = "Parallel RLC"
params = {r: 2, C: 1, L: 1}  # Ω, F, H
x = (q, phi)
J = sp.Matrix([[0, 1], [-1, 0]])
R = sp.diag(1 / r, 0)
G = sp.Matrix([0, 1])
H = q**2 / (2 * C) + phi**2 / (2 * L)

units = {q: "C", phi: "Wb"}
target = {q: 1, phi: sp.Rational(1, 2)}
