"""Exact constants in floating point."""

from fractions import Fraction

import numpy as np
import sympy as sp
from hypothesis import given
from hypothesis import strategies as st

from necc_casadi.symbolic.floats import float_matrix, to_float, to_floats


@given(st.fractions(max_denominator=10**12))
def test_a_fraction_is_rounded_once(value):
    assert to_float(sp.Rational(value.numerator, value.denominator)) == float(Fraction(value))


def test_vectors_and_matrices():
    assert to_floats([]).shape == (0,)
    np.testing.assert_array_equal(to_floats([sp.pi, sp.sqrt(2)]), [np.pi, np.sqrt(2)])
    matrix = sp.Matrix([[sp.pi, 0], [sp.zoo, sp.I]])
    np.testing.assert_array_equal(float_matrix(matrix), [[np.pi, 0], [np.nan, np.nan]])
