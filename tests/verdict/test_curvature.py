"""The best definiteness over a family Q(τ)."""

import numpy as np
import pytest
import sympy as sp
from helpers.algebra import matrices
from helpers.symbolic_plants import numeric
from hypothesis import given, settings

from necc_casadi.symbolic.definiteness import definiteness
from necc_casadi.verdict.curvature import best_curvature


def test_least_eigenvalue_over_a_family_is_maximal():
    Q0, Q1 = sp.diag(1, -3), sp.diag(-1, 1)
    best = best_curvature(Q0, [Q1], sp.eye(2))
    assert best.kind == "negative"
    assert best.ceiling == pytest.approx(-1.0, abs=1e-6)
    best = best_curvature(sp.diag(5, -3), [Q1], sp.eye(2))
    assert best.kind == "positive"
    assert best.ceiling == pytest.approx(1.0, abs=1e-6)
    assert definiteness(sp.diag(5, -3) + best.tau[0] * Q1)[0] == "positive"
    assert best_curvature(sp.diag(5, -3), [sp.eye(2)], sp.eye(2)).ceiling is None
    assert best_curvature(sp.diag(3, -3), [Q1], sp.eye(2)).kind != "positive"


@given(matrices(rows=(3, 3), columns=(3, 3)), matrices(rows=(3, 3), columns=(3, 3)))
@settings(max_examples=60, deadline=None)
def test_family_verdicts_agree_with_a_scan(A, B):
    """λ_min is concave along τ: a fine scan comes close to its supremum and never above it."""
    Q0, Q1 = A + A.T, B + B.T
    best = best_curvature(Q0, [Q1], sp.eye(3))
    steps = np.concatenate([np.linspace(-5, 5, 401), np.linspace(-200, 200, 401)])
    family = numeric(Q0) + steps[:, None, None] * numeric(Q1)
    scan = float(np.linalg.eigvalsh(family)[:, 0].max())
    if best.ceiling is not None:
        assert scan <= best.ceiling + 1e-5
    if scan > 1e-6:
        assert best.kind == "positive"
    if best.kind == "positive":
        assert definiteness(Q0 + best.tau[0] * Q1)[0] == "positive"
    if best.kind == "negative":
        assert scan < 1e-9
    if best.kind == "flat":
        assert scan < 1e-9


@pytest.mark.parametrize("unit", [sp.Rational(1, 2**50), sp.Integer(2) ** 50])
@pytest.mark.parametrize("first", [1, 5])
def test_units_of_energy_and_of_casimirs_change_no_verdict(unit, first):
    """Q₀ in another unit of energy, Q₁ in another unit of the Casimir."""
    Q0, Q1 = sp.diag(first, -3), sp.diag(-1, 1)
    here = best_curvature(Q0, [Q1], sp.eye(2))
    for energy, casimir in ((unit, unit), (1, unit), (unit, 1)):
        there = best_curvature(energy * Q0, [casimir * Q1], sp.eye(2))
        assert there.kind == here.kind
        assert there.ceiling / float(energy) == pytest.approx(here.ceiling, abs=1e-6)


@pytest.mark.parametrize(
    ("base", "directions"),
    [(-2, [-6]), (0, [-4, 0]), (2, [-4]), (-2, [4]), (2, [4, 4, -2]), (0, [1]), (-1, [0, 1])],
)
def test_one_free_multiplier_lifts_one_curvature_without_end(base, directions):
    best = best_curvature(sp.Matrix([base]), [sp.Matrix([d]) for d in directions], sp.eye(1))
    assert (best.kind, best.ceiling) == ("positive", None)
    assert base + sum(t * d for t, d in zip(best.tau, directions, strict=True)) > 0


@given(
    matrices(rows=(2, 3), columns=(3, 3)), matrices(rows=(3, 3), columns=(3, 3)),
    matrices(rows=(3, 3), columns=(3, 3)),
)  # fmt: skip
@settings(max_examples=60, deadline=None)
def test_two_directions_leave_no_member_above_the_ceiling(B, A, C):
    """Q₁ = BᵀB ⪰ 0 may lift the curvature without end; Q₂ is any."""
    Q0, Q1, Q2 = A + A.T, B.T * B, C + C.T
    best = best_curvature(Q0, [Q1, Q2], sp.eye(3))
    grid = np.concatenate([np.linspace(-5, 5, 21), [-1e4, -100, 100, 1e4]])
    tau = np.stack(np.meshgrid(grid, grid), -1).reshape(-1, 2)
    family = numeric(Q0) + np.tensordot(tau, np.array([numeric(Q1), numeric(Q2)]), 1)
    scan = float(np.linalg.eigvalsh(family)[:, 0].max())
    if best.ceiling is not None:
        assert scan <= best.ceiling + 1e-5
    if scan > 1e-6:
        assert best.kind == "positive"
    if best.kind == "positive":
        assert best.ceiling is None or best.ceiling > 0
        member = Q0 + best.tau[0] * Q1 + best.tau[1] * Q2
        assert definiteness(member)[0] == "positive"
    if best.kind in ("negative", "flat"):
        assert scan < 1e-9
