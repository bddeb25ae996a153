"""Every arithmetic knows every function that a model may use, and gives it the same value."""

import casadi as ca
import flint
import numpy as np
import pytest
import sympy as sp

from necc_casadi.certificate.checker.arithmetic.balls import evaluate
from necc_casadi.certificate.checker.arithmetic.tapes import Tape
from necc_casadi.certificate.prover.arithmetic.intervals import Interval, point
from necc_casadi.certificate.prover.arithmetic.jets import (
    coordinates,
    expression_jets,
    expression_values,
)
from necc_casadi.errors import NeccError
from necc_casadi.lyapunov.sympy2casadi import casadi_function
from necc_casadi.symbolic.arb import ball
from necc_casadi.symbolic.expressions import FUNCTIONS
from necc_casadi.symbolic.finite_field import values
from necc_casadi.symbolic.fold import Algebra, fold

q = sp.Symbol("q", real=True)


def inside(name) -> sp.Rational:
    """A point where the function is defined."""
    return sp.Rational(3, 2) if name == "acosh" else sp.Rational(2, 5)


def by_casadi(expr, value):
    return float(casadi_function("f", [q], [expr])(float(value)))


def by_arb(expr, value):
    return float(ball(expr, {q: flint.arb(flint.fmpq(value.p, value.q))}).mid())


def by_jets(expr, value):
    X = Interval(np.array([[float(value)]]), np.array([[float(value)]]))
    (jet,) = expression_jets([expr], {q: coordinates(X)[0]})
    return float(jet.value.lo[0] / 2 + jet.value.hi[0] / 2)


def by_intervals(expr, value):
    (v,) = expression_values([expr], {q: point(float(value))})
    return float(v.lo / 2 + v.hi / 2)


def by_the_checkers_balls(expr, value):
    return float(evaluate(expr, {q: flint.arb(flint.fmpq(value.p, value.q))}).mid())


def by_the_checkers_tapes(expr, value):
    return float(Tape([expr], [q])([flint.arb(flint.fmpq(value.p, value.q))])[0].mid())


ARITHMETICS = [
    by_casadi, by_arb, by_jets, by_intervals, by_the_checkers_balls, by_the_checkers_tapes,
]  # fmt: skip


@pytest.mark.parametrize("name", FUNCTIONS)
@pytest.mark.parametrize("arithmetic", ARITHMETICS, ids=lambda f: f.__name__)
def test_every_arithmetic_covers_every_function(arithmetic, name):
    value = inside(name)
    for expr in (FUNCTIONS[name](q), q ** (q * FUNCTIONS[name](q)), FUNCTIONS[name](q) ** -3):
        expected = float(expr.subs(q, value).evalf(30))
        assert arithmetic(expr, value) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_every_function_has_residues(name):
    """Of what has no algebraic law a random residue is taken, the same wherever it occurs."""
    f = FUNCTIONS[name](q)
    assert not np.any(values([(f + 1) ** 2 - f**2 - 2 * f - 1], 3))


@pytest.mark.parametrize("expr", [sp.gamma(q), sp.Symbol("unknown") + q, sp.Abs(q) ** q])
def test_what_has_no_counterpart_is_named(expr):
    with pytest.raises(NeccError, match="has no counterpart"):
        casadi_function("f", [q], [expr])


def test_a_constant_that_arb_lacks_is_measured_and_an_unknown_symbol_is_no_number():
    root = sp.CRootOf(q**5 - q - 1, 0)
    assert ball(root, {}).overlaps(flint.arb(str(root.evalf(50))))
    assert not ball(sp.Symbol("unknown"), {}).is_finite()


def test_each_part_is_visited_once():
    visited = []
    counting = Algebra(
        {"sin": lambda v: v}, number=lambda e: visited.append(e) or None, power=lambda e, walk: 1.0
    )
    expr = sp.sin(q) * (sp.sin(q) + q)
    assert fold(expr, counting, {q: 2.0}) == 8.0
    assert sorted(map(str, visited)) == sorted(map(str, [expr, sp.sin(q), sp.sin(q) + q]))


def test_casadi_powers_are_products():
    """No call of pow() in the generated C for small whole exponents."""
    f = casadi_function("f", [q], [q**7, q**-3, sp.sqrt(q), 1 / sp.sqrt(q)])
    used = {f.instruction_id(k) for k in range(f.n_instructions())}
    assert not used & {ca.OP_POW, ca.OP_CONSTPOW}
