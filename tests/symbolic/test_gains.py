"""Gains add up to the dissipation, factors multiply out, and a sign is never guessed."""

import pytest
import sympy as sp
from helpers.dragged import ATTRACT, SWING, UNDECIDED

from necc_casadi.symbolic.gains import Factor, factors, gains, has_one_sign, is_never_negative
from necc_casadi.symbolic.smoothness import is_analytic_at
from necc_casadi.symbolic.zero import is_zero

q, p, s = sp.symbols("q p s", real=True)
LAPLACIAN = sp.Matrix(
    [[p**2, -(p**2), 0], [-(p**2), p**2 + sp.sin(q) ** 2, -(sp.sin(q) ** 2)],
     [0, -(sp.sin(q) ** 2), sp.sin(q) ** 2]]
)  # fmt: skip
MATRICES = {
    **ATTRACT, **SWING, **UNDECIDED,
    "laplacian": LAPLACIAN,
    "constant": sp.Matrix([[2, 1], [1, sp.sqrt(2)]]),
    "state-dependent directions": sp.Matrix([[1, q], [q, q**2]]),
    "one of each": sp.diag(sp.Matrix([[1, q], [q, 1 + q**2]]), p**2),
}  # fmt: skip


@pytest.mark.parametrize("R", MATRICES.values(), ids=MATRICES)
def test_gains_add_up(R):
    split = gains(sp.Matrix(R))
    total = split.rest
    for phi, r in split.terms:
        assert not r.free_symbols
        total += phi * r * r.T
    assert all(is_zero(e) for e in total - R)
    directions = [r for _, r in split.terms]
    assert not directions or sp.Matrix.hstack(*directions).rank() == len(directions)


def test_what_has_no_constant_directions_is_left():
    split = gains(MATRICES["one of each"])
    assert [phi for phi, _ in split.terms] == [p**2]
    assert split.rest == sp.diag(MATRICES["one of each"][:2, :2], 0)
    assert [phi for phi, _ in gains(LAPLACIAN).terms] == [p**2, sp.sin(q) ** 2]


@pytest.mark.parametrize(
    ("phi", "psis"),
    [
        (p**2, {p}),
        (q**2 * p**2, {p, q}),
        (sp.sin(q) ** 2, {sp.sin(q)}),
        (p**2 * sp.tanh(q) ** 2, {p, sp.tanh(q)}),
        (p**2 - 2 * p * q + q**2, {p - q}),
        (p**2 / (1 + q**2), {p}),
        (sp.exp(2000001 * q**2 / 7) * p**2, {p}),
        (p**2 + q**2, {p**2 + q**2}),
    ],
)
def test_factors_multiply_out(phi, psis):
    found = factors(phi)
    assert is_zero(sp.Mul(*[f.psi**f.power for f in found]) - phi)
    vanishing = {f.psi for f in found if f.psi.subs({p: 0, q: 0}) == 0}
    assert {v if v in psis else -v for v in vanishing} == psis


def test_a_function_that_algebra_cannot_factor_is_its_own_factor():
    phi = sp.Piecewise((p**2, q > 0), (0, True))
    assert factors(phi) == (Factor(phi, 1),)


def test_a_sign_is_proved():
    both = Factor(p**2 + q**3, 2)  # ∇² ⪰ 0 at 0
    assert not has_one_sign(both, [])
    assert has_one_sign(Factor(p**2 + q**2, 2), [])
    assert has_one_sign(Factor(-(p**2) - q**4, 2), [Factor(q, 2)])
    assert has_one_sign(Factor(1 - sp.cos(p), 1), [])  # the one factor of some φ ≥ 0
    assert not has_one_sign(Factor(1 - sp.cos(p), 1), [Factor(q, 1)])
    assert not has_one_sign(Factor(p, 2), [])
    assert is_never_negative(p**2 * sp.tanh(q) ** 2)
    assert not is_never_negative(p**3)


@pytest.mark.parametrize(
    ("expr", "analytic"),
    [
        (sp.sin(p) / (1 + q), True),
        (sp.sqrt(1 + q), True),
        (sp.Abs(p), False),
        (sp.sqrt(p**2), False),
        (sp.Max(p, 0), False),
        (sp.Piecewise((p, q > 0), (0, True)), False),
        (1 / p, False),
        (sp.log(q), False),
        (sp.Abs(1 + p), False),
    ],
)
def test_only_what_is_analytic_as_written_is_called_so(expr, analytic):
    assert is_analytic_at([expr], {p: sp.Integer(0), q: sp.Integer(0)}) is analytic
