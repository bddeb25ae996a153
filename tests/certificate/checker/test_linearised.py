"""Matrices to the first order in balls: means along straight ways from every place of a box."""

from itertools import count

import numpy as np
import sympy as sp
from flint import arb
from hypothesis import given, settings
from hypothesis import strategies as st

from necc_casadi.certificate.checker.sampled.linearised import Linearised

X = sp.symbols("a b", real=True)
MATRIX = sp.Matrix([[sp.cos(X[0]), X[0] * X[1]], [X[0] * X[1], X[1] ** 2 / (3 + sp.cos(X[0]))]])
VALUE = sp.lambdify(X, MATRIX)
FORM = Linearised(MATRIX, X, True)


@settings(deadline=None)
@given(st.integers(0, 10_000), st.sampled_from([0.0, 0.01, 0.3]))
def test_means_along_straight_ways_are_enclosed(seed, width):
    """∫F(z + θd)dθ by Gauss's formula, at half of the drift and at all of it."""
    rng = np.random.default_rng(seed)
    middle, half = rng.normal(size=2), width * rng.uniform(size=2)
    down, up = -0.2 * rng.uniform(size=2), 0.2 * rng.uniform(size=2)
    box = tuple(zip((middle - half).tolist(), (middle + half).tolist(), strict=True))
    reached = tuple(
        zip((middle - half + down).tolist(), (middle + half + up).tolist(), strict=True)
    )
    e = rng.uniform(-1, 1, 2) * (1 - 1e-9)
    start, move = middle + half * e, np.where(rng.uniform(size=2) < 0.5, down, up) * (1 - 1e-9)
    nodes, weights = np.polynomial.legendre.leggauss(12)
    mean = sum(
        w / 2 * np.array(VALUE(*(start + (t + 1) / 2 * move)), float)
        for t, w in zip(nodes, weights, strict=True)
    )
    for share in (arb(1) / 2, 1):
        found = FORM(box, reached, [0, 1], count(2), share)
        for i in range(2):
            for j in range(2):
                left = arb(float(mean[i, j])) - found.center[i, j]
                own = arb(0)
                for name, part in found.parts.items():
                    if name < 2:
                        left = left - part[i, j] * arb(float(e[name]))
                    else:
                        own = own + abs(part[i, j])
                assert left.abs_lower() <= own.abs_upper() + arb(1e-9)
