"""Three sections of a 48 V supply line, every coil and capacitor lossy, with a load at the far end.

Load and losses draw current for ever, so the loop has no Casimir and refuses the target. Power
shaping holds any voltage: J − R is regular, and γ is linear in all charges and fluxes.
Source: Ortega, Jeltsema, Scherpen, Power Shaping: A New Paradigm for Stabilization of Nonlinear RLC
Circuits, IEEE Transactions on Automatic Control 48 (2003), with numbers typical of a cable and
its filter capacitors.
Try: necc-design rlc_ladder.py
"""

import sympy as sp

q = sp.symbols("q1:4", real=True)  # charges of the capacitors, from the source on
phi = sp.symbols("phi1:4", real=True)  # fluxes of the coils before them
coil, winding = sp.Rational("0.5e-3"), sp.Rational("0.1")  # H, Ω
capacitor, leak, load = sp.Rational("200e-6"), 2000, 8  # F, Ω, Ω

name = "RLC ladder"
x = (*phi, *q)
ahead = sp.Matrix([[-1, 0, 0], [1, -1, 0], [0, 1, -1]])  # what each coil feels of each voltage
J = sp.Matrix(sp.BlockMatrix([[sp.zeros(3), ahead], [-ahead.T, sp.zeros(3)]]))
R = sp.diag(winding, winding, winding, 1 / sp.Rational(leak), 1 / sp.Rational(leak), 0)
R[5, 5] = 1 / sp.Rational(leak) + 1 / sp.Rational(load)
G = sp.Matrix([1, 0, 0, 0, 0, 0])
H = sum(f**2 for f in phi) / (2 * coil) + sum(c**2 for c in q) / (2 * capacitor)

units = dict.fromkeys(phi, "Wb") | dict.fromkeys(q, "C")
volts = [0, 0, sp.Integer(48)]  # at the load; the others follow from the currents
amps = [0, 0, volts[2] * R[5, 5]]
for k in (1, 0):
    volts[k] = volts[k + 1] + winding * amps[k + 1]
    amps[k] = amps[k + 1] + volts[k] / leak
target = {f: coil * i for f, i in zip(phi, amps, strict=True)}
target |= {c: capacitor * v for c, v in zip(q, volts, strict=True)}
