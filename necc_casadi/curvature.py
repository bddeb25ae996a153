"""Definiteness of symmetric constant matrices and of Q(τ) = Q₀ + Σ τᵢQᵢ, decided exactly.

Floating point proposes (an eigenvector, a τ, a dual matrix), exact arithmetic or Arb balls
decide. What cannot be decided is ``undecided``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import flint
import numpy as np
import numpy.typing as npt
import sympy as sp

from necc_casadi import exact as ex
from necc_casadi.specialise import ball

__all__ = ["Curvature", "best_curvature", "definiteness"]

Array = npt.NDArray[np.float64]
_UNBOUNDED = 1e7  # a curvature beyond this multiple of the data is taken to have no ceiling


@dataclass(frozen=True)
class Curvature:
    """What was decided on Q(τ) over all τ."""

    kind: str  # positive | flat | negative | undecided; of the best τ
    tau: tuple[sp.Expr, ...]  # (s,) exact; where kind is positive, Q(τ) ≻ 0 is proved
    ceiling: float | None  # sup of the least eigenvalue, None: unbounded
    direction: sp.ImmutableMatrix | None = None  # k × 1, where it is negative or flat
    value: sp.Expr | None = None  # curvature along `direction`


def definiteness(matrix: sp.Matrix) -> tuple[str, sp.ImmutableMatrix | None]:
    """Kind of a constant symmetric matrix, and a direction that shows it.

    ``positive`` (definite), ``flat`` (⪰ 0, singular; a kernel vector), ``negative`` (indefinite
    or worse; a vector w with wᵀQw < 0) or ``undecided``.
    """
    results = []
    for block in ex.blocks(matrix):
        kind, vector = _block_definiteness(matrix.extract(block, block))
        if vector is not None:
            full = sp.zeros(matrix.rows, 1)
            for k, i in enumerate(block):
                full[i] = vector[k]
            vector = sp.ImmutableMatrix(full)
        results.append((kind, vector))
    for kind in ("negative", "undecided", "flat"):
        for result in results:
            if result[0] == kind:
                return result
    return "positive", None


def _block_definiteness(block: sp.Matrix) -> tuple[str, sp.Matrix | None]:
    for i in range(block.rows):
        if ex.sign(block[i, i]) == -1:
            return "negative", sp.Matrix([int(k == i) for k in range(block.rows)])
    if _balls_positive(block):
        return "positive", None
    numeric = to_float(block)
    if not np.all(np.isfinite(numeric)):
        return "undecided", None
    eigenvalues, vectors = np.linalg.eigh(numeric)
    scale = max(1.0, float(np.abs(eigenvalues).max()))
    if eigenvalues[0] < -1e-9 * scale:
        vector = _rational_vector(vectors[:, 0])
        if ex.sign((vector.T * block * vector)[0]) == -1:
            return "negative", vector
    if eigenvalues[0] < 1e-9 * scale:
        return _semidefinite(block)
    return "undecided", None


def _rational_vector(vector: Array) -> sp.Matrix:
    """A nearby rational vector, as simple as 1 % of its largest entry allows."""
    scaled = vector / vector[np.argmax(np.abs(vector))]
    return sp.Matrix([_rational(float(v), 1000) for v in scaled])


def _rational(value: float, denominator: int) -> sp.Rational:
    fraction = Fraction(float(value)).limit_denominator(denominator)
    return sp.Rational(fraction.numerator, fraction.denominator)


def _balls_positive(block: sp.Matrix) -> bool:
    """Whether an Arb LDLᵀ has certainly positive pivots."""
    previous, flint.ctx.prec = flint.ctx.prec, 256
    try:
        known: dict[sp.Expr, Any] = {}
        rows = [[ball(e, known) for e in row] for row in block.tolist()]
        for i in range(len(rows)):
            if not rows[i][i] > 0:
                return False
            for j in range(i + 1, len(rows)):
                if not rows[j][i].is_zero():
                    factor = rows[j][i] / rows[i][i]
                    for k in range(i, len(rows)):
                        rows[j][k] = rows[j][k] - factor * rows[i][k]
    finally:
        flint.ctx.prec = previous
    return True


def _semidefinite(block: sp.Matrix) -> tuple[str, sp.Matrix | None]:
    """Exact symmetric elimination of a block whose least eigenvalue is close to zero."""
    kernel = ex.kernel(block)
    if kernel.cols == 0:
        return "undecided", None
    verdict = ex.is_positive_semidefinite(block)
    return ("flat", kernel[:, 0]) if verdict is True else ("undecided", None)


def to_float(matrix: sp.Matrix) -> Array:
    """A constant matrix in floating point; NaN where an entry is not finite."""
    result = np.zeros(matrix.shape)
    for (i, j), entry in matrix.todok().items():
        value = sp.N(entry, 17)
        result[i, j] = float(value) if value.is_real and value.is_finite else np.nan
    return result


def best_curvature(Q0: sp.Matrix, directions: Sequence[sp.Matrix], metric: sp.Matrix) -> Curvature:
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
    whiten = np.linalg.inv(np.linalg.cholesky(to_float(metric)))
    zero = (sp.Integer(0),) * len(directions)
    if all(Q.is_zero_matrix for Q in directions):
        kind, vector = definiteness(Q0)
        least = float(np.linalg.eigvalsh(whiten @ to_float(Q0) @ whiten.T)[0])
        return Curvature(kind, zero, least, vector, _along(Q0, vector))
    return _over_family(Q0, directions, whiten)


def _along(Q: sp.Matrix, vector: sp.Matrix | None) -> sp.Expr | None:
    return None if vector is None else (vector.T * Q * vector)[0] / (vector.T * vector)[0]


def _over_family(Q0: sp.Matrix, directions: Sequence[sp.Matrix], whiten: Array) -> Curvature:
    numeric = [whiten @ to_float(Q) @ whiten.T for Q in (Q0, *directions)]
    tau, ceiling, dual = _maximise_least_eigenvalue(numeric[0], numeric[1:])
    proposals = [np.zeros(len(directions)), tau]
    for proposal in proposals:
        for denominator in (1, 10, 1000, 10**6):
            exact = tuple(_rational(float(t), denominator) for t in proposal)
            kind, _ = definiteness(_member(Q0, directions, exact))
            if kind == "positive":
                return Curvature(kind, exact, ceiling)
    exact = tuple(_rational(float(t), 1000) for t in tau)
    obstacle = _vector_obstacle(Q0, directions)
    if obstacle is not None:
        vector, value = obstacle
        kind = "negative" if ex.sign(value) == -1 else "flat"
        if kind == "negative" or not _dual_obstacle(Q0, directions, whiten.T @ dual @ whiten):
            return Curvature(kind, exact, ceiling, vector, value)
        return Curvature("negative", exact, ceiling)
    if _dual_obstacle(Q0, directions, whiten.T @ dual @ whiten):
        return Curvature("negative", exact, ceiling)
    return Curvature("undecided", exact, ceiling)


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
    shared = ex.kernel(stacked)
    candidates = [sp.Matrix([int(k == i) for k in range(size)]) for i in range(size)]
    if shared.cols:
        kind, vector = definiteness(shared.T * sp.Matrix(Q0) * shared)
        if kind in ("negative", "flat") and vector is not None:
            candidates.insert(0, shared * vector)
    flat = None
    for w in candidates:
        if all(ex.is_zero((w.T * Q * w)[0]) for Q in directions):
            value = (w.T * Q0 * w)[0] / (w.T * w)[0]
            if ex.sign(value) == -1:
                return sp.ImmutableMatrix(w), value
            if ex.sign(value) == 0:
                flat = flat or (sp.ImmutableMatrix(w), sp.Integer(0))
    return flat


def _dual_obstacle(Q0: sp.Matrix, directions: Sequence[sp.Matrix], dual: Array) -> bool:
    """Whether an exact Z ≻ 0 near `dual` has ⟨Z, Qᵢ⟩ = 0 and ⟨Z, Q₀⟩ < 0: then no τ works."""
    scale = float(np.abs(dual).max()) or 1.0
    size = Q0.rows
    even = (dual + dual.T) / (2 * scale)
    Z = sp.Matrix(size, size, lambda i, j: _rational(float(even[i, j]), 10**9))
    gram = sp.Matrix([[_inner(P, Q) for Q in directions] for P in directions])
    reduced, pivots = ex.reduced_rows(gram.row_join(sp.Matrix([_inner(Z, Q) for Q in directions])))
    if len(directions) in pivots:
        return False
    for i, p in enumerate(pivots):
        Z = Z - reduced[i, len(directions)] * sp.Matrix(directions[p])
    if not all(ex.is_zero(_inner(Z, Q)) for Q in directions):
        return False
    return ex.sign(_inner(Z, Q0)) == -1 and definiteness(Z)[0] == "positive"


def _inner(P: sp.Matrix, Q: sp.Matrix) -> sp.Expr:
    return sp.Add(*[value * Q[i, j] for (i, j), value in P.todok().items()])


def _maximise_least_eigenvalue(
    Q0: Array, directions: Sequence[Array]
) -> tuple[Array, float | None, Array]:
    """(τ, sup of λ_min(Q(τ)) or None where unbounded, dual Z with trace 1) by a barrier method."""
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


def _newton_step(dual: Array, Q: Array, mu: float) -> tuple[Array, float]:
    """Newton step in (τ, t) for t + μ log det(Q(τ) − tI), and its decrement; dual = μ(Q − tI)⁻¹."""
    count = len(Q)
    parts = [dual @ D for D in (*Q, -np.eye(len(dual)))]
    gradient = np.array([np.trace(P) for P in parts])
    gradient[-1] += 1.0
    hessian = np.array([[np.sum(P * S.T) for S in parts] for P in parts]) / mu
    hessian[:count, :count] += 1e-14 * np.eye(count)
    step: Array = np.asarray(np.linalg.lstsq(hessian, gradient, rcond=1e-13)[0], dtype=float)
    return step, float(gradient @ step)


def _feasible_length(slack: Array, Q: Array, step: Array) -> float:
    """A step length that keeps slack + length·change ≻ 0 with room to spare."""
    change = np.tensordot(step[:-1], Q, 1) - step[-1] * np.eye(len(slack))
    root = np.linalg.inv(np.linalg.cholesky(slack))
    lowest = float(np.linalg.eigvalsh(root @ change @ root.T)[0])
    return 1.0 if lowest >= -0.5 else -0.7 / lowest if lowest < -0.7 else 0.9
