"""Intervals and jets against 50-digit values, exact fractions and symbolic derivatives."""

from fractions import Fraction

import mpmath
import numpy as np
import pytest
import sympy as sp
from hypothesis import given, settings
from hypothesis import strategies as st

from necc_casadi.certificate.prover.arithmetic.intervals import Interval, matmul, point, self_test
from necc_casadi.certificate.prover.arithmetic.jets import constant, coordinates, expression_jets

RANGES = {
    "sin": (-60, 60), "cos": (-60, 60), "tan": (-1.5, 1.5), "exp": (-50, 50),
    "log": (1e-9, 1e9), "sqrt": (0, 1e9), "tanh": (-30, 30), "sinh": (-20, 20),
    "cosh": (-20, 20), "atan": (-1e6, 1e6), "asin": (-0.999, 0.999), "acos": (-0.999, 0.999),
    "asinh": (-50, 50), "acosh": (1.001, 50), "atanh": (-0.999, 0.999),
}  # fmt: skip


def test_machine_rounds_as_assumed():
    assert self_test()


@pytest.mark.parametrize("name", RANGES)
@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_elementary_functions_enclose_high_precision_values(name, data):
    lo, hi = RANGES[name]
    ends = sorted(data.draw(st.lists(st.floats(lo, hi), min_size=2, max_size=2)))
    share = data.draw(st.floats(0, 1))
    inside = min(max(ends[0] + share * (ends[1] - ends[0]), ends[0]), ends[1])
    box = Interval(np.array(ends[0]), np.array(ends[1]))
    image, tight = getattr(box, name)(), getattr(point(inside), name)()
    with mpmath.workdps(50):
        exact = getattr(mpmath, name)(mpmath.mpf(inside))
        assert mpmath.mpf(float(image.lo)) <= exact <= mpmath.mpf(float(image.hi))
        assert mpmath.mpf(float(tight.lo)) <= exact <= mpmath.mpf(float(tight.hi))
    assert tight.hi - tight.lo <= 1e-11 * max(1.0, abs(float(exact)))


finite = st.floats(-1e6, 1e6)


@settings(max_examples=100, deadline=None)
@given(a=finite, b=finite, c=finite)
def test_arithmetic_encloses_exact_fractions(a, b, c):
    x, y, z = (Fraction(v) for v in (a, b, c))
    value = point(a) * b + point(c) - (point(a) + c).square()
    exact = x * y + z - (x + z) ** 2
    assert Fraction(float(value.lo)) <= exact <= Fraction(float(value.hi))
    if abs(b) > 1e-3:
        quotient = point(a) / point(b)
        assert Fraction(float(quotient.lo)) <= x / y <= Fraction(float(quotient.hi))


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_matrix_products_and_sums_enclose_exact_fractions(seed):
    rng = np.random.default_rng(seed)
    W = rng.normal(size=(3, 40)) * 10.0 ** rng.integers(-8, 8, (3, 40))
    v = rng.normal(size=(40, 1)) * 10.0 ** rng.integers(-8, 8, (40, 1))
    product, total = matmul(W, point(v)), point(v[:, 0]).sum()
    for i in range(3):
        exact = sum(Fraction(a) * Fraction(b) for a, b in zip(W[i], v[:, 0], strict=True))
        assert Fraction(product.lo[i, 0]) <= exact <= Fraction(product.hi[i, 0])
    exact = sum(Fraction(b) for b in v[:, 0])
    assert Fraction(float(total.lo)) <= exact <= Fraction(float(total.hi))


def test_what_is_not_defined_is_unknown_and_stays_unknown():
    with np.errstate(all="ignore"):
        around = Interval(np.array(-1.0), np.array(1.0))
        for unknown in (around.reciprocal(), around.log(), around.sqrt(), (around * 3.0).asin()):
            assert np.isnan(unknown.lo) or np.isnan(unknown.hi)
        pole = Interval(np.array(1.0), np.array(2.0)).tan()
        assert np.isnan(pole.lo)
        assert not (around.reciprocal() * 0.0 + 1.0).lo > 0


@pytest.mark.parametrize("text", ["pi/4", "sqrt(2)/2", "1/3", "-7/10", "exp(1)*sin(2)", "2**100"])
def test_constants_are_enclosed(text):
    expr = sp.sympify(text)
    value, exact = constant(expr), mpmath.mpf(0)
    with mpmath.workdps(50):
        exact = mpmath.mpf(str(sp.N(expr, 50)))
        assert mpmath.mpf(float(value.lo)) <= exact <= mpmath.mpf(float(value.hi))
    assert value.hi - value.lo <= 1e-14 * abs(value.hi)


x, y = sp.symbols("x y", real=True)
EXPRESSIONS = [
    x**2 * sp.cos(y) + sp.exp(x * y) / (2 + sp.sin(x)),
    sp.sqrt(3 + x + y) * sp.log(4 + x * y) - sp.tanh(x - 2 * y),
    (3 + x) ** sp.Rational(-3, 2) + sp.atan(x * y) + sp.asinh(y) - (3 + y) ** x,
    sp.tan(x / 2) + sp.asin(y / 3) * sp.acos(x / 3) + sp.atanh(x / 4) + sp.acosh(3 + x),
    sp.sinh(x) * sp.cosh(y) + (x + y) ** 3 - x**-1 * 0 + sp.pi * x,
]


@pytest.mark.parametrize("expr", EXPRESSIONS)
@settings(max_examples=25, deadline=None)
@given(
    center=st.tuples(*[st.integers(-64, 64)] * 2),
    radius=st.integers(0, 20),
    seed=st.integers(0, 99),
)
def test_jets_enclose_symbolic_derivatives(expr, center, radius, seed):
    middle, radius = np.array(center) / 64, radius / 64
    Z = Interval(middle[None] - radius, middle[None] + radius)
    with np.errstate(all="ignore"):
        (jet,) = expression_jets([expr], dict(zip((x, y), coordinates(Z), strict=True)))
    at = np.round((middle + radius * np.random.default_rng(seed).uniform(-1, 1, 2)) * 2**20) / 2**20
    for enclosure, derivatives in [
        (jet.value, [expr]),
        (jet.grad, [expr.diff(v) for v in (x, y)]),
        (jet.hess, list(sp.hessian(expr, (x, y)))),
    ]:
        with mpmath.workdps(30):  # not by substitution: sympy would hunt for exact roots
            exact = [
                float(sp.lambdify((x, y), d, "mpmath")(*map(mpmath.mpf, at))) for d in derivatives
            ]
        assert np.all(enclosure.lo.ravel() <= np.array(exact) + 1e-14 * (1 + np.abs(exact)))
        assert np.all(enclosure.hi.ravel() >= np.array(exact) - 1e-14 * (1 + np.abs(exact)))
