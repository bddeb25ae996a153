"""Regular matrices in balls: solutions are enclosed, and nothing is said of singular ones."""

import numpy as np
from flint import arb, arb_mat
from hypothesis import given, settings
from hypothesis import strategies as st

from necc_casadi.certificate.checker.arithmetic.balls import ball
from necc_casadi.certificate.checker.arithmetic.definite import regular, solve


def enclosed(middle, radius) -> arb_mat:
    return arb_mat([[ball(float(v - radius), float(v + radius)) for v in row] for row in middle])


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), size=st.integers(1, 4), radius=st.floats(0, 0.2))
def test_solutions_of_every_matrix_enclosed_are_enclosed(seed, size, radius):
    rng = np.random.default_rng(seed)
    middle = np.eye(size) + 0.3 * rng.normal(size=(size, size))
    A, v = enclosed(middle, radius), rng.normal(size=size)
    x = solve(A, [arb(float(t)) for t in v])
    assert regular(A) == (x is not None)
    assert x is not None or radius > 0 or np.linalg.cond(middle) > 1e6
    if x is not None:
        inside = middle + radius * rng.uniform(-1, 1, (size, size))
        for found, exact in zip(x, np.linalg.solve(inside, v), strict=True):
            assert abs(found.mid() - exact) <= found.rad() + 1e-9 * abs(exact)


def test_nothing_is_said_of_singular_matrices():
    for A in (arb_mat([[1, 1], [1, 1]]), enclosed(np.eye(2), 1.5), arb_mat([["nan"]])):
        assert not regular(A)
        assert solve(A, [arb(1)] * A.nrows()) is None
