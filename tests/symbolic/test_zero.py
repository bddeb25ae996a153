"""Zero and signs, decided exactly."""

import pytest
import sympy as sp

from necc_casadi.symbolic.zero import is_zero, sign

q, p = sp.symbols("q p", real=True)
_nested = sp.sqrt(1 + sp.sqrt(1 + q**2))


@pytest.mark.parametrize(
    "zero",
    [
        sp.sin(q / 2) ** 2 - (1 - sp.cos(q)) / 2,
        sp.tan(q / 2) - sp.sin(q) / (1 + sp.cos(q)),
        sp.cosh(q) ** 2 - sp.sinh(q) ** 2 - 1,
        sp.exp(q + p) * sp.exp(-q) - sp.exp(p),
        sp.sin(q + sp.pi / 4) - (sp.sin(q) + sp.cos(q)) / sp.sqrt(2),
        sp.sqrt(2) + sp.sqrt(3) - sp.sqrt(5 + 2 * sp.sqrt(6)),
        1 / (1 + q) - (1 - q) / (1 - q**2),
        1 / (sp.sqrt(1 + q**2) - q) - sp.sqrt(1 + q**2) - q,
        1 / (_nested - 1) - (_nested + 1) / sp.sqrt(1 + q**2),
        sp.cos(q) ** sp.Rational(5, 3) * (1 - sp.sin(q) ** 2) - sp.cos(q) ** sp.Rational(11, 3),
        sp.log(6 + 6 * q**2) - sp.log(2) - sp.log(3 + 3 * q**2),
    ],
)
def test_zero_is_recognised_and_its_neighbours_are_not(zero):
    assert is_zero(zero) is True
    assert is_zero(zero + sp.Rational(1, 10**15)) is False


def test_signs_of_close_constants():
    assert sign(sp.pi - sp.Rational(355, 113)) == -1
    assert sign(sp.Rational(1, 10**60)) == 1
    assert sign(sp.cos(sp.pi / 5) - (1 + sp.sqrt(5)) / 4) == 0
    assert sign(sp.oo) is None
    assert sign(q) is None
