"""The smooth nonlinear programs of eq. Loss."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise

import casadi as ca
import numpy as np

from necc_casadi.arrays import Vector
from necc_casadi.cases import Mode
from necc_casadi.synthesis.lifting import Lifting

__all__ = ["Program", "asked_matrix", "hard_program", "is_in_reach", "soft_program", "with_level"]


#: A fixed entry of ∇V(z*) below this, in natural units, is rounding.
_ZERO = 1e-12


@dataclass(frozen=True, eq=False)
class Program:
    """Objective and constraints in the lifted variables and extra ones; networks come later."""

    mode: Mode
    extra: ca.SX  # variables besides the lifted ones
    lower: Vector  # lower bounds of `extra`
    objective: ca.SX
    equalities: ca.SX  # = 0
    inequalities: ca.SX  # ≥ 0
    initial: Callable[[Vector], Vector]  # lifted variables -> start of `extra`


def asked_matrix(a: float | Vector, size: int) -> Vector:
    """What ∇²V(z*) is to exceed, (size, size), from a number, a diagonal or itself."""
    a = np.asarray(a, float)
    return a if a.ndim == 2 else np.diag(np.broadcast_to(a, (size,)))


def is_in_reach(lifting: Lifting, asked: Vector) -> bool:
    """Whether what no weight moves of ∇V(z*) and ∇²V(z*) is as asked."""
    return _movable_rows(lifting, asked) is not None


def hard_program(
    lifting: Lifting, asked: Vector, stiffness: tuple[float, ...] | None
) -> Program | None:
    """∇V(z*) = 0, ∇²V(z*) − asked = LLᵀ; None where no weight can satisfy that."""
    movable = _movable_rows(lifting, asked_matrix(asked, lifting.g.numel()))
    if movable is None:
        return None
    g, S, rows = movable
    pattern = _block_pattern(S)
    L, entries = _lower(pattern)
    P = lifting.scales.stiffness[rows]
    gap = ca.vertcat(*[(S - L @ L.T)[i, j] for i, j in pattern])
    value = ca.Function("S", [lifting.small], [S])
    reference = np.diag(P)
    if stiffness is not None:  # the quadratic parts are the reference: no network undoes them
        stiff = np.asarray(value(lifting.quadratic_only(stiffness)), float)
        reference = stiff if np.linalg.eigvalsh(stiff)[0] > 0 else reference
    inverse = ca.sparsify(ca.DM(np.linalg.inv(reference)))
    shape = ca.dot(inverse, L @ L.T) - 2 * ca.sum1(ca.log(ca.diag(L)))
    diagonal = np.array([i == j for i, j in pattern], bool)
    return Program(
        mode="hard",
        extra=entries,
        lower=np.where(diagonal, 1e-8 * np.sqrt(P.max(initial=1.0)), -np.inf),
        objective=shape,
        equalities=ca.vertcat(g, gap),
        inequalities=ca.SX(0, 1),
        initial=lambda small: _on(pattern, _factor(np.asarray(value(small), float), P)),
    )


def _movable_rows(lifting: Lifting, asked: Vector) -> tuple[ca.SX, ca.SX, list[int]] | None:
    """(rows of g, Schur complement of N − asked, its indices) that the design can move."""
    g, N, small = lifting.g, lifting.N, lifting.small
    n = g.numel()
    moves = ca.which_depends(ca.densify(ca.vertcat(g, ca.vec(N))), small, 1, True)
    fixed_g = [i for i in range(n) if not moves[i]]
    rows = [i for i in range(n) if any(moves[n + i * n : n + (i + 1) * n])]
    rest = [i for i in range(n) if i not in rows]
    w_hat = lifting.form.initial(np.random.default_rng(0))
    g0, N0 = lifting.at(lifting.small_at(w_hat, lifting.guess))
    size = lifting.scales.energy / lifting.scales.state
    if np.any(np.abs(g0[fixed_g]) > _ZERO * size[fixed_g]):
        return None
    gap = N0 - asked
    A = gap[np.ix_(rest, rest)]
    if len(rest) and np.linalg.eigvalsh(A)[0] <= 0:
        return None
    B = gap[np.ix_(rest, rows)]
    S = N[rows, rows] - _sparse(asked[np.ix_(rows, rows)])
    if B.any():
        S -= ca.sparsify(ca.DM(B.T @ np.linalg.solve(A, B)))
    return ca.vertcat(*[g[i] for i in range(n) if moves[i]]), ca.sparsify(S), rows


def soft_program(lifting: Lifting, asked: Vector, _: tuple[float, ...] | None) -> Program:
    """Minimise s + t with ∇V(z*) = s w, wᵀw ≤ 1, ∇²V(z*) + tI − asked = LLᵀ: ε exactly."""
    n = lifting.g.numel()
    asked = asked_matrix(asked, n)
    s, t, w = ca.SX.sym("s"), ca.SX.sym("t"), ca.SX.sym("w", n)
    pattern = _block_pattern(lifting.N)
    L, entries = _lower(pattern)
    shifted = lifting.N + t * ca.SX.eye(n) - _sparse(asked)
    gap = ca.vertcat(*[(shifted - L @ L.T)[i, j] for i, j in pattern])

    def initial(small: Vector) -> Vector:
        g0, N0 = lifting.at(small)
        s0 = max(float(np.linalg.norm(g0)), 1e-3)
        t0 = max(0.0, -np.linalg.eigvalsh(N0 - asked)[0]) + 0.1 * np.diag(asked).max()
        factor = np.asarray(np.linalg.cholesky(N0 + t0 * np.eye(n) - asked), float)
        return np.concatenate([[s0, t0], g0 / s0, _on(pattern, factor)])

    return Program(
        mode="soft",
        extra=ca.vertcat(s, t, w, entries),
        lower=np.concatenate([[0.0, 0.0], np.full(n + len(pattern), -np.inf)]),
        objective=s + t,
        equalities=ca.vertcat(lifting.g - s * w, gap),
        inequalities=1 - ca.sumsqr(w),
        initial=initial,
    )


def _sparse(matrix: Vector) -> ca.SX:
    """Numbers, without those that are zero: they tie no block to another."""
    return ca.SX(ca.sparsify(ca.DM(matrix)))


def _block_pattern(S: ca.SX) -> list[tuple[int, int]]:
    """Lower-triangular entries of the diagonal blocks of S, dense within each block."""
    size = S.shape[0]
    pattern = S.sparsity().unite(ca.Sparsity.diag(size))
    _, order, ends = pattern.scc() if size else (0, [], [0])
    blocks = [sorted(order[a:b]) for a, b in pairwise(ends)]
    return [(i, j) for block in blocks for i in block for j in block if j <= i]


def _lower(pattern: list[tuple[int, int]]) -> tuple[ca.SX, ca.SX]:
    """A lower-triangular matrix of symbols on `pattern`, and the vector of its entries."""
    size = 1 + max((i for i, _ in pattern), default=-1)
    entries = ca.SX.sym("l", len(pattern))
    L = ca.SX(size, size)
    for index, (i, j) in enumerate(pattern):
        L[i, j] = entries[index]
    return L, entries


def _on(pattern: list[tuple[int, int]], matrix: Vector) -> Vector:
    """The entries of `matrix` on `pattern`."""
    return np.array([matrix[i, j] for i, j in pattern], float)


def _factor(S: Vector, P: Vector) -> Vector:
    """A nonsingular Cholesky factor to start from: of S, its eigenvalues relative to P lifted."""
    root = np.sqrt(P)
    values, vectors = np.linalg.eigh(S / np.outer(root, root)) if len(P) else (P, np.eye(0))
    lifted = (vectors * np.maximum(values, 0.1)) @ vectors.T * np.outer(root, root)
    return np.linalg.cholesky(lifted)


def with_level(program: Program) -> Program:
    """The program with the level c as its last variable; where it starts is set later."""
    return replace(
        program,
        extra=ca.vertcat(program.extra, ca.SX.sym("c")),
        lower=np.append(program.lower, -np.inf),
        initial=lambda small: np.append(program.initial(small), 0.0),
    )
