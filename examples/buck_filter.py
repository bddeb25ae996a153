"""Output filter of a buck converter that runs without load: hold 12 V from a supply of 24 V.

The input is the averaged voltage of the bridge, duty times supply; charge and flux are the states.
A resistive load would dissipate at rest: see parallel_rlc.py for what is refused then.
Source: Erickson, Maksimović, Fundamentals of Power Electronics (2001), averaged models, with
numbers typical of 100 W.
Try: necc-design buck_filter.py
"""

import sympy as sp

q, phi = sp.symbols("q phi", real=True)  # charge of the capacitor, flux of the coil
L, C = sp.Rational("100e-6"), sp.Rational("470e-6")  # H, F
r = sp.Rational("0.05")  # Ω, of coil and switches

name = "Buck filter"
x = (q, phi)
J = sp.Matrix([[0, 1], [-1, 0]])
R = sp.diag(0, r)
G = sp.Matrix([0, 1])
H = q**2 / (2 * C) + phi**2 / (2 * L)

units = {q: "C", phi: "Wb"}
u_limits = [(0, 24)]
target = {q: 12 * C, phi: 0}
