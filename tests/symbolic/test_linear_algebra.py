"""Kernels, ranks and reduced rows of symbolic matrices."""

import numpy as np
import sympy as sp
from helpers.algebra import matrices
from helpers.symbolic_plants import numeric
from hypothesis import given, settings

from necc_casadi.symbolic.arb import real_rank
from necc_casadi.symbolic.finite_field import values
from necc_casadi.symbolic.linear_algebra import constant_kernel, generic_rank, kernel
from necc_casadi.symbolic.modular import rank
from necc_casadi.symbolic.zero import is_zero, sign

q, p = sp.symbols("q p", real=True)


@given(matrices())
@settings(max_examples=60, deadline=None)
def test_kernel_is_the_kernel_in_echelon_form(A):
    K = kernel(A)
    assert (A * K).is_zero_matrix
    assert K.cols == A.cols - np.linalg.matrix_rank(numeric(A))
    leads = []
    for k in range(K.cols):
        column = list(K[:, k])
        leads.append(next(i for i, e in enumerate(column) if e != 0))
        assert column[leads[-1]] > 0
        assert all(e.is_Integer for e in column)
        assert sp.gcd_list(column) == 1
    assert leads == sorted(set(leads))


def test_kernel_respects_identities_of_functions():
    A = sp.Matrix([[sp.sin(q) ** 2 + sp.cos(q) ** 2 - 1, 0], [0, sp.cos(q)]])
    assert kernel(A) == sp.Matrix([1, 0])
    B = sp.Matrix([[sp.cos(q), sp.sin(q)], [sp.sin(q) * sp.cos(q), 1 - sp.cos(q) ** 2]])
    assert kernel(B).cols == 1
    assert all(is_zero(e) for e in B * kernel(B))


def test_kernel_of_algebraic_constants():
    A = sp.Matrix([[sp.sqrt(2), 1], [2, sp.sqrt(2)]])
    assert kernel(A).cols == 1
    assert all(sign(e) == 0 for e in A * kernel(A))


def test_constant_kernel_of_a_state_dependent_matrix():
    A = sp.Matrix([[sp.sin(q), 2 * sp.sin(q), p], [sp.cos(q), 2 * sp.cos(q), 0]])
    assert constant_kernel(A) == sp.Matrix([2, -1, 0])


@given(matrices(), matrices())
@settings(max_examples=30, deadline=None)
def test_ranks_agree(A, B):
    expected = np.linalg.matrix_rank(numeric(A))
    assert generic_rank(A) == expected
    assert real_rank(A, (), expected)
    assert not real_rank(A, (), expected + 1)
    assert rank(values(list(A), 1)[0].reshape(A.shape)) == expected
