"""The Casimir condition."""

import numpy as np
import sympy as sp


def test_casimirs_of_the_fixtures_solve_the_condition(pendulum, crane):
    for task in (pendulum, crane):
        M = sp.lambdify([task.loop.z], sp.Matrix(task.loop.M), "numpy")
        z = np.random.default_rng(0).normal(size=task.loop.n)
        for c in task.casimirs.functions:
            slope = sp.lambdify([task.loop.z], [sp.diff(c, s) for s in task.loop.z], "numpy")
            np.testing.assert_allclose(np.array(slope(z), float) @ np.array(M(z), float), 0)
