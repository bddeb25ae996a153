"""Boost converter from 12 V to 24 V; the duty ratio of its switch stands in J.

Source: Ortega, Loría, Nicklasson, Sira-Ramírez, Passivity-based Control of Euler-Lagrange Systems
(1998), chapter 7, for the averaged model, with numbers typical of a converter of 60 W.
Try: necc-design boost.py
"""

import sympy as sp

phi, q, d = sp.symbols("phi q d", real=True)  # flux, charge, duty ratio
coil, capacitor, load, supply = sp.symbols("coil capacitor load supply", positive=True)

name = "Boost converter"
params = {
    coil: sp.Rational("100e-6"),  # H
    capacitor: sp.Rational("220e-6"),  # F
    load: 10,  # Ω
    supply: 12,  # V
}
x, u = (phi, q), (d,)
J = sp.Matrix([[0, d - 1], [1 - d, 0]])
R = sp.diag(0, 1 / load)
E = sp.Matrix([supply, 0])
H = phi**2 / (2 * coil) + q**2 / (2 * capacitor)

units = {phi: "Wb", q: "C"}
volts = 24
target = {phi: coil * volts**2 / (load * supply), q: capacitor * volts}
u_limits = [(0, 1)]
