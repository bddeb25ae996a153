"""Structure of a model: decided exactly, by a second route."""

import numpy as np
import pytest
import sympy as sp
from hypothesis import given, settings
from hypothesis import strategies as st

from necc_casadi.errors import ModelError
from necc_casadi.model.entries import Property
from necc_casadi.model.plant import make_plant

q, p = sp.symbols("q p", real=True)


@given(
    entries=st.lists(st.fractions(-3, 3, max_denominator=8), min_size=9, max_size=9),
    shift=st.fractions(0, 1, max_denominator=8),
)
@settings(max_examples=60, deadline=None)
def test_definiteness_of_R_agrees_with_eigenvalues(entries, shift):
    """Constant R: accepted iff numpy sees no negative eigenvalue, exact rationals throughout."""
    x = sp.symbols("a b c", real=True)
    half = sp.Matrix(3, 3, [sp.Rational(v.numerator, v.denominator) for v in entries])
    R = half * half.T - sp.Rational(shift.numerator, shift.denominator) * sp.eye(3)
    lowest = np.linalg.eigvalsh(np.array(R.evalf(), float))[0]
    H = sum(s**2 for s in x)

    def build():
        return make_plant(x, sp.zeros(3, 3), R, sp.Matrix([0, 0, 1]), H)

    if lowest > 1e-9 or shift == 0:
        assert all(prop.proved for prop in build().properties)
    elif lowest < -1e-9:
        with pytest.raises(ModelError) as caught:
            build()
        assert caught.value.code == "r_not_psd"


@given(st.lists(st.fractions(-3, 3, max_denominator=8), min_size=9, max_size=9))
@settings(max_examples=40, deadline=None)
def test_skewness_is_decided_exactly(entries):
    x = sp.symbols("a b c", real=True)
    A = sp.Matrix(3, 3, [sp.Rational(v.numerator, v.denominator) for v in entries])
    H = sum(s**2 for s in x)
    G = sp.Matrix([0, 0, 1])
    assert make_plant(x, A - A.T, sp.zeros(3, 3), G, H).J == A - A.T
    if sp.zeros(3, 3) != A + A.T:
        with pytest.raises(ModelError) as caught:
            make_plant(x, A, sp.zeros(3, 3), G, H)
        assert caught.value.code == "j_not_skew"


def test_identities_hidden_in_the_entries_are_seen():
    J = sp.Matrix([[0, sp.sin(2 * q)], [-2 * sp.sin(q) * sp.cos(q), 0]])
    R = sp.diag(0, sp.sin(q) ** 2 + sp.cos(q) ** 2)
    plant = make_plant((q, p), J, R, sp.Matrix([0, 1]), p**2)
    assert all(prop.proved for prop in plant.properties)


@pytest.mark.parametrize("proved", [True, False])
def test_a_property_is_found_again_by_its_name(proved):
    skew, psd = Property("skew", "Jc", proved), Property("psd", "R", proved)
    for wanted in (skew, psd, Property("rank", "G", proved, 2)):
        assert Property.named(wanted.name, proved) == wanted
    with pytest.raises(ValueError, match="no property"):
        Property.named("J = -Rᵀ", proved)
