"""Random plants with constant structure and quadratic energy, and how their loops are judged."""

import numpy as np
import sympy as sp
from hypothesis import assume
from hypothesis import strategies as st

from helpers.symbolic_plants import (
    numeric,
)
from necc_casadi.casimirs.find import find_casimirs
from necc_casadi.model.closed_loop import interconnect
from necc_casadi.model.controller import default_controller
from necc_casadi.model.plant import make_plant
from necc_casadi.verdict.judge import judge


def default_loop(plant):
    return interconnect(plant, default_controller(plant))


def judged(loop, target):
    casimirs = find_casimirs(loop, (), target)
    return casimirs, judge(loop, casimirs, target)


integers = st.integers(-2, 2)


@st.composite
def linear_problems(draw):
    """A plant with constant structure and quadratic H, and an equilibrium of it."""
    n, m = draw(st.integers(2, 5)), draw(st.integers(1, 2))

    def matrix(rows, columns):
        return sp.Matrix(
            rows,
            columns,
            draw(st.lists(integers, min_size=rows * columns, max_size=rows * columns)),
        )

    A, Q, G, b = matrix(n, n), matrix(n, n), matrix(n, m), matrix(n, 1)
    assume(np.linalg.matrix_rank(numeric(G)) == m)
    R = b * b.T if draw(st.booleans()) else sp.zeros(n, n)
    x = sp.symbols(f"x1:{n + 1}", real=True)
    Q = Q + Q.T + 3 * draw(st.integers(0, 2)) * sp.eye(n)
    H = (sp.Matrix(x).T * Q * sp.Matrix(x))[0] / 2
    assume(H != 0)
    plant = make_plant(x, A - A.T, R, G, sp.expand(H))
    rates = sp.Matrix(plant.J - plant.R) * Q
    held = rates.row_join(sp.Matrix(G)).nullspace()  # (x*, u*) with (J − R)Qx* + Gu* = 0
    target = sp.zeros(n, 1)
    for v in held:
        target += draw(integers) * v[:n, :]
    return plant, dict(zip(x, target, strict=True))
