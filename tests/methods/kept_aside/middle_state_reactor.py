"""Stirred tank at its middle steady state; the jacket's temperature is the input.

Source: Bequette, Process Dynamics: Modeling, Analysis and Simulation, Prentice Hall (1998),
module on the CSTR.
"""

import sympy as sp

c, T = sp.symbols("C T", positive=True)
k0, Ea, gas = 9703 * 3600, 11843, sp.Rational("1.987")
rate = k0 * sp.exp(-Ea / (gas * T)) * c
name = "Stirred tank (Bequette)"
x = (c, T)
heat, cool = sp.Rational(5960, 500), sp.Rational(150, 500)
f = sp.Matrix([(10 - c) - rate, (298 - T) + heat * rate - cool * T])
G = sp.Matrix([0, cool])
held = 339
target = {T: held, c: 10 / (1 + k0 * sp.exp(-Ea / (gas * held)))}
units = {c: "kmol/m3", T: "K"}
domain = {c: (2, 9), T: (310, 370)}
u_limits = [(250, 350)]
