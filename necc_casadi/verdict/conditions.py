"""What eq. LocalMinimumCondition asks of a target: exact derivatives, gradient, curvature.

With N = ∇ₓc(x*, ξ*) and W a basis of ker Nᵀ: ∇H + Nλ = 0 and Wᵀ∇²ₓ(H + Σ λᵢcᵢ)W ≻ 0.

References
----------
Finsler (1937).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import sympy as sp

from necc_casadi.casimirs.casimirs import Casimirs
from necc_casadi.model.closed_loop import ClosedLoop
from necc_casadi.symbolic.definiteness import UNDECIDED, Definiteness
from necc_casadi.symbolic.derivatives import at, column, gradient, sparse_hessian
from necc_casadi.symbolic.expressions import is_finite
from necc_casadi.symbolic.finite_field import NoFiniteFieldValue, values
from necc_casadi.symbolic.floats import float_matrix
from necc_casadi.symbolic.linear_algebra import has_rank, kernel, reduced_rows
from necc_casadi.symbolic.modular import pivots
from necc_casadi.symbolic.zero import is_zero, random_point, sign
from necc_casadi.verdict.curvature import Curvature, best_curvature
from necc_casadi.verdict.verdict import Reason

__all__ = [
    "LocalConditions",
    "TargetDerivatives",
    "constant_annihilator",
    "independent_at_every_xi",
    "is_equilibrium",
    "local_conditions",
    "target_data",
]


@dataclass(frozen=True, eq=False)
class TargetDerivatives:
    """Exact derivatives at (x*, ξ) of the energy and of the Casimirs that are finite there."""

    x: tuple[sp.Symbol, ...]  # (n,)
    xi: tuple[sp.Symbol, ...]  # (nc,)
    grad_H: sp.ImmutableMatrix  # n × 1
    hess_H: sp.ImmutableMatrix  # n × n
    grad_c: sp.ImmutableMatrix  # (n + nc) × r; may contain ξ
    hess_c: tuple[sp.ImmutableMatrix, ...]  # r of n × n, with respect to x; may contain ξ
    used: tuple[int, ...]  # which Casimirs are finite at the target
    count: int  # how many Casimirs there are in hand

    @cached_property
    def depends_on_xi(self) -> bool:
        """Whether the conditions at the target involve ξ*."""
        n = len(self.x)
        free = sp.Matrix(self.grad_c)[:n, :].free_symbols.union(
            *[Q.free_symbols for Q in self.hess_c]
        )
        return bool(free & set(self.xi))

    @cached_property
    def stiffness(self) -> float:
        """The largest entry of ∇²H(x*), beside which curvatures are compared."""
        return float(np.nan_to_num(np.abs(float_matrix(self.hess_H))).max()) or 1.0

    def fixed(self, xi_star: Sequence[sp.Expr]) -> TargetDerivatives:
        """The same data at one ξ*."""
        point = dict(zip(self.xi, xi_star, strict=True))
        return replace(
            self,
            grad_c=at(self.grad_c, point),
            hess_c=tuple(at(Q, point) for Q in self.hess_c),
        )

    @property
    def finite(self) -> bool:
        """Whether every entry is a finite number or expression."""
        return all(
            is_finite(entry)
            for matrix in (self.grad_c, *self.hess_c)
            for entry in matrix.todok().values()
        )


@dataclass(frozen=True, eq=False)
class LocalConditions:
    """The conditions evaluated at one ξ* (or at all, where they do not depend on it)."""

    gradient: bool | None  # ∇H + Nλ = 0 is solvable
    invisible: sp.ImmutableMatrix  # n × k, W
    slope: sp.ImmutableMatrix  # k × 1, Wᵀ∇H
    lam: tuple[sp.Expr, ...] | None
    directions: tuple[sp.Matrix, ...] = ()  # basis of {λ : Nλ = 0}, r × 1 each
    curvature: sp.ImmutableMatrix | None = None  # at `lam`
    best: Curvature | None = None
    undecided: str | None = None  # an expression of which it is not known whether it is 0

    @classmethod
    def unknown(cls, n: int) -> LocalConditions:
        """Where nothing was evaluated."""
        return cls(None, sp.ImmutableMatrix(sp.zeros(n, 0)), column([]), None)

    @property
    def reason(self) -> Reason:
        """The first condition that fails, before completeness of the Casimirs is considered."""
        if self.gradient is not True:
            return UNDECIDED if self.gradient is None else "invisible_gradient"
        return UNDECIDED if self.best is None else _REASONS[self.best.kind]


_REASONS: dict[Definiteness, Reason] = {
    "positive": "ok",
    "flat": "invisible_flat_curvature",
    "negative": "invisible_negative_curvature",
    UNDECIDED: UNDECIDED,
}


def is_equilibrium(loop: ClosedLoop, point: Mapping[sp.Symbol, sp.Expr]) -> bool | None:
    """Whether some constant u holds x*: (J − R)∇H(x*) lies in the image of G(x*)."""
    plant = loop.plant
    drift = at((plant.J - plant.R) * plant.grad_H, point)
    annihilator = kernel(sp.Matrix(at(plant.G, point)).T).T
    residual = [is_zero(entry) for entry in annihilator * drift]
    return False if False in residual else None if None in residual else True


def target_data(
    loop: ClosedLoop, casimirs: Casimirs, point: Mapping[sp.Symbol, sp.Expr]
) -> TargetDerivatives:
    """Derivatives at x*; Casimirs that are singular there are left out."""
    plant, z = loop.plant, loop.z
    columns, hessians, used = [], [], []
    for index, c in enumerate(casimirs.functions):
        slope = at(gradient(c, z), point)
        hessian = at(sparse_hessian(c, plant.x), point)
        entries = [*slope, *hessian.todok().values()]
        if all(is_finite(e) for e in entries):
            columns.append(slope)
            hessians.append(hessian)
            used.append(index)
    return TargetDerivatives(
        plant.x,
        loop.controller.xi,
        at(plant.grad_H, point),
        at(sparse_hessian(plant.H, plant.x), point),
        sp.ImmutableMatrix(sp.Matrix.hstack(*columns) if columns else sp.zeros(len(z), 0)),
        tuple(hessians),
        tuple(used),
        len(casimirs.functions),
    )


def local_conditions(data: TargetDerivatives) -> LocalConditions:
    """Gradient and curvature conditions at data without ξ."""
    n = len(data.x)
    N = sp.Matrix(data.grad_c)[:n, :]
    invisible = sp.ImmutableMatrix(kernel(N.T) if N.cols else sp.eye(n))
    slope = sp.ImmutableMatrix((invisible.T * data.grad_H).applyfunc(_constant))
    zeros = [is_zero(entry) for entry in slope]
    if not all(z is True for z in zeros):
        return LocalConditions(False if False in zeros else None, invisible, slope, None)
    lam, directions = _multipliers(N, sp.Matrix(data.grad_H))
    if lam is None:
        return LocalConditions(None, invisible, slope, None)
    forms = [_restricted(Q, invisible) for Q in (data.hess_H, *data.hess_c)]
    Q0 = _combined(forms[0], forms[1:], lam)
    family = [_combined(sp.zeros(*Q0.shape), forms[1:], list(d)) for d in directions]
    best = best_curvature(Q0, family, invisible.T * invisible)
    for tau, d in zip(best.tau, directions, strict=True):
        lam = [value + tau * e for value, e in zip(lam, d, strict=True)]
    final = sp.ImmutableMatrix(_combined(forms[0], forms[1:], lam))
    return LocalConditions(True, invisible, slope, tuple(lam), tuple(directions), final, best)


def _constant(entry: sp.Expr) -> sp.Expr:
    return sp.Integer(0) if entry.is_number and sign(entry) == 0 else entry


def _multipliers(N: sp.Matrix, gradient: sp.Matrix) -> tuple[list[sp.Expr] | None, list[sp.Matrix]]:
    """One λ with ∇H + Nλ = 0 (zero where it is free) and a basis of {λ : Nλ = 0}."""
    r = N.cols
    if gradient.is_zero_matrix and has_rank(N, r):
        return [sp.Integer(0)] * r, []
    rows = [i for i in range(N.rows) if any(N[i, j] != 0 for j in range(r))]
    augmented = N.extract(rows, list(range(r))).row_join(-gradient.extract(rows, [0]))
    reduced, pivots = reduced_rows(augmented)
    if r in pivots:
        return None, []
    lam: list[sp.Expr] = [sp.Integer(0)] * r
    for i, p in enumerate(pivots):
        lam[p] = reduced[i, r]
    basis = kernel(N.extract(rows, list(range(r)))) if rows else sp.eye(r)
    return lam, [basis[:, j] for j in range(basis.cols)]


def _restricted(Q: sp.MatrixBase, W: sp.MatrixBase) -> sp.Matrix:
    """WᵀQW; skips the products where W is a selection of coordinates or Q is zero."""
    if Q.is_zero_matrix:
        return sp.zeros(W.cols, W.cols)
    left = sp.SparseMatrix(W).T * sp.SparseMatrix(Q)
    return sp.Matrix(left * sp.SparseMatrix(W)).applyfunc(_constant)


def _combined(base: sp.Matrix, forms: Sequence[sp.Matrix], weights: Sequence[sp.Expr]) -> sp.Matrix:
    total = sp.Matrix(base)
    for form, weight in zip(forms, weights, strict=True):
        if weight != 0 and not form.is_zero_matrix:
            total += weight * form
    return total


def independent_at_every_xi(gradients: sp.Matrix) -> bool:
    """Whether the columns are proved to be independent for every ξ.

    One square part of simple rows is tried: its determinant must be a constant, or have one sign.
    """
    order = sorted(
        range(gradients.rows), key=lambda i: (sum(e.count_ops() for e in gradients.row(i)), i)
    )
    sorted_rows = gradients.extract(order, list(range(gradients.cols)))
    try:
        table = values(list(sorted_rows), 1)[0].reshape(sorted_rows.shape)
    except NoFiniteFieldValue:
        return False
    chosen = pivots(table.T)
    if len(chosen) < gradients.cols:
        return False
    minor = sorted_rows.extract(chosen, list(range(gradients.cols))).det(method="berkowitz")
    minor = sp.simplify(minor)
    if minor.free_symbols:
        return bool(minor.is_positive or minor.is_negative)
    return sign(minor) in (1, -1)


def constant_annihilator(N: sp.Matrix, xi: Sequence[sp.Symbol]) -> sp.Matrix:
    """Constant w with wᵀN(ξ) = 0 at every ξ tried, then kept only if that is proved."""
    samples = [at(N, random_point(xi, seed)).T for seed in range(2 * N.rows // max(1, N.cols) + 3)]
    basis = kernel(sp.Matrix.vstack(*[sp.Matrix(s) for s in samples]))
    kept = [
        basis[:, j]
        for j in range(basis.cols)
        if all(is_zero(entry) is True for entry in N.T * basis[:, j])
    ]
    return sp.Matrix.hstack(*kept) if kept else sp.zeros(N.rows, 0)
