"""Iron ball below an electromagnet whose current is set by a fast inner loop.

The input is half the squared current, so G depends on the state: its Casimir is
ξ1 − k/(c + q), not linear, and found all the same.
Source: Ortega, van der Schaft, Mareels, Maschke, Putting Energy Back in Control, IEEE Control
Systems Magazine 21 (2001), with the current as the input.
Try: necc-design maglev.py --target q=0.1
"""

import sympy as sp

q, p = sp.symbols("q p", real=True)  # position below rest (downwards), momentum
m, g, k, c = sp.symbols("m g k c", positive=True)

name = "Magnetic levitation"
params = {
    m: sp.Rational(1, 10),
    g: sp.Rational("9.81"),
    k: sp.Rational(1, 20),
    c: sp.Rational(1, 2),
}
x = (q, p)
J = sp.Matrix([[0, 1], [-1, 0]])
R = sp.zeros(2, 2)
G = sp.Matrix([0, -k / (c + q) ** 2])
H = p**2 / (2 * m) - m * g * q

units = {q: "m", p: "kg m/s"}
target = {q: sp.Rational(1, 10), p: 0}
domain = {q: (sp.Rational(-3, 10), 1), "xi1": (sp.Rational(-1, 20), sp.Rational(1, 10))}
