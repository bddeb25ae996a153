"""Observability of the pair (JP, [BᵀP; C]) of exact constant matrices J, B, P, C.

Over GF(p) the unobservable motions are found; for real matrices with irrational entries Arb balls
confirm that there are none.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import islice

import flint
import numpy as np
import sympy as sp

from necc_casadi.symbolic.arb import ball
from necc_casadi.symbolic.finite_field import Residues, values

__all__ = ["is_observable", "observability_matrix"]


_BITS = 1000


def observability_matrix(
    J: sp.Matrix, B: sp.Matrix, P: sp.Matrix, prime: int, C: sp.Matrix | None = None
) -> Residues:
    """Independent rows over GF(prime) that span those of [BᵀP; C](JP)ᵏ, k = 0, 1, …; rank × n.

    Without `C` there are no further outputs.

    Raises
    ------
    NoFiniteFieldValue
        Where an irrational entry does not exist modulo `prime`.
    """
    matrices = (J, B, P, sp.zeros(0, J.cols) if C is None else C)
    interconnection, ports, hessian, further = _residues(matrices, prime)
    A, output = interconnection * hessian, ports.transpose() * hessian
    span, size = _reduced(_joined(output, further, prime), prime)
    while True:
        larger, rank = _reduced(_joined(span, span * A, prime), prime)
        if rank == size:
            table = [[int(v) for v in row] for row in larger.tolist()]
            return np.array(table, dtype=np.int64).reshape(size, A.ncols())
        span, size = larger, rank


def _residues(matrices: Sequence[sp.Matrix], prime: int) -> list[flint.nmod_mat]:
    """Matrices of residues; what occurs in several of them has one value."""
    entries = [e for matrix in matrices for e in matrix]
    table = iter([int(v) for v in values(entries, 1, prime=prime)[0]])
    return [
        flint.nmod_mat(m.rows, m.cols, list(islice(table, m.rows * m.cols)), prime)
        for m in matrices
    ]


def _joined(upper: flint.nmod_mat, lower: flint.nmod_mat, prime: int) -> flint.nmod_mat:
    rows = upper.tolist() + lower.tolist()
    entries = [int(v) for row in rows for v in row]
    return flint.nmod_mat(len(rows), upper.ncols(), entries, prime)


def is_observable(J: sp.Matrix, B: sp.Matrix, P: sp.Matrix, C: sp.Matrix | None = None) -> bool:
    """Whether the real pair is proved to be observable, where it is over GF(p).

    For rational entries full rank over GF(p) is a proof. For others GF(p) may miss a relation
    between constants, so that Arb balls have to find n certain pivots.
    """
    matrices = (J, B, P, sp.zeros(0, J.cols) if C is None else C)
    if all(e.is_Rational for matrix in matrices for e in matrix.todok().values()):
        return True
    previous, flint.ctx.prec = flint.ctx.prec, _BITS
    try:
        interconnection, ports, hessian, further = (_as_balls(matrix) for matrix in matrices)
        outputs = (ports.transpose() * hessian).tolist() + further.tolist()
        return _certain_rank(interconnection * hessian, outputs) == J.rows
    finally:
        flint.ctx.prec = previous


def _as_balls(matrix: sp.Matrix) -> flint.arb_mat:
    known: dict[sp.Expr, flint.arb] = {}
    return flint.arb_mat(matrix.rows, matrix.cols, [ball(e, known) for e in matrix])


def _certain_rank(A: flint.arb_mat, outputs: list[list[flint.arb]]) -> int:
    """Number of rows outputs·Aᵏ that are certainly independent, by elimination with balls."""
    basis: list[tuple[int, list[flint.arb]]] = []
    block = outputs
    while block:
        fresh = []
        for candidate in block:
            row = _eliminated(candidate, basis)
            sizes = [0.0 if e.contains(0) else float(abs(e).mid()) for e in row]
            lead = int(np.argmax(sizes))
            if sizes[lead] > 0:
                row = [e / row[lead] for e in row]
                basis.append((lead, row))
                fresh.append(row)
        block = (flint.arb_mat(fresh) * A).tolist() if fresh else []
    return len(basis)


def _eliminated(row: list[flint.arb], basis: list[tuple[int, list[flint.arb]]]) -> list[flint.arb]:
    for column, pivot_row in basis:
        factor = row[column]
        if not factor.is_zero():
            row = [a - factor * b for a, b in zip(row, pivot_row, strict=True)]
            row[column] = flint.arb(0)
    return row


def _reduced(matrix: flint.nmod_mat, prime: int) -> tuple[flint.nmod_mat, int]:
    """Nonzero rows of the reduced echelon form, and their number."""
    reduced, size = matrix.rref()
    rows = reduced.tolist()[:size]
    return flint.nmod_mat(size, matrix.ncols(), [int(v) for row in rows for v in row], prime), size
