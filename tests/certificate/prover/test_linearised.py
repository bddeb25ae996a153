"""Matrices to the first order: every member of a box, and every mean of what it drifts to."""

import numpy as np
import pytest
import sympy as sp
from hypothesis import given, settings
from hypothesis import strategies as st

from necc_casadi.certificate.prover.arithmetic.intervals import Interval
from necc_casadi.certificate.prover.arithmetic.linearised import linearised

X = sp.symbols("a b", real=True)
MATRIX = sp.Matrix([[sp.cos(X[0]), X[1] ** 2 / (3 + sp.cos(X[0]))], [2, X[0] * X[1]]])
VALUE = sp.lambdify(X, MATRIX)


@settings(deadline=None)
@given(st.integers(0, 10_000), st.sampled_from([0.0, 0.01, 0.3, 4.0]))
def test_members_and_their_means_are_enclosed(seed, width):
    rng = np.random.default_rng(seed)
    boxes = 5
    middle, half = rng.normal(size=(boxes, 2)), width * rng.uniform(size=(boxes, 2))
    lo, size = rng.normal(size=(boxes, 2)) * 0.1, rng.uniform(size=(boxes, 2)) * 0.1
    box = Interval(middle - half, middle + half)
    drift = Interval(lo, lo + size)
    form, rest = linearised(MATRIX, X, box, drift)
    e = rng.uniform(-1, 1, (boxes, 2))
    start = box.mid + box.rad * e * (1 - 1e-12)
    reached = [start + lo + size * rng.uniform(size=(boxes, 2)) for _ in range(3)]
    mean = sum(np.array([VALUE(*z) for z in Z], float) for Z in reached) / 3
    said = form.center + np.einsum("bk,bkij->bij", e, form.parts)
    assert (np.abs(mean - said) <= form.error + rest + 1e-11).all()


@pytest.mark.parametrize("width", [0.1, 0.05])
def test_what_is_left_is_of_the_second_order(width):
    box = Interval(np.array([[0.5, 1.0]]) - width, np.array([[0.5, 1.0]]) + width)
    still = Interval(np.zeros((1, 2)), np.zeros((1, 2)))
    _, rest = linearised(MATRIX, X, box, still)
    assert 0 < rest.max() < 2 * width**2


@settings(deadline=None)
@given(st.integers(0, 10_000), st.sampled_from([0.0, 0.01, 0.3]), st.booleans())
def test_means_along_straight_ways_move_by_half_of_them(seed, width, early):
    """∫F(z + θd)dθ, and 2∫(1 − θ)F(z + θd)dθ, by Gauss's formula."""
    rng = np.random.default_rng(seed)
    boxes = 5
    middle, half = rng.normal(size=(boxes, 2)), width * rng.uniform(size=(boxes, 2))
    box = Interval(middle - half, middle + half)
    drift = Interval(-0.2 * rng.uniform(size=(boxes, 2)), 0.2 * rng.uniform(size=(boxes, 2)))
    form, rest = linearised(MATRIX, X, box, drift, 0.5)
    e = rng.uniform(-1, 1, (boxes, 2))
    start = box.mid + box.rad * e * (1 - 1e-12)
    move = np.where(rng.uniform(size=(boxes, 2)) < 0.5, drift.lo, drift.hi)
    nodes, weights = np.polynomial.legendre.leggauss(12)
    theta, weights = (nodes + 1) / 2, weights / 2
    weights = weights * 2 * (1 - theta) if early else weights
    values = [[VALUE(*(a + t * d)) for a, d in zip(start, move, strict=True)] for t in theta]
    mean = np.einsum("t,tbij->bij", weights, np.array(values, float))
    said = form.center + np.einsum("bk,bkij->bij", e, form.parts)
    assert (np.abs(mean - said) <= form.error + rest + 1e-11).all()


def test_half_of_a_drift_leaves_half_of_its_first_order():
    box = Interval(np.array([[0.5, 1.0]]) - 1e-4, np.array([[0.5, 1.0]]) + 1e-4)
    drift = Interval(np.zeros((1, 2)), np.full((1, 2), 1e-4))
    whole, half = (linearised(MATRIX, X, box, drift, share)[1] for share in (1.0, 0.5))
    assert half.max() < 0.51 * whole.max()
