"""Cubli on one edge: a cube face with a momentum wheel, no friction.

Source: Gajamohan, Merz, Thommen, D'Andrea, The Cubli: A Cube That Can Jump Up and Balance, IROS
2012.
"""

import sympy as sp

th, ph = sp.symbols("theta phi", real=True)
mb, mw, lb, lw = (sp.Rational(s) for s in ("0.419", "0.204", "0.075", "0.085"))
Ib, Iw, g = sp.Rational("3.34e-3"), sp.Rational("0.57e-3"), sp.Rational("9.81")
name = "Cubli"
q = (th, ph)
M = sp.Matrix([[Ib + mw * lw**2 + Iw, Iw], [Iw, Iw]])
V = (mb * lb + mw * lw) * g * sp.cos(th)
B = sp.Matrix([0, 1])
units = {th: "rad", ph: "rad"}
target = {th: 0, ph: 0}
