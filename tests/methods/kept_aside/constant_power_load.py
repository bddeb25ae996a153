"""Buck stage, 48 V to 24 V.

That feeds a regulated load of constant power 50 W (typical numbers).
"""

import sympy as sp

i, v = sp.symbols("i v", positive=True)
L, C, r = sp.Rational("47e-6"), sp.Rational("470e-6"), sp.Rational("0.03")
power, volts = 50, 24
name = "Buck with constant-power load"
x = (i, v)
f = sp.Matrix([-(r * i + v) / L, (i - power / v) / C])
G = sp.Matrix([48 / L, 0])
target = {i: sp.Rational(power, volts), v: volts}
units = {i: "A", v: "V"}
domain = {i: (-5, 15), v: (12, 40)}
u_limits = [(0, 1)]
