"""Balancing robot on two wheels.

The motors act between body and wheels (typical numbers of a small robot).
"""

import sympy as sp

s, th = sp.symbols("s theta", real=True)
body, wheels, height, r, g = (
    sp.Rational("1.0"),
    sp.Rational("0.1"),
    sp.Rational("0.1"),
    sp.Rational("0.04"),
    sp.Rational("9.81"),
)
Ib, Iw = sp.Rational("4e-3"), sp.Rational("8e-5")
name = "Balancing robot"
q = (s, th)
M = sp.Matrix(
    [
        [body + wheels + Iw / r**2, body * height * sp.cos(th)],
        [body * height * sp.cos(th), Ib + body * height**2],
    ]
)
V = body * g * height * sp.cos(th)
B = sp.Matrix([1 / r, -1])
units = {s: "m", th: "rad"}
target = {s: 0, th: 0}
