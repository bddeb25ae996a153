"""Balls over wide boxes: enclosures, and sharp ones."""

import mpmath
import pytest
import sympy as sp
from flint import arb
from hypothesis import given, settings
from hypothesis import strategies as st

from necc_casadi.certificate.checker.arithmetic.balls import ball, evaluate, times


@settings(max_examples=200, deadline=None)
@given(st.floats(-50, 50), st.floats(0, 4), st.floats(0, 1))
def test_waves_of_wide_balls_enclose_high_precision_values(lo, width, share):
    x = sp.Symbol("x")
    inside = min(lo + share * width, lo + width)
    for f, exact in ((sp.sin, mpmath.sin), (sp.cos, mpmath.cos)):
        image = evaluate(f(x), {x: ball(lo, lo + width)})
        with mpmath.workdps(40):
            assert image.overlaps(arb(mpmath.nstr(exact(mpmath.mpf(inside)), 30)))
        assert image.rad() <= 1 + 1e-6


@settings(max_examples=150, deadline=None)
@given(st.floats(-3, 3), st.floats(0, 1.5), st.floats(-3, 3), st.floats(0, 1.5), st.floats(0, 1))
def test_products_of_wide_balls_are_exact_but_for_rounding(a, wa, b, wb, share):
    product = times(ball(a, a + wa), ball(b, b + wb))
    ends = [x * y for x in (a, a + wa) for y in (b, b + wb)]
    assert float(product.lower()) == pytest.approx(min(ends), abs=1e-5)
    assert float(product.upper()) == pytest.approx(max(ends), abs=1e-5)
    inside = (a + share * wa) * (b + share * wb)
    assert float(product.lower()) - 1e-12 <= inside <= float(product.upper()) + 1e-12
