"""What varies, as texts say it."""

import pytest
import sympy as sp
from hypothesis import given
from hypothesis import strategies as st

from necc_casadi.errors import OptionError
from necc_casadi.study.vary import Axis, Band, grid, read_axes, read_bands

NOMINAL = {"m": sp.Rational(1, 2), "g": sp.Integer(-10), "zero": sp.Integer(0)}


def test_bands():
    found = read_bands("m=10%, g=-11:-9", NOMINAL)
    assert found == (Band("m", 0.45, 0.55), Band("g", -11.0, -9.0))
    assert read_bands("g=10%", NOMINAL) == (Band("g", -11.0, -9.0),)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("k=10%", "no parameter k\nIts parameters: m, g, zero"),
        ("m", "--vary m cannot be read\nWrite --vary m=10%"),
        ("m=2", "--vary m=2 cannot be read"),
        ("m=2:1", "m=2:1 is no band: from 2 to 1"),
        ("zero=10%", "zero=10% is no band: from 0 to 0\nThe model has zero = 0"),
        ("m=1%,m=2%", "names m twice"),
        ("m=x:1", "--vary m"),
    ],
)
def test_bands_that_are_none(text, message):
    with pytest.raises(OptionError) as problem:
        read_bands(text, NOMINAL)
    assert message in str(problem.value)


def test_axes_are_exact():
    axes = read_axes(["target=0:pi:3", "m=0.9,1.1"], ["target", "m"], "2:4")
    assert axes == (
        Axis("target", ("0", "pi/2", "pi")),
        Axis("m", ("9/10", "11/10")),
        Axis("seed", ("2", "3")),
    )


@pytest.mark.parametrize(
    ("vary", "seeds", "message"),
    [
        (["k=0:1:2"], None, "there is no k to vary\nKnown: target, m"),
        (["m=0:1"], None, "Write --vary m=LO:HI:N"),
        (["m=0:1:1"], None, "with N from 2 on"),
        (["m=0:1:1000000", "target=0:1:1000000"], None, "At most 1000000"),
        (["m=0:1:2"], "0:999999999", "At most 1000000"),
        (["m=1,x"], None, "--vary m"),
        (["m=1"], "5:0", "--seeds 5:0 is not FROM:TO"),
    ],
)
def test_axes_that_are_none(vary, seeds, message):
    with pytest.raises(OptionError) as problem:
        read_axes(vary, ["target", "m"], seeds)
    assert message in str(problem.value)


@given(st.lists(st.integers(1, 5), min_size=1, max_size=4))
def test_a_grid_has_every_point_once(sizes):
    axes = [Axis(f"a{k}", tuple(map(str, range(size)))) for k, size in enumerate(sizes)]
    count = 1
    for size in sizes:
        count *= size
    points = [tuple(grid(axes, index).values()) for index in range(count)]
    assert len(set(points)) == count
    assert points == sorted(points)
