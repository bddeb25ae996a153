"""Constants that are zero in disguise, and constants that are nearly so."""

import pytest
import sympy as sp

from necc_casadi.symbolic.zero import Undecided, is_zero, sign

R = sp.Rational
ZEROS = [
    sp.atan(R(1, 2)) + sp.atan(R(1, 3)) - sp.pi / 4,
    4 * sp.atan(R(1, 5)) - sp.atan(R(1, 239)) - sp.pi / 4,
    sp.atan(2) + sp.atan(3) - 3 * sp.pi / 4,
    sp.atan(sp.sqrt(2)) + sp.atan(1 / sp.sqrt(2)) - sp.pi / 2,
    sp.asin(R(3, 5)) + sp.acos(R(3, 5)) - sp.pi / 2,
    sp.acos(R(1, 3)) - 2 * sp.asin(sp.sqrt(R(1, 3))),
    sp.log(2) + sp.log(3) - sp.log(6),
    2 * sp.atanh(R(1, 3)) - sp.log(2),
    sp.asinh(R(1, 2)) - sp.log((1 + sp.sqrt(5)) / 2),
    (sp.exp(300) + 1) ** 2 - sp.exp(600) - 2 * sp.exp(300) - 1,
    sp.cos(sp.pi / 7) - sp.cos(2 * sp.pi / 7) + sp.cos(3 * sp.pi / 7) - R(1, 2),
    sp.sqrt(2) + sp.sqrt(3) - sp.sqrt(5 + 2 * sp.sqrt(6)),
    sp.sin(sp.sqrt(3 + 2 * sp.sqrt(2))) ** 3 - sp.sin(1 + sp.sqrt(2)) ** 3,
    sp.tanh(R(1, 3)) - (sp.exp(R(2, 3)) - 1) / (sp.exp(R(2, 3)) + 1),
]


#: These take long: sevenths of a turn, nested roots, exponentials of unlike numbers.
LONG = [ZEROS[-4], *ZEROS[-2:]]


@pytest.mark.parametrize(
    "zero", [pytest.param(z, marks=pytest.mark.slow if z in LONG else ()) for z in ZEROS], ids=str
)
def test_a_zero_in_disguise_is_proved_and_its_neighbour_has_a_sign(zero):
    assert sign(zero) == 0
    for size in (10**40, 10**300):
        assert sign(zero + R(1, size)) == 1
        assert sign(zero - R(1, size)) == -1


def test_angles_that_differ_by_a_turn_are_told_apart():
    assert sign(sp.atan(2) + sp.atan(3) + sp.pi / 4) == 1
    assert sign(sp.atan(-2) + sp.atan(-3) + 3 * sp.pi / 4) == 0


def test_a_constant_without_a_proof_is_neither_zero_nor_not():
    unknown = 2 ** sp.log(3) - 3 ** sp.log(2)  # both are exp(ln 2 · ln 3)
    assert sign(unknown) is None
    assert is_zero(unknown) is None
    assert sign(unknown + R(1, 10**200)) == 1


def test_a_constant_with_no_real_value_has_no_sign():
    assert sign(sp.log(-1 + R(1, 2)) * 1) is None
    assert sign(sp.acosh(R(1, 2))) is None


def test_rounding_is_never_taken_for_a_difference():
    q = sp.Symbol("q", real=True)
    assert is_zero((sp.exp(q) + 1) ** 2 - sp.exp(2 * q) - 2 * sp.exp(q) - 1) is True
    assert is_zero(q / 10**60) is False
    assert is_zero(sp.acos(q) + sp.asin(q) - sp.pi / 2) is True


def test_a_pivot_that_is_not_decided_is_said_to_be_so():
    from necc_casadi.symbolic.linear_algebra import kernel

    unknown = 2 ** sp.log(3) - 3 ** sp.log(2)
    with pytest.raises(Undecided, match="log"):
        kernel(sp.Matrix([[unknown, 0], [0, 1]]))
    # beside a pivot that is one, it does not matter
    assert kernel(sp.Matrix([[1, unknown], [0, 1]])).cols == 0
