"""Ball balanced on top of a wheel that a motor turns; rolls without slip.

Source of the model: Ho, Tu, Lin, Controlling a ball and wheel system using full-state-feedback
linearization, IEEE CSM 29 (2009); numbers typical.
"""

import sympy as sp

w, b = sp.symbols("theta_w theta_b", real=True)
Rw, rb, m, g = sp.Rational("0.15"), sp.Rational("0.02"), sp.Rational("0.06"), sp.Rational("9.81")
Iw, Ib = sp.Rational("0.02"), sp.Rational(2, 5) * m * rb**2
name = "Ball on a wheel"
q = (w, b)
k = Ib / rb**2
M = sp.Matrix(
    [[Iw + k * Rw**2, -k * Rw * (Rw + rb)], [-k * Rw * (Rw + rb), (m + k) * (Rw + rb) ** 2]]
)
V = m * g * (Rw + rb) * sp.cos(b)
B = sp.Matrix([1, 0])
units = {w: "rad", b: "rad"}
target = {w: 0, b: 0}
