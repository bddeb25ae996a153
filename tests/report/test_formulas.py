"""Formulas for reading: the same values, shorter numbers."""

import sympy as sp
from hypothesis import given
from hypothesis import strategies as st

from necc_casadi.report.formulas import readable

a, b = sp.symbols("a b", real=True)
LONG = sp.Rational(855277969708988965530900693, 432551636572335595895)


def test_short_numbers_stay_exact():
    assert readable(24 * a / 5 + sp.sqrt(2) * b) == ("24*a/5 + sqrt(2)*b", False)


def test_numbers_of_many_digits_are_rounded_to_five():
    assert readable(LONG * sp.sin(a)) == ("1.9773e+6*sin(a)", True)
    assert readable(sp.Rational(47319000001, 1000000) * a)[0] == "47319*a"


def test_factors_are_gathered_before_the_terms():
    text, rounded = readable(LONG * a / (LONG * sp.cos(b) - 2 * LONG) ** 2)
    assert rounded
    assert text == "1.2644e-7*a/(1 - 0.50000*cos(b))**2"


long = st.fractions(max_denominator=10**12).map(sp.Rational)


@given(long, long, long, st.integers(-2, 3))
def test_values_agree_to_the_digits_that_are_shown(p, q, r, power):
    expr = p * a**2 + LONG * (q * sp.cos(b) + r * a + sp.sqrt(3)) ** power
    point = {a: sp.Rational(3, 7), b: sp.Rational(2, 5)}
    text, _ = readable(expr)
    shown = sp.sympify(text, locals={"a": a, "b": b})
    terms = [abs(float(t.subs(point))) for t in sp.Add.make_args(sp.expand(expr))]
    there = float((q * sp.cos(b) + r * a + sp.sqrt(3)).subs(point))
    if abs(there) > 0.1 * (abs(float(q)) + abs(float(r)) + 1):
        assert abs(float(shown.subs(point)) - float(expr.subs(point))) <= 1e-2 * sum(terms)
