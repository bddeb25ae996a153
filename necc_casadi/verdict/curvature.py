"""Definiteness of symmetric constant matrices and of Q(τ) = Q₀ + Σ τᵢQᵢ, decided exactly.

Floating point proposes (an eigenvector, a τ, a dual matrix), exact arithmetic or Arb balls
decide.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import sympy as sp

from necc_casadi.arrays import Vector
from necc_casadi.model.sizes import power_of_two
from necc_casadi.symbolic.definiteness import UNDECIDED, Definiteness, definiteness, rational
from necc_casadi.symbolic.floats import float_matrix, to_float
from necc_casadi.symbolic.linear_algebra import kernel, reduced_rows
from necc_casadi.symbolic.zero import Undecided, is_zero, sign

__all__ = ["Curvature", "best_curvature"]


_UNBOUNDED = 1e7  # a curvature beyond this multiple of the data is taken to have no ceiling


_SIMPLER_FIRST = (1, 10, 1000, 10**6, 10**30)  # denominators of τ; the last keeps every digit


@dataclass(frozen=True)
class Curvature:
    """What was decided on Q(τ) over all τ."""

    kind: Definiteness  # of the best τ
    tau: tuple[sp.Expr, ...]  # (s,) exact; where kind is positive, Q(τ) ≻ 0 is proved
    ceiling: float | None  # sup of the least eigenvalue, None: unbounded
    direction: sp.ImmutableMatrix | None = None  # k × 1, where it is negative or flat
    value: sp.Expr | None = None  # curvature along `direction`


def best_curvature(
    Q0: sp.Matrix, directions: Sequence[sp.Matrix], metric: sp.MatrixBase
) -> Curvature:
    """The best definiteness of Q(τ) = Q₀ + Σ τᵢQᵢ over τ.

    Parameters
    ----------
    Q0, directions
        k × k constant symmetric matrices.
    metric
        k × k Gram matrix WᵀW: eigenvalues are those of W made orthonormal.
    """
    if Q0.rows == 0:
        return Curvature("positive", (sp.Integer(0),) * len(directions), None)
    whiten = np.linalg.inv(np.linalg.cholesky(float_matrix(metric)))
    zero = (sp.Integer(0),) * len(directions)
    beyond = [e for e in Q0 if not np.isfinite(to_float(e))]
    if beyond:
        raise Undecided(beyond[0])
    if all(Q.is_zero_matrix for Q in directions):
        kind, vector = definiteness(Q0)
        least = float(np.linalg.eigvalsh(whiten @ float_matrix(Q0) @ whiten.T)[0])
        return Curvature(kind, zero, least, vector, _along(Q0, vector))
    return _over_family(Q0, directions, whiten)


def _along(Q: sp.Matrix, vector: sp.MatrixBase | None) -> sp.Expr | None:
    return None if vector is None else (vector.T * Q * vector)[0] / (vector.T * vector)[0]


def _over_family(Q0: sp.Matrix, directions: Sequence[sp.Matrix], whiten: Vector) -> Curvature:
    numeric = [whiten @ float_matrix(Q) @ whiten.T for Q in (Q0, *directions)]
    sizes = [power_of_two(float(np.abs(Q).max()) or 1.0) for Q in numeric]
    scaled = [Q / size for Q, size in zip(numeric, sizes, strict=True)]
    tau, ceiling, dual = _maximise_least_eigenvalue(scaled[0], scaled[1:])
    tau = tau * sizes[0] / np.array(sizes[1:])
    ceiling = None if ceiling is None else ceiling * sizes[0]
    proposals = [np.zeros(len(directions)), tau]
    for proposal in proposals:
        for denominator in _SIMPLER_FIRST:
            exact = tuple(rational(float(t), denominator) for t in proposal)
            kind, _ = definiteness(_member(Q0, directions, exact))
            if kind == "positive":
                return Curvature(kind, exact, ceiling)
    exact = tuple(rational(float(t), 1000) for t in tau)
    obstacle = _vector_obstacle(Q0, directions)
    if obstacle is not None:
        vector, value = obstacle
        if sign(value) == -1:
            return Curvature("negative", exact, ceiling, vector, value)
        if not _dual_obstacle(Q0, directions, whiten.T @ dual @ whiten):
            return Curvature("flat", exact, ceiling, vector, value)
        return Curvature("negative", exact, ceiling)
    if _dual_obstacle(Q0, directions, whiten.T @ dual @ whiten):
        return Curvature("negative", exact, ceiling)
    return Curvature(UNDECIDED, exact, ceiling)


def _member(Q0: sp.Matrix, directions: Sequence[sp.Matrix], tau: Sequence[sp.Expr]) -> sp.Matrix:
    total = sp.Matrix(Q0)
    for t, Q in zip(tau, directions, strict=True):
        total += t * sp.Matrix(Q)
    return total


def _vector_obstacle(
    Q0: sp.Matrix, directions: Sequence[sp.Matrix]
) -> tuple[sp.ImmutableMatrix, sp.Expr] | None:
    """A vector w with wᵀQᵢw = 0 for i ≥ 1 and wᵀQ₀w ≤ 0: no τ makes Q(τ) ≻ 0."""
    size = Q0.rows
    stacked = sp.Matrix.vstack(*[sp.Matrix(Q) for Q in directions])
    shared = kernel(stacked)
    candidates: list[sp.MatrixBase] = [
        sp.Matrix([int(k == i) for k in range(size)]) for i in range(size)
    ]
    if shared.cols:
        kind, vector = definiteness(shared.T * sp.Matrix(Q0) * shared)
        if kind in ("negative", "flat") and vector is not None:
            candidates.insert(0, shared * vector)
    flat = None
    for w in candidates:
        if all(is_zero((w.T * Q * w)[0]) for Q in directions):
            value = (w.T * Q0 * w)[0] / (w.T * w)[0]
            if sign(value) == -1:
                return sp.ImmutableMatrix(w), value
            if sign(value) == 0:
                flat = flat or (sp.ImmutableMatrix(w), sp.Integer(0))
    return flat


def _dual_obstacle(Q0: sp.Matrix, directions: Sequence[sp.Matrix], dual: Vector) -> bool:
    """Whether an exact Z ≻ 0 near `dual` has ⟨Z, Qᵢ⟩ = 0 and ⟨Z, Q₀⟩ < 0: then no τ works."""
    scale = float(np.abs(dual).max()) or 1.0
    size = Q0.rows
    even = (dual + dual.T) / (2 * scale)
    Z = sp.Matrix(size, size, lambda i, j: rational(float(even[i, j]), 10**9))
    gram = sp.Matrix([[_inner(P, Q) for Q in directions] for P in directions])
    reduced, pivots = reduced_rows(gram.row_join(sp.Matrix([_inner(Z, Q) for Q in directions])))
    if len(directions) in pivots:
        return False
    for i, p in enumerate(pivots):
        Z = Z - reduced[i, len(directions)] * sp.Matrix(directions[p])
    if not all(is_zero(_inner(Z, Q)) for Q in directions):
        return False
    return sign(_inner(Z, Q0)) == -1 and definiteness(Z)[0] == "positive"


def _inner(P: sp.Matrix, Q: sp.Matrix) -> sp.Expr:
    return sp.Add(*[value * Q[i, j] for (i, j), value in P.todok().items()])


def _maximise_least_eigenvalue(
    Q0: Vector, directions: Sequence[Vector]
) -> tuple[Vector, float | None, Vector]:
    """(τ, sup of λ_min(Q(τ)) or None where unbounded, dual Z with trace 1) by a barrier method.

    The matrices are given with entries of order 1.

    References
    ----------
    Vandenberghe and Boyd (1996).
    """
    size, Q = len(Q0), np.array(directions)
    data = max(1.0, float(np.abs(Q0).max()))
    tau, t = np.zeros(len(directions)), float(np.linalg.eigvalsh(Q0)[0]) - data
    dual, mu = np.eye(size) / size, data
    while mu * size > 1e-10 * data:
        for _ in range(30):
            slack = Q0 + np.tensordot(tau, Q, 1) - t * np.eye(size)
            try:
                dual = np.asarray(mu * np.linalg.inv(slack), dtype=np.float64)
                step, decrement = _newton_step(dual, Q, mu)
                length = _feasible_length(slack, Q, step)
            except np.linalg.LinAlgError:  # as close to the boundary as rounding allows
                return tau, float(t), dual / np.trace(dual)
            tau, t = tau + length * step[:-1], t + length * float(step[-1])
            if t > _UNBOUNDED * data:
                return tau, None, dual
            if decrement < 1e-6 * mu:
                break
        mu /= 4
    return tau, float(t), dual / np.trace(dual)


def _newton_step(dual: Vector, Q: Vector, mu: float) -> tuple[Vector, float]:
    """Newton step in (τ, t) for t + μ log det(Q(τ) − tI), and its decrement; dual = μ(Q − tI)⁻¹."""
    count = len(Q)
    parts = [dual @ D for D in (*Q, -np.eye(len(dual)))]
    gradient = np.array([np.trace(P) for P in parts])
    gradient[-1] += 1.0
    hessian = np.array([[np.sum(P * S.T) for S in parts] for P in parts]) / mu
    # a direction of no curvature is followed, far, if the gradient points along it: no ceiling
    hessian[:count, :count] += 1e-12 * np.diag(hessian).max() * np.eye(count)
    step: Vector = np.asarray(np.linalg.lstsq(hessian, gradient, rcond=1e-15)[0], dtype=float)
    return step, float(gradient @ step)


def _feasible_length(slack: Vector, Q: Vector, step: Vector) -> float:
    """A step length that keeps slack + length·change ≻ 0 with room to spare."""
    change = np.tensordot(step[:-1], Q, 1) - step[-1] * np.eye(len(slack))
    root = np.linalg.inv(np.linalg.cholesky(slack))
    lowest = float(np.linalg.eigvalsh(root @ change @ root.T)[0])
    return 1.0 if lowest >= -0.5 else -0.7 / lowest if lowest < -0.7 else 0.9
