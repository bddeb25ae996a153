import numpy as np
import pytest
import sympy as sp
from helpers.symbolic_plants import numeric
from hypothesis import given, settings
from hypothesis import strategies as st

from necc_casadi.symbolic.arb import real_rank
from necc_casadi.symbolic.definiteness import definiteness
from necc_casadi.symbolic.finite_field import values
from necc_casadi.symbolic.linear_algebra import constant_kernel, generic_rank, kernel
from necc_casadi.symbolic.modular import nullspace, rank
from necc_casadi.symbolic.semidefinite import blocks, is_positive_semidefinite
from necc_casadi.symbolic.zero import is_zero, sign
from necc_casadi.verdict.curvature import best_curvature

q, p = sp.symbols("q p", real=True)
entries = st.integers(-3, 3)


@st.composite
def matrices(draw, rows=(1, 5), columns=(1, 5)):
    r, c = draw(st.integers(*rows)), draw(st.integers(*columns))
    return sp.Matrix(r, c, draw(st.lists(entries, min_size=r * c, max_size=r * c)))


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
    ],
)
def test_zero_is_recognised_and_its_neighbours_are_not(zero):
    assert is_zero(zero) is True
    assert is_zero(zero + sp.Rational(1, 10**15)) is False


def test_values_respect_the_identities_of_functions():
    x, y = sp.symbols("x y", positive=True)
    identities = [
        sp.sin(x) ** 2 + sp.cos(x) ** 2 - 1,
        sp.sin(x + 2 * y) - sp.sin(x) * sp.cos(2 * y) - sp.cos(x) * sp.sin(2 * y),
        sp.sqrt(x * y) - sp.sqrt(x) * sp.sqrt(y),
        sp.log(x * y) - sp.log(x) - sp.log(y),
        sp.exp(x / 2) ** 2 - sp.exp(x),
    ]
    assert not np.any(values(identities, 5))


def test_signs_of_close_constants():
    assert sign(sp.pi - sp.Rational(355, 113)) == -1
    assert sign(sp.Rational(1, 10**60)) == 1
    assert sign(sp.cos(sp.pi / 5) - (1 + sp.sqrt(5)) / 4) == 0
    assert sign(sp.oo) is None
    assert sign(q) is None


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


@given(matrices(), matrices())
@settings(max_examples=30, deadline=None)
def test_ranks_agree(A, B):
    expected = np.linalg.matrix_rank(numeric(A))
    assert generic_rank(A) == expected
    assert real_rank(A, (), expected)
    assert not real_rank(A, (), expected + 1)
    assert rank(values(list(A), 1)[0].reshape(A.shape)) == expected


@given(matrices(rows=(1, 3), columns=(2, 5)))
@settings(max_examples=30, deadline=None)
def test_null_vectors_are_lifted_to_the_rationals(A):
    vectors = nullspace(lambda prime: values(list(A), 1, prime=prime)[0].reshape(A.shape), 2)
    assert len(vectors) == A.cols - np.linalg.matrix_rank(numeric(A))
    assert all((A * sp.Matrix(v)).is_zero_matrix for v in vectors)


def test_blocks_are_the_connected_components():
    Q = sp.zeros(5, 5)
    Q[0, 3] = Q[3, 0] = 1
    Q[1, 2] = Q[2, 1] = q
    assert blocks(Q) == [[0, 3], [1, 2], [4]]


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
