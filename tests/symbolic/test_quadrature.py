import numpy as np
import pytest
import sympy as sp
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad

from necc_casadi.symbolic.quadrature import quadrature

s = sp.Symbol("s", real=True)
c, d = sp.cos(s), sp.sin(s)
R = sp.Rational


@pytest.mark.parametrize(
    ("f", "at", "expected"),
    [
        (-d / (R(7, 25) - c), 0, -sp.log(25 * c - 7) + sp.log(18)),
        (d / c, sp.pi, -sp.log(-c)),
        (-d / c**3, 0, R(1, 2) - 1 / (2 * c**2)),
        (1 / sp.sqrt(s**2 + R(1, 100)), 0, sp.asinh(10 * s)),
        (s**2, 1, s**3 / 3 - R(1, 3)),
    ],
)
def test_known_primitives(f, at, expected):
    assert sp.simplify(quadrature(f, s, sp.sympify(at)) - expected) == 0


coefficients = st.integers(-5, 5)


@pytest.mark.slow
@given(
    coefficients, coefficients, coefficients, st.integers(6, 9), coefficients, st.integers(-2, 2)
)
@settings(max_examples=40, deadline=None)
def test_trigonometric_fractions_agree_with_numerical_integration(a, b, e, m, n, turns):
    """Their denominators have no zero, or one that lies outside."""
    f = (a + b * c + e * d) / (m + n * c)
    at = turns * sp.pi
    F = quadrature(f, s, at)
    assert F is not None
    value = sp.lambdify(s, F)
    for end in (0.9, -1.2):
        expected = quad(sp.lambdify(s, f), float(at), float(at) + end)[0]
        assert np.isclose(value(float(at) + end), expected, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("f", [1 / s, sp.exp(s**2), 1 / d, sp.log(c - 2)])
def test_a_pole_at_the_point_or_no_closed_form_gives_none(f):
    assert quadrature(f, s, sp.Integer(0)) is None
