"""Rank, kernel and reduced rows of symbolic matrices."""

from __future__ import annotations

import math
from collections.abc import Sequence

import sympy as sp
from sympy.polys.matrices import DomainMatrix

from necc_casadi.symbolic.arb import real_rank
from necc_casadi.symbolic.expressions import complexity
from necc_casadi.symbolic.finite_field import NoFiniteFieldValue, values
from necc_casadi.symbolic.modular import nullspace, rank
from necc_casadi.symbolic.zero import PROBES, Undecided, is_zero, sign

__all__ = ["constant_kernel", "generic_rank", "has_rank", "kernel", "reduced_rows", "tidy"]


_LONG = 40  # operations of a constant beyond which a shorter form is not sought


def generic_rank(matrix: sp.Matrix, tries: int = PROBES) -> int:
    """Rank of `matrix` at generic points: the largest found at random points.

    Exact for constant matrices. For others it is the rank over a finite field at random values
    of the functions that occur, a lower bound that is missed with probability below 1e-6; where
    that cannot be evaluated, the rank that Arb balls prove at random real points.

    Raises
    ------
    Undecided
        Where a pivot of a constant matrix is not told from zero.
    """
    if 0 in matrix.shape:
        return 0
    if not matrix.free_symbols:
        return len(reduced_rows(matrix)[1])
    try:
        table = values(list(matrix), tries)
    except NoFiniteFieldValue:
        return _real_rank(matrix)
    return max(rank(row.reshape(matrix.shape)) for row in table)


def _real_rank(matrix: sp.Matrix) -> int:
    """The largest rank that balls prove at real points."""
    ranks = range(min(matrix.shape), 0, -1)
    return next((r for r in ranks if real_rank(matrix, matrix.free_symbols, r)), 0)


def has_rank(matrix: sp.Matrix, wanted: int) -> bool:
    """Whether a constant matrix is proved to have at least rank `wanted`, by Arb balls."""
    return real_rank(matrix, (), wanted, tries=1)


def kernel(matrix: sp.Matrix) -> sp.Matrix:
    """Basis of {v : matrix·v = 0} as columns, over the field that the entries generate.

    The reduced-echelon basis of the kernel itself; where a vector is rational it is scaled to
    primitive integers, first nonzero coefficient positive.

    Raises
    ------
    Undecided
        As :func:`reduced_rows`.
    """
    columns = matrix.cols
    if matrix.rows == 0:
        return sp.eye(columns)
    if not matrix.free_symbols and not all(entry.is_Rational for entry in matrix):
        used = [j for j in range(columns) if any(entry != 0 for entry in matrix[:, j])]
        if len(used) <= matrix.rows and has_rank(matrix, len(used)):
            return sp.eye(columns).extract(
                list(range(columns)), [j for j in range(columns) if j not in used]
            )
    rows, leading = reduced_rows(matrix)
    free = [j for j in range(columns) if j not in set(leading)]
    if not free:
        return sp.zeros(columns, 0)
    basis = sp.zeros(len(free), columns)
    for k, j in enumerate(free):
        basis[k, j] = 1
        for i, lead in enumerate(leading):
            if rows[i, j] != 0:
                basis[k, lead] = -rows[i, j]
    reduced, _ = reduced_rows(basis)
    return sp.Matrix([_primitive(row) for row in reduced.tolist()]).T


def constant_kernel(matrix: sp.Matrix) -> sp.Matrix:
    """Basis of the constant v with matrix(z)·v ≡ 0, as columns, each one proved.

    Reduced-echelon over the rationals, primitive integers, first nonzero coefficient positive;
    for a constant matrix the same as :func:`kernel`.
    """
    if not matrix.free_symbols:
        return kernel(matrix)
    rows = [i for i in range(matrix.rows) if any(e != 0 for e in matrix[i, :])]
    points = matrix.cols // len(rows) * 2 + 4
    try:
        vectors = nullspace(
            lambda prime: values(list(matrix), points, prime=prime).reshape(-1, matrix.cols)
        )
    except NoFiniteFieldValue:
        vectors = []
    if not vectors:
        return sp.zeros(matrix.cols, 0)
    basis = kernel(kernel(sp.Matrix(vectors)).T)
    kept = [
        basis[:, k]
        for k in range(basis.cols)
        if all(is_zero(entry) is True for entry in sp.SparseMatrix(matrix) * basis[:, k])
    ]
    return sp.Matrix.hstack(*kept) if kept else sp.zeros(matrix.cols, 0)


def reduced_rows(matrix: sp.Matrix) -> tuple[sp.Matrix, list[int]]:
    """Nonzero rows of the reduced row-echelon form and its pivot columns.

    Identities such as sin² + cos² = 1 are respected: every pivot is proved to be different from
    zero, and what counts as zero is proved to be zero.

    Raises
    ------
    Undecided
        Where no entry of a column is proved to be a pivot, and not all are proved to be zero.
    """
    if all(entry.is_Rational for entry in matrix):
        reduced, pivots = DomainMatrix.from_Matrix(matrix).to_field().rref()
        return reduced.to_Matrix()[: len(pivots), :], list(pivots)
    rows = [list(row) for row in matrix.tolist()]
    leading, done = list[int](), 0
    for column in range(matrix.cols):
        rows[done:] = [
            [*row[:column], tidy(row[column]), *row[column + 1 :]] for row in rows[done:]
        ]
        best = _pivot(rows, done, column)
        if best is None:
            continue
        rows[done], rows[best] = rows[best], rows[done]
        pivot = rows[done][column]
        rows[done] = [tidy(entry / pivot) for entry in rows[done]]
        for i, row in enumerate(rows):
            if i != done and row[column] != 0:
                factor = row[column]
                rows[i] = [tidy(a - factor * b) for a, b in zip(row, rows[done], strict=True)]
        leading.append(column)
        done += 1
    return sp.Matrix(done, matrix.cols, [e for row in rows[:done] for e in row]), leading


def _pivot(rows: Sequence[Sequence[sp.Expr]], done: int, column: int) -> int | None:
    """The simplest row from `done` on with a proved nonzero in a column; None: all are zero."""
    unknown = None
    candidates = [i for i in range(done, len(rows)) if rows[i][column] != 0]
    for i in sorted(candidates, key=lambda i: (complexity(rows[i][column]), i)):
        zero = is_zero(rows[i][column])
        if zero is False:
            return i
        unknown = i if zero is None and unknown is None else unknown
    if unknown is not None:
        raise Undecided(rows[unknown][column])
    return None


def tidy(expr: sp.Expr) -> sp.Expr:
    """A shorter form of the same value; 0 where it is known to vanish."""
    if expr.is_Rational:
        return expr
    if not expr.free_symbols:
        if sign(expr) == 0:
            return sp.Integer(0)
        return sp.radsimp(sp.expand(expr)) if expr.count_ops() < _LONG else expr
    if expr.is_rational_function(*expr.free_symbols):
        return sp.cancel(expr)
    return sp.Integer(0) if is_zero(expr) else sp.factor_terms(sp.trigsimp(sp.cancel(expr)))


def _primitive(row: Sequence[sp.Expr]) -> list[sp.Expr]:
    rationals = [entry for entry in row if isinstance(entry, sp.Rational)]
    if len(rationals) < len(row):
        return list(row)
    scale = math.lcm(*[int(entry.q) for entry in rationals])
    integers = [entry * scale for entry in rationals]
    divisor = math.gcd(*[int(entry) for entry in integers]) or 1
    first = next((entry for entry in integers if entry != 0), sp.Integer(1))
    return [entry / divisor * (1 if first > 0 else -1) for entry in integers]
