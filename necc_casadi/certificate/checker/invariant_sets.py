"""Where the largest invariant set of E = {𝒢ᵀ∇V = 0, Rcl∇V = 0} is the critical points of V.

LaSalle: then every solution from a compact invariant set tends to the critical points in it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import sympy as sp
from flint import arb_mat

from necc_casadi.certificate.checker.arithmetic.balls import Box, ball, by_bisection, evaluate
from necc_casadi.certificate.checker.arithmetic.definite import middle_of, regular
from necc_casadi.certificate.checker.arithmetic.smooth import is_smooth_on
from necc_casadi.certificate.checker.model import StoredDesign
from necc_casadi.symbolic.zero import is_zero

__all__ = ["OverBox", "largest_invariant_set_is_critical", "loop_is_defined"]


#: How often a box may be halved before a test on it counts as failed.
_DEPTH = 14


def largest_invariant_set_is_critical(
    model: StoredDesign,
    resting: Sequence[int],
    place: OverBox | None,
    constants: OverBox | None = None,
) -> bool:
    """Whether solutions on which V stays constant are critical points of V, in a box of all states.

    There ∇V lies in ker [𝒢ᵀ; Rcl]. Of this matrix some rows are kept, with a kernel spanned by
    Q(z): a block of the rows is regular on the box, which leaves no room for more. Where Jcl Q
    moves resting states alone and is injective, while Q has no part in the states that it moves,
    these keep ∂V/∂s = 0 and so, ∂²H/∂s² ≻ 0 being proved, stay: ∇V = 0. For all of the space
    (None) only what is free of states counts; `constants` is a box of what else there is.
    """
    whole, states = place is None, set(model.z)
    if whole and model.Jcl.free_symbols & states:
        return False
    here = place or constants or OverBox(model.z, tuple((0.0, 0.0) for _ in model.z))
    seen = model.ports.T.col_join(model.Rcl)
    if whole:
        kept = [i for i in range(seen.rows) if not seen.row(i).free_symbols & states]
        seen = seen[kept, :]
    if not here.defined(sp.Matrix(model.Jcl - model.Rcl)):
        return False
    # rows of numbers first: one that depends on the state may vanish somewhere in the box
    order = sorted(range(seen.rows), key=lambda i: bool(seen.row(i).free_symbols))
    seen = seen[order, :]
    rows = here.independent(seen)
    Z = seen[rows, :]
    columns = here.independent(Z.T)
    if len(rows) != len(columns) or not here.regular(Z[:, columns]):
        return False
    Q = _kernel(Z, columns)
    if Q.cols == 0:
        return True
    motion = model.Jcl * Q
    moved = [i for i in range(motion.rows) if not all(is_zero(e) is True for e in motion.row(i))]
    carried = motion[moved, :]
    chosen = here.independent(carried)
    return (
        here.defined(Q)
        and all(is_zero(e) is True for e in Z * Q)
        and set(moved) <= set(resting)
        and all(is_zero(e) is True for i in moved for e in Q.row(i))
        and len(chosen) == Q.cols
        and here.regular(carried[chosen, :])
    )


def loop_is_defined(model: StoredDesign, box: Box) -> bool:
    """Whether energy, structure and Casimirs are smooth, as written, in a box of all states."""
    return is_smooth_on(model.written, model.z, box)


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


class OverBox:
    """Matrices of expressions over a box of all states."""

    def __init__(self, z: Sequence[sp.Symbol], box: Box) -> None:
        self.z, self.box = z, box

    def _enclosed(self, matrix: sp.Matrix, box: Box) -> arb_mat:
        values = {v: ball(*b) for v, b in zip(self.z, box, strict=True)}
        return arb_mat([[evaluate(e, values) for e in row] for row in matrix.tolist()])

    def _holds(self, matrix: sp.Matrix, test: Callable[[arb_mat], bool]) -> bool:
        """Whether a test holds all over the box; only states that occur are halved."""
        counts = [matrix.has(v) for v in self.z]
        return by_bisection(self.box, lambda b: test(self._enclosed(matrix, b)), _DEPTH, counts)

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
        """Whether a matrix is square and regular all over the box."""
        return matrix.rows == matrix.cols > 0 and self._holds(matrix, regular)
