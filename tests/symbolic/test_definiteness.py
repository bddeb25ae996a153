"""Definiteness of constant matrices: by eigenvalues, in any unit, to the last digit."""

import numpy as np
import pytest
import sympy as sp
from helpers.algebra import matrices
from helpers.symbolic_plants import numeric
from hypothesis import given, settings
from hypothesis import strategies as st

from necc_casadi.symbolic.definiteness import definiteness
from necc_casadi.symbolic.semidefinite import is_positive_semidefinite


@given(matrices(rows=(2, 4), columns=(1, 4)), st.integers(0, 3))
@settings(max_examples=60, deadline=None)
def test_definiteness_agrees_with_eigenvalues(L, shift):
    Q = L * L.T - shift * sp.eye(L.rows)
    kind, w = definiteness(Q)
    least = np.linalg.eigvalsh(numeric(Q))[0]
    if kind == "flat":
        assert (Q * w).is_zero_matrix
        assert abs(least) < 1e-9
    elif kind == "negative":
        assert (w.T * Q * w)[0] < 0
    else:
        assert kind == "positive"
        assert least > 0
    assert is_positive_semidefinite(Q) is (kind != "negative")


def test_flat_is_never_a_matter_of_tolerance():
    exactly = sp.cos(sp.pi / 5) - (1 + sp.sqrt(5)) / 4
    tiny = sp.Rational(1, 10**40)
    for constant, kind in (
        (exactly, "flat"),
        (exactly + tiny, "positive"),
        (exactly - tiny, "negative"),
    ):
        assert definiteness(sp.diag(1, constant))[0] == kind


@pytest.mark.parametrize("unit", [sp.Rational(1, 10**15), sp.Integer(1), sp.Integer(10) ** 15])
@pytest.mark.parametrize(
    ("entries", "kind"),
    [([2, 1, 1, 2], "positive"), ([1, 1, 1, 1], "flat"), ([1, 2, 2, 1], "negative")],
)
def test_definiteness_does_not_depend_on_the_unit(entries, kind, unit):
    """Irrational factors take the path through floating point."""
    Q = sp.Matrix(2, 2, entries) * unit * sp.sqrt(2)
    assert definiteness(Q)[0] == kind
