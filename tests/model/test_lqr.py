"""LQR: known by hand, in any units, and refused where no feedback stabilises."""

import numpy as np
import pytest

from necc_casadi.errors import OptionError
from necc_casadi.model.cost import QuadraticCost, weight_matrix
from necc_casadi.model.lqr import lqr


def test_the_double_integrator_by_hand():
    A, B = np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[0.0], [1.0]])
    found = lqr(A, B, QuadraticCost(np.diag([1.0, 0.0]), np.eye(1)))
    root = np.sqrt(2)
    np.testing.assert_allclose(found.P, [[root, 1], [1, root]], rtol=1e-12)
    np.testing.assert_allclose(found.K, [[1, root]], rtol=1e-12)


@pytest.mark.parametrize("unit", [1e-9, 1.0, 1e9])
def test_units_do_not_matter(unit):
    rng = np.random.default_rng(0)
    A, B = rng.normal(size=(4, 4)), rng.normal(size=(4, 2))
    S, U = np.array([unit, 1.0, 1 / unit, unit**0.5]), np.array([unit, 1 / unit])
    cost = QuadraticCost(np.eye(4), np.eye(2))
    plain = lqr(A, B, cost)
    other = lqr(
        A * S[:, None] / S,
        B * S[:, None] / U,
        QuadraticCost(np.diag(S**-2.0), np.diag(U**-2.0)),
    )
    np.testing.assert_allclose(other.K * S / U[:, None], plain.K, rtol=1e-8, atol=1e-10)


def test_what_cannot_be_stabilised_has_no_lqr():
    A, B = np.diag([1.0, -1.0]), np.array([[0.0], [1.0]])
    assert lqr(A, B, QuadraticCost(np.eye(2), np.eye(1))) is None


def test_weights_in_their_three_forms():
    np.testing.assert_array_equal(weight_matrix(2.0, 2, "Q", True), 2 * np.eye(2))
    np.testing.assert_array_equal(weight_matrix([1.0, 0.0], 2, "Q", False), np.diag([1.0, 0.0]))
    full = np.array([[2.0, 1.0], [1.0, 2.0]])
    np.testing.assert_array_equal(weight_matrix(full * 1e-30, 2, "Q", True), full * 1e-30)


@pytest.mark.parametrize(
    ("value", "strict"),
    [
        ([1.0, 0.0], True), (-1.0, False), ([[1.0, 2.0], [2.0, 1.0]], False), (np.nan, False),
        ([[1.0, 1.0], [0.0, 1.0]], False), ([1.0, 2.0, 3.0], False), ([0.0, 0.0], False),
        ([[0.0, 1e-9], [1e-9, 1.0]], False), ([[1.0, 1.0], [1.0, 1.0]], True),
    ],
)  # fmt: skip
def test_what_is_no_weight(value, strict):
    with pytest.raises(OptionError, match="state_cost"):
        weight_matrix(value, 2, "state_cost", strict)
