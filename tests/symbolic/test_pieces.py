"""Boxes on which expressions are smooth, and what roots and arcs are there."""

import flint
import pytest
import sympy as sp
from hypothesis import given, settings
from hypothesis import strategies as st

from necc_casadi.symbolic.arb import enclosure
from necc_casadi.symbolic.pieces import branches, piece_around
from necc_casadi.symbolic.smoothness import conditions, periodic

q, p, h = sp.symbols("q p h", real=True)


def around(expr, value):
    return piece_around([expr], {q: sp.sympify(value)}, {q: sp.Integer(2)})


RESOLVED = [
    (sp.sqrt(q**4 - 2 * q**2 + 1), "1/2", 1 - q**2),
    (sp.sqrt(q**4 - 2 * q**2 + 1), "2", q**2 - 1),
    (sp.atan(sp.tan(q)), "1", q),
    (sp.atan(sp.tan(q)), "4", q - sp.pi),
    (sp.asin(sp.sin(q)), "2", sp.pi - q),
    (sp.acos(sp.cos(q)), "-1", -q),
    (sp.acos(sp.cos(q)), "8", q - 2 * sp.pi),
    (sp.atan(1 / q) + sp.atan(q), "1", sp.pi / 2),
    (sp.atan(1 / q) + sp.atan(q), "-1", -sp.pi / 2),
    (sp.sqrt(1 - sp.sin(q) ** 2), "2", -sp.cos(q)),
    (sp.sqrt(1 - q) * sp.sqrt(1 + q) - sp.sqrt(1 - q**2), "0", sp.Integer(0)),
    (sp.acosh(sp.cosh(q)), "-1", -q),
    (sp.log(q**2), "-1", 2 * sp.log(-q)),
]


@pytest.mark.parametrize(("expr", "value", "expected"), RESOLVED, ids=str)
def test_a_function_is_resolved_on_its_piece(expr, value, expected):
    piece = around(expr, value)
    assert sp.expand(piece.rewritten(expr) - expected) == 0
    lo, hi = piece.box[q]
    for share in (sp.Rational(1, 50), sp.Rational(1, 2), sp.Rational(49, 50)):
        at = {q: lo + share * (hi - lo)}
        with flint.ctx.workprec(200):
            assert enclosure(expr - piece.rewritten(expr), at).contains(0)


def test_no_piece_holds_a_branch_point():
    assert around(sp.sqrt(q), 0) is None
    assert around(sp.sqrt(q), -1) is None
    lo, hi = around(sp.sqrt(q), 1).box[q]
    assert lo > 0
    lo, hi = around(1 / (q - 3), 2).box[q]
    assert hi < 3
    lo, hi = around(sp.atan(sp.tan(q)), 1).box[q]
    assert hi < sp.pi / 2
    assert around(abs(q - 7), 1) is None  # no smooth function at all


def test_what_is_meromorphic_has_no_branches():
    assert not branches([sp.tan(q) / (1 + q**2), sp.exp(q) / sp.sin(p), sp.sqrt(2) * sp.tanh(q)])
    assert branches([1 + sp.sqrt(q)])
    assert branches([q * sp.atan(1 / q)])


def test_conditions_are_those_of_the_expression_as_it_was_written():
    assert sp.diff(sp.atan(sp.tan(q)), q).simplify() == 1
    assert [str(c) for c in conditions([sp.atan(sp.tan(q)) ** 2])] == ["cos(q) ≠ 0"]
    assert {str(c) for c in conditions([sp.log(h) / q + sp.asin(p)])} == {
        "h > 0", "q ≠ 0", "1 - p > 0", "p + 1 > 0"
    }  # fmt: skip
    assert conditions([sp.sin(q) ** 2 + sp.exp(-q) * sp.tanh(p)]) == ()
    assert conditions([sp.sign(q)]) is None


def test_a_period_stands_for_the_line_where_only_whole_angles_occur():
    (whole,) = conditions([1 / (3 + sp.cos(2 * q) * p)])
    assert periodic([whole], [q, p]) == {q}
    (half,) = conditions([1 / (3 + sp.cos(q / 2))])
    assert periodic([half], [q]) == set()


@settings(max_examples=40, deadline=None)
@given(a=st.integers(-8, 8), scale=st.sampled_from([-9, 0, 9]))
def test_pieces_do_not_depend_on_the_unit(a, scale):
    unit = sp.Rational(10) ** scale
    middle = unit * (20 + a) / 10
    piece = piece_around([sp.sqrt(q / unit)], {q: middle}, {q: 4 * unit})
    lo, hi = piece.box[q]
    assert 0 < lo < middle < hi
