"""Involutive closure."""

import sympy as sp

from necc_casadi.casimirs.involution import closure, lie_bracket


def test_closure_contains_the_brackets():
    """Heisenberg: [∂x − y/2 ∂t, ∂y + x/2 ∂t] = ∂t makes the closure three-dimensional."""
    x, y, t = sp.symbols("x y t", real=True)
    f, g = (sp.Integer(1), sp.Integer(0), -y / 2), (sp.Integer(0), sp.Integer(1), x / 2)
    assert lie_bracket(f, g, (x, y, t)) == (0, 0, 1)
    fields, complete = closure(sp.Matrix([f, g]).T, (x, y, t), 3)
    assert (len(fields), complete) == (3, True)
