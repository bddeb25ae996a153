"""Primitives: differentiated they give the function back; what is none is None."""

import pytest
import sympy as sp

from necc_casadi.symbolic.primitive import primitive
from necc_casadi.symbolic.zero import is_zero

s, a = sp.symbols("s a", real=True)


@pytest.mark.parametrize(
    "f",
    [
        sp.Integer(3), s**4 - s, 1 / (1 + s**2), 1 / (s + 3), (2 * s + 1) / (s**2 + s + 1) ** 2,
        sp.sin(s) * sp.cos(s), 1 / sp.cos(s), sp.exp(2 * s), a * sp.sin(3 * s), s * sp.exp(s),
    ],
)  # fmt: skip
def test_the_derivative_of_a_primitive_is_the_function(f):
    assert is_zero(sp.diff(primitive(f, s), s) - f) is True


@pytest.mark.parametrize("f", [sp.exp(s**2), s / sp.sin(s), sp.sqrt(s) * sp.exp(s)])
def test_what_has_no_elementary_primitive(f):
    assert primitive(f, s) is None
