"""Every interval primitive and every slope of a jet against Arb, on doubles meant to break them."""

import math
import sys

import flint
import numpy as np
from flint import arb
from hypothesis import example, given, settings
from hypothesis import strategies as st

from necc_casadi.certificate.prover.arithmetic import jets
from necc_casadi.certificate.prover.arithmetic.intervals import Interval, point
from necc_casadi.symbolic.expressions import FUNCTIONS

NAMES = sorted(FUNCTIONS)

#: Where a function has poles, extrema, ends of its domain or changes of its formula.
CORNERS = [
    0.0, 1.0, -1.0, 700.0, -700.0, 1e5, -1e5, 745.0, -745.0, 0.5773502691896257,
    *(k * np.pi / 2 for k in (-63661, -3, -2, -1, 1, 2, 3, 4, 5, 63661)),
]  # fmt: skip


@st.composite
def near_corners(draw):
    """A corner, moved by a few units in the last place or by a little more."""
    value = draw(st.sampled_from(CORNERS))
    steps = draw(st.integers(-4, 4))
    for _ in range(abs(steps)):
        value = math.nextafter(value, math.inf if steps > 0 else -math.inf)
    return value + draw(st.sampled_from([0.0, 1e-15, -1e-15, 1e-9, -1e-9, 1e-3, -1e-3]))


@st.composite
def of_any_size(draw):
    """Numbers from the smallest denormal to the largest double, evenly in their exponents."""
    size = np.ldexp(draw(st.floats(1, 2)), draw(st.integers(-1074, 1022)))
    return float(draw(st.sampled_from([-1, 1])) * size)


doubles = st.one_of(
    near_corners(), of_any_size(), st.floats(-10, 10), st.floats(allow_nan=False, width=64),
    st.sampled_from([5e-324, -5e-324, 1.7976931348623157e308, 2.2250738585072014e-308]),
).filter(np.isfinite)  # fmt: skip


@st.composite
def boxes(draw):
    """(lo, hi, a double inside): points, neighbours, and intervals of any width."""
    lo = draw(doubles)
    hi = draw(
        st.one_of(
            st.just(lo), st.just(min(math.nextafter(lo, math.inf), sys.float_info.max)), doubles
        )
    )
    lo, hi = min(lo, hi), max(lo, hi)
    share = draw(st.one_of(st.sampled_from([0.0, 1.0]), st.floats(0, 1)))
    inside = lo * (1 - share) + hi * share
    return lo, hi, min(max(inside, lo), hi)


def exactly(compute, *numbers):
    """A ball of 2000 digits, or None where there is no real value."""
    previous, flint.ctx.prec = flint.ctx.prec, 6000
    try:
        value = compute(*map(arb, numbers))
        return value if value.is_finite() else None
    finally:
        flint.ctx.prec = previous


def encloses(lo, hi, value) -> bool:
    """An end that is NaN claims nothing, and then the other end must claim nothing either."""
    if np.isnan(lo) or np.isnan(hi):
        return bool(np.isnan(lo) and np.isnan(hi))
    below = lo == -np.inf or not arb(float(lo)) > value
    above = hi == np.inf or not arb(float(hi)) < value
    return bool(below and above)


@settings(max_examples=600, deadline=None)
@given(box=boxes())
@example(box=(1.5707963267948963, 1.5707963267948966, 1.5707963267948966))
@example(box=(1.5707963267948966, 1.5707963267948966, 1.5707963267948966))
def test_functions_enclose_arb(box):
    lo, hi, inside = box
    for name in NAMES:
        with np.errstate(all="ignore"):
            image = getattr(Interval(np.array(lo), np.array(hi)), name)()
        exact = exactly(getattr(arb, name), inside)
        if exact is None:  # no value there: nothing may be claimed of the box
            assert np.isnan(image.lo), name
            assert np.isnan(image.hi), name
        else:
            assert encloses(float(image.lo), float(image.hi), exact), name


@settings(max_examples=800, deadline=None)
@given(a=boxes(), b=boxes(), exponent=st.integers(-7, 7))
def test_arithmetic_encloses_arb(a, b, exponent):
    A, B = (Interval(np.array(lo), np.array(hi)) for lo, hi, _ in (a, b))
    x, y = a[2], b[2]
    with np.errstate(all="ignore"):
        results = [
            (A + B, lambda u, v: u + v), (A - B, lambda u, v: u - v),
            (A * B, lambda u, v: u * v), (A / B, lambda u, v: u / v),
            (A.square(), lambda u, v: u * u), (A.power(3), lambda u, v: u * u * u),
            (A.power(exponent), lambda u, v: u ** exponent if exponent else arb(1)),
        ]  # fmt: skip
    for image, compute in results:
        exact = exactly(compute, x, y)
        if exact is not None:
            lo, hi = float(image.lo), float(image.hi)
            assert (np.isnan(lo) or np.isnan(hi)) or encloses(lo, hi, exact)


SLOPES = {
    "sin": (arb.cos, lambda v: -v.sin()), "cos": (lambda v: -v.sin(), lambda v: -v.cos()),
    "tan": (lambda v: 1 + v.tan() ** 2, lambda v: 2 * v.tan() * (1 + v.tan() ** 2)),
    "asin": (lambda v: 1 / (1 - v * v).sqrt(), lambda v: v / (1 - v * v).sqrt() ** 3),
    "acos": (lambda v: -1 / (1 - v * v).sqrt(), lambda v: -v / (1 - v * v).sqrt() ** 3),
    "atan": (lambda v: 1 / (1 + v * v), lambda v: -2 * v / (1 + v * v) ** 2),
    "sinh": (arb.cosh, arb.sinh), "cosh": (arb.sinh, arb.cosh),
    "tanh": (lambda v: 1 / v.cosh() ** 2, lambda v: -2 * v.tanh() / v.cosh() ** 2),
    "asinh": (lambda v: 1 / (1 + v * v).sqrt(), lambda v: -v / (1 + v * v).sqrt() ** 3),
    "acosh": (lambda v: 1 / (v * v - 1).sqrt(), lambda v: -v / (v * v - 1).sqrt() ** 3),
    "atanh": (lambda v: 1 / (1 - v * v), lambda v: 2 * v / (1 - v * v) ** 2),
    "exp": (arb.exp, arb.exp), "log": (lambda v: 1 / v, lambda v: -1 / (v * v)),
}  # fmt: skip


@settings(max_examples=500, deadline=None)
@given(box=boxes())
def test_slopes_of_jets_enclose_arb(box):
    lo, hi, inside = box
    for name, slopes in SLOPES.items():
        with np.errstate(all="ignore"):
            enclosures = jets._SLOPES[name](Interval(np.array(lo), np.array(hi)))
        for enclosure, compute in zip(enclosures[1:], slopes, strict=True):
            exact = exactly(compute, inside)
            low, high = float(enclosure.lo), float(enclosure.hi)
            if exact is not None and not (np.isnan(low) or np.isnan(high)):
                assert encloses(low, high, exact), name


def test_the_tangent_of_a_point_near_its_pole_is_tight():
    tangent = point(1.5).tan()
    assert float(tangent.hi - tangent.lo) < 1e-11
