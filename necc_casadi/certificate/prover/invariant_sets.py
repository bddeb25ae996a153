"""Where the largest invariant set of E = {𝒢ᵀ∇V = 0, Rcl∇V = 0} is the critical points of V.

On E, w = ∇V(z) lies in N(z) = ker [𝒢ᵀ; Rcl](z) and ż = Jcl w/Φ₁. Let S be the momenta (see
momenta.py), H = ½ sᵀA(y)s + U(y) with A ≻ 0, which no Casimir contains, and let M ⊂ S be such
that for every z in a box that holds Ω and every w in N(z)

(a) wᵢ = 0 for i in M,   (b) (Jcl w)ᵢ = 0 for i not in M,   (c) Jcl w = 0 only for w = 0.

A solution that stays in E ∩ Ω moves only the momenta of M by (b), and by (a) it keeps
∂V/∂s_M = Φ₁ (A(y)s)_M = 0. With y and the other momenta at rest, A_MM ṡ_M = 0, hence ṡ_M = 0 since
A_MM ≻ 0: the solution is at rest, Jcl w = 0, and by (c) w = 0. Conversely critical points are at
rest. By LaSalle every solution from a compact invariant Ω tends to the critical points in it.

Proof of (a)–(c): rows Z of [𝒢ᵀ; Rcl] and a matrix B(z) with ZB ≡ 0 are found such that a square
block of Z with dim z − cols B columns, and a square block of Jcl B with cols B rows, are regular
all over the box. Then B(z) spans ker Z(z) ⊃ N(z), (c) holds, and (a), (b) are identities in z.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import sympy as sp

from necc_casadi.arrays import Vector
from necc_casadi.certificate.prover.arithmetic.boxes import matrix_enclosure, subdivide
from necc_casadi.certificate.prover.arithmetic.definite import regular
from necc_casadi.certificate.prover.arithmetic.intervals import Interval
from necc_casadi.certificate.prover.arithmetic.smooth import is_smooth_on, written
from necc_casadi.designs.design import Design
from necc_casadi.symbolic.linear_algebra import kernel
from necc_casadi.symbolic.zero import is_zero

__all__ = ["OverBox", "largest_invariant_set_is_critical", "loop_is_defined"]


#: Cells on which a matrix that depends on the state is bounded, in all.
_CELLS = 4096


#: Pivots below this share of the largest entry count as zero: they only steer the choice of rows.
_SMALL = 1e-8


def largest_invariant_set_is_critical(
    design: Design,
    resting: Sequence[int],
    place: OverBox | None = None,
    constants: OverBox | None = None,
) -> bool:
    """Whether (a)–(c) are proved in a box of all states, on the whole space for None.

    For the whole space only rows that are free of states count; `constants` is then a box of what
    else the loop depends on. False means: not proved.
    """
    loop = design.loop
    whole, states = place is None, set(loop.z)
    if whole and loop.J.free_symbols & states:
        return False
    nowhere = Interval(np.zeros(loop.n), np.zeros(loop.n))
    place = place or constants or OverBox(loop.z, nowhere)
    visible = [
        row
        for row in sp.Matrix.vstack(sp.Matrix(loop.ports.T), sp.Matrix(loop.R)).tolist()
        if any(row) and not (whole and sp.Matrix([row]).free_symbols & states)
    ]
    visible.sort(key=lambda row: bool(sp.Matrix([row]).free_symbols))
    Z = sp.Matrix(visible)
    rows, columns = place.pivots(Z)
    Z = Z[rows, :]
    if not (place.regular(Z[:, columns]) and place.finite(sp.Matrix(loop.M))):
        return False
    B = kernel(Z)
    if B.cols == 0:
        return True
    motion = sp.Matrix(loop.J) * B
    moving = [i for i in range(loop.n) if any(not is_zero(e) for e in motion[i, :])]
    hidden = all(is_zero(e) is True for i in moving for e in B[i, :])
    if not (set(moving) <= set(resting) and hidden and B.cols == loop.n - len(columns)):
        return False
    spans = all(is_zero(e) is True for e in Z * B) and place.finite(B)
    carried = motion[moving, :]
    chosen, _ = place.pivots(carried)
    return spans and len(chosen) == B.cols and place.regular(carried[chosen, :])


def loop_is_defined(design: Design, box: Interval) -> bool:
    """Whether energy, structure and Casimirs are smooth, as written, in a box of all states."""
    return is_smooth_on(written(design), design.loop.z, box)


class OverBox:
    """Matrices of expressions over a box (N,) of all states."""

    def __init__(self, symbols: Sequence[sp.Symbol], box: Interval) -> None:
        self.symbols, self.box = symbols, box

    def _enclosed(self, matrix: sp.Matrix) -> Interval:
        """Over cells of the states that occur, (cells, rows, columns)."""
        used = [i for i, s in enumerate(self.symbols) if matrix.has(s)]
        parts = int(_CELLS ** (1 / max(1, len(used))))
        cells = subdivide(self.box[np.array(used, dtype=int)], parts)
        return matrix_enclosure(matrix, [self.symbols[i] for i in used], cells)

    def finite(self, matrix: sp.Matrix) -> bool:
        """Whether every entry is bounded on the box; entries are taken one by one."""
        entries = [sp.Matrix([[e]]) for e in set(matrix) if e.free_symbols]
        found = [self._enclosed(e) for e in entries]
        return all(bool(np.isfinite(v.lo + v.hi).all()) for v in found)

    def regular(self, matrix: sp.Matrix) -> bool:
        """Whether a square matrix is regular on the box, cell by cell."""
        return bool(regular(self._enclosed(matrix)).all())

    def pivots(self, matrix: sp.Matrix) -> tuple[list[int], list[int]]:
        """Rows and columns of a square block of full rank at the middle: a guess, no proof."""
        middle = Interval(self.box.mid[None], self.box.mid[None])
        A = matrix_enclosure(matrix, list(self.symbols), middle).mid[0]
        if not np.isfinite(A).all():
            return [], []
        rows: list[int] = []
        columns: list[int] = []
        left: Vector = A.copy()
        for i in range(len(left)):
            j = int(np.argmax(np.abs(left[i])))
            if abs(left[i, j]) <= _SMALL * float(np.abs(A).max(initial=0.0)):
                continue
            rows.append(i)
            columns.append(j)
            left[i + 1 :] -= np.outer(left[i + 1 :, j] / left[i, j], left[i])
            left[i + 1 :, j] = 0.0
        return rows, columns
