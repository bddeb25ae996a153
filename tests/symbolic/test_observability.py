"""Observability of (JP, BᵀP), against ranks in floating point."""

import numpy as np
import pytest
import sympy as sp
from helpers.algebra import matrices
from helpers.symbolic_plants import numeric
from hypothesis import given, settings

from necc_casadi.symbolic.finite_field import PRIMES
from necc_casadi.symbolic.observability import is_observable, observability_matrix


@given(matrices(rows=(3, 3), columns=(3, 3)), matrices(rows=(3, 3), columns=(1, 2)))
@settings(max_examples=40, deadline=None)
def test_the_rank_over_a_finite_field_is_the_rank(A, B):
    J, P = A - A.T, A * A.T + sp.eye(3)
    rows = [numeric(B.T * P)]
    for _ in range(2):
        rows.append(rows[-1] @ numeric(J * P))
    expected = np.linalg.matrix_rank(np.vstack(rows), tol=1e-9 * np.abs(np.vstack(rows)).max())
    assert len(observability_matrix(J, B, P, PRIMES[0])) == expected


@pytest.mark.parametrize(("ratio", "observable"), [(sp.sqrt(2), True), (sp.Integer(1), False)])
def test_equal_oscillators_hide_a_mode_and_incommensurable_ones_do_not(ratio, observable):
    """Two oscillators seen through the sum of their momenta; irrational entries need balls."""
    J = sp.Matrix([[0, 0, 1, 0], [0, 0, 0, 1], [-1, 0, 0, 0], [0, -1, 0, 0]])
    P, B = sp.diag(sp.sqrt(3), sp.sqrt(3) * ratio**2, 1, 1), sp.Matrix([0, 0, 1, 1])
    assert is_observable(J, B, P) is observable
