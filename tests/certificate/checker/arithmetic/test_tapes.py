"""Straight-line programs enclose what their expressions are."""

import sympy as sp
from flint import arb
from hypothesis import given, settings
from hypothesis import strategies as st

from necc_casadi.certificate.checker.arithmetic.balls import ball
from necc_casadi.certificate.checker.arithmetic.tapes import Tape


@settings(max_examples=60, deadline=None)
@given(st.lists(st.floats(-1.2, 1.2), min_size=2, max_size=2), st.floats(0, 0.2))
def test_tapes_enclose_what_the_expressions_are(point, width):
    x, y = sp.symbols("x y", real=True)
    expressions = [sp.sin(x) * sp.tan(y) + x**2 / sp.cos(y), sp.exp(x - y) * sp.Rational(1, 3), x]
    tape = Tape(expressions, [x, y])
    balls = [ball(v, v + width) for v in point]
    for image, expr in zip(tape(balls), expressions, strict=True):
        exact = sp.N(expr.subs({x: sp.Float(point[0], 40), y: sp.Float(point[1], 40)}), 30)
        assert image.overlaps(arb(str(exact)))
