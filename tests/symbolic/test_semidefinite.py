"""Semidefiniteness for all states, block by block."""

import sympy as sp

from necc_casadi.symbolic.semidefinite import blocks

q, p = sp.symbols("q p", real=True)


def test_blocks_are_the_connected_components():
    Q = sp.zeros(5, 5)
    Q[0, 3] = Q[3, 0] = 1
    Q[1, 2] = Q[2, 1] = q
    assert blocks(Q) == [[0, 3], [1, 2], [4]]
