"""Derivatives term by term are sympy's; values at a point touch only what depends on it."""

import sympy as sp
from hypothesis import given, settings
from hypothesis import strategies as st

from necc_casadi.symbolic.derivatives import at, gradient, sparse_hessian, value_at

x, y, z = sp.symbols("x y z", real=True)
parts = st.sampled_from([x**2 * y, sp.sin(x * z), sp.exp(y), x * sp.cos(y), sp.Integer(3), z**3])


@given(st.lists(parts, max_size=4))
@settings(max_examples=30, deadline=None)
def test_gradient_and_hessian_are_sympys(terms):
    f = sp.Add(*terms)
    assert gradient(f, (x, y, z)) == sp.Matrix([sp.diff(f, s) for s in (x, y, z)])
    assert (sparse_hessian(f, (x, y, z)) - sp.hessian(f, (x, y, z))).expand().is_zero_matrix


def test_values_at_a_point():
    assert value_at(x * y, {x: 2}) == 2 * y
    assert value_at(y, {x: sp.zoo}) is y
    matrix = sp.Matrix([[x, 0], [y, x + y]])
    assert at(matrix, {x: sp.Rational(1, 3)}) == matrix.subs(x, sp.Rational(1, 3))
