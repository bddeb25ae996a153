"""Inverting buck-boost converter, −18 V from 12 V; the duty ratio also switches the supply.

Source: Ortega, Loría, Nicklasson, Sira-Ramírez, Passivity-based Control of Euler-Lagrange Systems
(1998), chapter 7, for the averaged model, with numbers typical of a converter of 30 W.
Try: necc-design buck_boost.py
"""

import sympy as sp

phi, q, d = sp.symbols("phi q d", real=True)  # flux, charge, duty ratio
coil, capacitor, load, supply = sp.symbols("coil capacitor load supply", positive=True)

name = "Buck-boost converter"
params = {
    coil: sp.Rational("100e-6"),  # H
    capacitor: sp.Rational("220e-6"),  # F
    load: 10,  # Ω
    supply: 12,  # V
}
x, u = (phi, q), (d,)
J = sp.Matrix([[0, 1 - d], [d - 1, 0]])
R = sp.diag(0, 1 / load)
G = sp.Matrix([supply, 0])
H = phi**2 / (2 * coil) + q**2 / (2 * capacitor)

units = {phi: "Wb", q: "C"}
volts = -18
duty = volts / (volts - supply)
target = {phi: -coil * volts / (load * (1 - duty)), q: capacitor * volts}
u_limits = [(0, 1)]
