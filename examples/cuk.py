"""Ćuk converter, −18 V from 12 V: two coils, and a capacitor that the switch hands back and forth.

Source: Ortega, Loría, Nicklasson, Sira-Ramírez, Passivity-based Control of Euler-Lagrange Systems
(1998), chapter 7, for the averaged model, with numbers typical of a converter of 30 W.
Try: necc-design cuk.py
"""

import sympy as sp

phi1, q2, phi3, q4, d = sp.symbols("phi1 q2 phi3 q4 d", real=True)  # d: duty ratio
coils = sp.symbols("coil1 coil2", positive=True)
transfer, output, load, supply = sp.symbols("transfer output load supply", positive=True)

name = "Ćuk converter"
params = {
    coils[0]: sp.Rational("200e-6"),  # H
    coils[1]: sp.Rational("200e-6"),
    transfer: sp.Rational("47e-6"),  # F
    output: sp.Rational("220e-6"),
    load: 10,  # Ω
    supply: 12,  # V
}
x, u = (phi1, q2, phi3, q4), (d,)
J = sp.Matrix([[0, d - 1, 0, 0], [1 - d, 0, d, 0], [0, -d, 0, -1], [0, 0, 1, 0]])
R = sp.diag(0, 0, 0, 1 / load)
E = sp.Matrix([supply, 0, 0, 0])
H = phi1**2 / (2 * coils[0]) + q2**2 / (2 * transfer)
H += phi3**2 / (2 * coils[1]) + q4**2 / (2 * output)

units = {phi1: "Wb", q2: "C", phi3: "Wb", q4: "C"}
volts = -18
amps = volts / load
target = {
    phi1: coils[0] * volts * amps / supply,
    q2: transfer * (supply - volts),
    phi3: coils[1] * amps,
    q4: output * volts,
}
u_limits = [(0, 1)]
