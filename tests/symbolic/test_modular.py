"""Linear algebra over a finite field, lifted to the rationals."""

import numpy as np
import sympy as sp
from helpers.algebra import matrices
from helpers.symbolic_plants import numeric
from hypothesis import given, settings

from necc_casadi.symbolic.finite_field import values
from necc_casadi.symbolic.modular import nullspace


@given(matrices(rows=(1, 3), columns=(2, 5)))
@settings(max_examples=30, deadline=None)
def test_null_vectors_are_lifted_to_the_rationals(A):
    vectors = nullspace(lambda prime: values(list(A), 1, prime=prime)[0].reshape(A.shape))
    assert len(vectors) == A.cols - np.linalg.matrix_rank(numeric(A))
    assert all((A * sp.Matrix(v)).is_zero_matrix for v in vectors)
