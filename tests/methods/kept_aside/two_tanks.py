"""Two tanks joined by a pipe, a pump fills the first, the second drains.

Levels (typical laboratory).
"""

import sympy as sp

h1, h2 = sp.symbols("h1 h2", positive=True)
A, a12, a2, g = (
    sp.Rational("0.0154"),
    sp.Rational("2.5e-5"),
    sp.Rational("3e-5"),
    sp.Rational("9.81"),
)
q12, q2 = a12 * sp.sqrt(2 * g * (h1 - h2)), a2 * sp.sqrt(2 * g * h2)
name = "Two coupled tanks"
x = (h1, h2)
f = sp.Matrix([-q12 / A, (q12 - q2) / A])
G = sp.Matrix([1 / A, 0])
level = sp.Rational("0.2")
target = {h2: level, h1: level * (1 + (a2 / a12) ** 2)}
domain = {
    h1: (sp.Rational("0.35"), sp.Rational("0.62")),
    h2: (sp.Rational("0.05"), sp.Rational("0.34")),
}
units = {h1: "m", h2: "m"}
u_limits = [(0, sp.Rational("1.5e-4"))]
