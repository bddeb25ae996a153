"""Electrostatic comb drive: a proof mass of 2 µg on folded beams, moved by 2 µm.

The comb's force ½ C′ v² does not depend on the position; the input is the squared voltage.
Source: Senturia, Microsystem Design (2001), comb-drive actuators, with numbers typical of a
surface-micromachined device.
Try: necc-design mems_comb.py --target q=2e-6
"""

import sympy as sp

q, p = sp.symbols("q p", real=True)  # position, momentum
mass = sp.Rational("2e-9")  # kg
stiffness = 1  # N/m
film = sp.Rational("1e-6")  # N s/m, squeezed air
slope = sp.Rational("5e-8")  # F/m, C′ of all fingers

name = "MEMS comb drive"
x = (q, p)
J = sp.Matrix([[0, 1], [-1, 0]])
R = sp.diag(0, film)
G = sp.Matrix([0, slope / 2])
H = p**2 / (2 * mass) + stiffness * q**2 / 2

units = {q: "m", p: "kg m/s"}
target = {q: sp.Rational("2e-6"), p: 0}
