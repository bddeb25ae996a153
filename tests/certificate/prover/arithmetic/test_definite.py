"""Definite and regular matrices: never claimed of one that is not."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from necc_casadi.certificate.prover.arithmetic.definite import (
    exactly_positive_definite,
    inverse,
    positive_definite,
    regular,
    solve,
)
from necc_casadi.certificate.prover.arithmetic.intervals import Interval, point


@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), gap=st.floats(1e-6, 1))
def test_definiteness_is_never_claimed_of_an_indefinite_matrix(seed, gap):
    rng = np.random.default_rng(seed)
    Q = np.linalg.qr(rng.normal(size=(4, 4)))[0]
    A = Q @ np.diag([-gap, 1, 2, 3]) @ Q.T
    B = Q @ np.diag([gap, 1, 2, 3]) @ Q.T
    assert not positive_definite(point(A[None]))[0]
    assert positive_definite(point(B[None]))[0]
    assert not positive_definite(point(B[None]), 1.01 * gap)[0]
    wide = Interval(B[None] - 2 * gap, B[None] + 2 * gap)
    assert not positive_definite(wide)[0]
    assert not exactly_positive_definite(A)
    assert exactly_positive_definite(B)


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), size=st.integers(1, 4), radius=st.floats(0, 0.2))
def test_solutions_of_every_matrix_enclosed_are_enclosed(seed, size, radius):
    """And nothing is said where a matrix enclosed is singular."""
    rng = np.random.default_rng(seed)
    middle = np.eye(size) + 0.3 * rng.normal(size=(3, size, size))
    middle[2] = 0.0  # singular
    A = Interval(middle - radius, middle + radius)
    v = rng.normal(size=(3, size, 2))
    x, proved = solve(A, point(v)), regular(A)
    assert not proved[2]
    assert not np.isfinite(x.hi[2]).any()
    assert proved[0] or radius > 0 or np.linalg.cond(middle[0]) > 1e6
    for box in np.flatnonzero(proved):
        inside = middle[box] + radius * rng.uniform(-1, 1, (size, size))
        exact = np.linalg.solve(inside, v[box])
        assert (x.lo[box] <= exact + 1e-9 * np.abs(exact)).all()
        assert (exact - 1e-9 * np.abs(exact) <= x.hi[box]).all()


def test_the_inverse_is_enclosed_closely():
    A = np.array([[2.0, 1.0], [1.0, 1.0]])
    found = inverse(A)
    exact = np.array([[1.0, -1.0], [-1.0, 2.0]])
    assert ((found.lo <= exact) & (exact <= found.hi)).all()
    assert (found.hi - found.lo).max() < 1e-13
    assert not np.isfinite(inverse(np.ones((2, 2))).hi).any()
