"""Plant states that are at rest in a region: their share of H, their reach, and what they hide."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import sympy as sp
from flint import arb, arb_mat

from necc_casadi import exact as ex
from necc_casadi.certificate.ball_matrices import middle_of, positive
from necc_casadi.certificate.balls import Box, ball, ends, evaluate, everywhere
from necc_casadi.certificate.check_model import Model

__all__ = ["at_rest", "invariant_points", "loop_is_defined", "momentum_inside"]

#: How often a box may be halved before a test on it counts as failed.
_DEPTH = 14


def at_rest(model: Model, resting: Sequence[int]) -> bool:
    """H = ½ sᵀA(y)s + U(y) in the resting plant states s, which no Casimir contains."""
    s = [model.z[i] for i in resting]
    zero = dict.fromkeys(s, 0)
    if any(i >= model.n for i in resting) or any(c.has(*s) for c in model.casimirs if s):
        return False
    A = sp.hessian(model.H, s) if s else sp.zeros(0)
    kinetic = (sp.Matrix([s]) * A * sp.Matrix(s))[0] / 2 if s else sp.Integer(0)
    flat = all(ex.is_zero(sp.diff(a, v)) is True for a in A for v in s)
    return flat and ex.is_zero(model.H - model.H.subs(zero) - kinetic) is True


def momentum_inside(
    model: Model, i: int, resting: Sequence[int], active: Sequence[int], level: float, bottom: arb
) -> bool:
    """½ δ sᵀA(y)s > c − V(z̄) wherever the resting state i leaves the domain, and A ≻ 0."""
    bounds = model.bounds()
    lo, hi = bounds[i]
    reach = (-lo).min(hi)
    if not reach > 0:
        return False
    needed, k = 2 * (level - bottom) / (model.delta * reach * reach), resting.index(i)
    A = sp.hessian(model.H, [model.z[j] for j in resting])
    cube = tuple((ends(bounds[j][0])[0], ends(bounds[j][1])[1]) for j in active)
    variables = [model.z[j] for j in active]

    def stiff(box: Box) -> bool:
        values = {v: ball(*b) for v, b in zip(variables, box, strict=True)}
        matrix = arb_mat([[evaluate(e, values) for e in row] for row in A.tolist()])
        matrix[k, k] = matrix[k, k] - needed
        return positive(matrix, 0)

    return everywhere(cube, stiff, _DEPTH, [A.has(v) for v in variables])


def invariant_points(model: Model, resting: Sequence[int], box: Box | None) -> bool:
    """Whether solutions on which V stays constant are critical points of V, in a box of all states.

    There ∇V lies in ker [𝒢ᵀ; Rcl]. Of this matrix some rows are kept, with a kernel spanned by
    Q(z): a block of the rows is regular on the box, which leaves no room for more. Where Jcl Q
    moves resting states alone and is injective, while Q has no part in the states that it moves,
    these keep ∂V/∂s = 0 and so, ∂²H/∂s² ≻ 0 being proved, stay: ∇V = 0. For all of the space
    (None) only what is constant counts.
    """
    if box is None and (model.Jcl.free_symbols or model.ports.free_symbols):
        return False
    here = _Here(model, box)
    seen = model.ports.T.col_join(model.Rcl)
    if box is None:
        seen = seen[[i for i in range(seen.rows) if not seen.row(i).free_symbols], :]
    if not here.defined(sp.Matrix(model.Jcl - model.Rcl)):
        return False
    rows = here.independent(seen)
    Z = seen[rows, :]
    columns = here.independent(Z.T)
    if len(rows) != len(columns) or not here.regular(Z[:, columns]):
        return False
    Q = _kernel(Z, columns)
    if Q.cols == 0:
        return True
    motion = model.Jcl * Q
    moved = [i for i in range(motion.rows) if not all(ex.is_zero(e) is True for e in motion.row(i))]
    carried = motion[moved, :]
    chosen = here.independent(carried)
    return (
        here.defined(Q)
        and all(ex.is_zero(e) is True for e in Z * Q)
        and set(moved) <= set(resting)
        and all(ex.is_zero(e) is True for i in moved for e in Q.row(i))
        and len(chosen) == Q.cols
        and here.regular(carried[chosen, :])
    )


def loop_is_defined(model: Model, box: Box) -> bool:
    """Whether the loop has no pole in a box of all states, where V itself may well be smooth."""
    here = _Here(model, box)
    return here.defined(sp.Matrix(model.Jcl - model.Rcl)) and here.defined(model.ports)


def _kernel(Z: sp.Matrix, columns: Sequence[int]) -> sp.Matrix:
    """Vectors that Z sends to 0, one per column that is not in its regular block."""
    others = [j for j in range(Z.cols) if j not in columns]
    Q = sp.zeros(Z.cols, len(others))
    for k, j in enumerate(others):
        Q[j, k] = 1
    coupling = Z[:, others]
    if any(e != 0 for e in coupling):
        solved = -Z[:, list(columns)].LUsolve(coupling)
        for i, j in enumerate(columns):
            Q[j, :] = solved[i, :]
    return Q


class _Here:
    """Matrices of expressions over a box, or where they are constant."""

    def __init__(self, model: Model, box: Box | None) -> None:
        self.z = model.z
        self.box: Box = tuple((0.0, 0.0) for _ in self.z) if box is None else box

    def _enclosed(self, matrix: sp.Matrix, box: Box) -> arb_mat:
        values = {v: ball(*b) for v, b in zip(self.z, box, strict=True)}
        return arb_mat([[evaluate(e, values) for e in row] for row in matrix.tolist()])

    def _holds(self, matrix: sp.Matrix, test: Callable[[arb_mat], bool]) -> bool:
        """Whether a test holds all over the box; only states that occur are halved."""
        counts = [matrix.has(v) for v in self.z]
        return everywhere(self.box, lambda b: test(self._enclosed(matrix, b)), _DEPTH, counts)

    def defined(self, matrix: sp.Matrix) -> bool:
        """Whether every entry is finite."""
        return all(
            self._holds(sp.Matrix([[e]]), lambda A: bool(A[0, 0].is_finite())) for e in set(matrix)
        )

    def independent(self, matrix: sp.Matrix) -> list[int]:
        """Rows that look independent at the middle: a guess, whose regular block is the proof."""
        at: Box = tuple((lo / 2 + hi / 2,) * 2 for lo, hi in self.box)
        A = middle_of(self._enclosed(matrix, at))
        kept: list[int] = []
        for i in range(len(A) if np.isfinite(A).all() else 0):
            if np.linalg.matrix_rank(A[[*kept, i]], tol=1e-9 * np.abs(A).max()) > len(kept):
                kept.append(i)
        return kept

    def regular(self, matrix: sp.Matrix) -> bool:
        """Whether a square matrix is invertible: nearly the identity after its middle's inverse."""
        if matrix.rows != matrix.cols:
            return False
        return self._holds(matrix, _invertible)


def _invertible(A: arb_mat) -> bool:
    middle = middle_of(A)
    if not np.isfinite(middle).all():
        return False
    try:
        near = (arb_mat(np.linalg.inv(middle).tolist()) * A).tolist()
    except np.linalg.LinAlgError:
        return False
    return all(
        bool(sum((abs(v - int(i == j)) for j, v in enumerate(row)), arb(0)) < 1)
        for i, row in enumerate(near)
    )
