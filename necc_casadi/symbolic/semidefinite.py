"""Positive semidefiniteness of symbolic matrices, for all states."""

from __future__ import annotations

import sympy as sp

from necc_casadi.symbolic.linear_algebra import tidy
from necc_casadi.symbolic.zero import is_zero, sign

__all__ = ["blocks", "is_positive_semidefinite"]


def blocks(matrix: sp.Matrix) -> list[list[int]]:
    """Indices of the diagonal blocks of a symmetric sparsity pattern, each sorted."""
    neighbours: list[set[int]] = [set() for _ in range(matrix.rows)]
    for i, j in matrix.todok():
        neighbours[i].add(j)
        neighbours[j].add(i)
    seen: set[int] = set()
    result = []
    for start in range(matrix.rows):
        if start in seen:
            continue
        block, stack = {start}, [start]
        while stack:
            fresh = neighbours[stack.pop()] - block
            block |= fresh
            stack.extend(fresh)
        seen |= block
        result.append(sorted(block))
    return result


def is_positive_semidefinite(matrix: sp.Matrix) -> bool | None:
    """Whether a symmetric matrix is positive semidefinite for all real values of its symbols."""
    verdicts = [_block_psd(matrix.extract(block, block)) for block in blocks(matrix)]
    if False in verdicts:
        return False
    return None if None in verdicts else True


def _block_psd(block: sp.Matrix) -> bool | None:
    """Symmetric elimination with pivots of known sign, then principal minors."""
    remaining = sp.Matrix(block)
    while remaining.rows:
        signs = [_sign_everywhere(remaining[i, i]) for i in range(remaining.rows)]
        if "-" in signs:
            return False
        if "+" in signs:
            pivot = signs.index("+")
        elif "0" in signs:
            zero = signs.index("0")
            others = [is_zero(remaining[zero, j]) for j in range(remaining.rows) if j != zero]
            if False in others:
                return False
            if None in others:
                return None
            remaining = _without(remaining, zero)
            continue
        else:
            return _minors_psd(remaining)
        column = _without(remaining, pivot, rows_only=True)[:, pivot]
        schur = _without(remaining, pivot) - column * column.T / remaining[pivot, pivot]
        remaining = schur.applyfunc(tidy)
    return True


def _without(matrix: sp.Matrix, index: int, rows_only: bool = False) -> sp.Matrix:
    keep = [i for i in range(matrix.rows) if i != index]
    return matrix.extract(keep, list(range(matrix.cols)) if rows_only else keep)


def _sign_everywhere(expr: sp.Expr) -> str:
    """``+`` positive, ``0`` zero, ``>`` nonnegative, ``-`` negative, ``?`` unknown."""
    if not expr.free_symbols:
        return {1: "+", 0: "0", -1: "-", None: "?"}[sign(expr)]
    for tidied in (_as_it_is, _factored):  # factoring only where it is needed
        candidate = tidied(expr)
        if candidate.is_positive:
            return "+"
        if candidate.is_negative:
            return "-"
        if candidate.is_nonnegative:
            return ">"
    return "0" if is_zero(expr) else "?"


def _as_it_is(expr: sp.Expr) -> sp.Expr:
    return expr


def _factored(expr: sp.Expr) -> sp.Expr:
    """Factors of the same sign; exponentials as positive symbols.

    A factorisation takes exp(2000001 q²/7) as the power of one symbol, with all lower powers.
    """
    positive = {e: sp.Dummy(positive=True) for e in expr.atoms(sp.exp)}
    return sp.factor(expr.xreplace(positive))


def _minors_psd(matrix: sp.Matrix, limit: int = 5) -> bool | None:
    """All principal minors nonnegative; only for small matrices."""
    if matrix.rows > limit:
        return None
    for mask in range(1, 2**matrix.rows):
        chosen = [i for i in range(matrix.rows) if mask >> i & 1]
        minor = matrix.extract(chosen, chosen).det()
        # an entry as it was written may be a square that expanding hides
        kind = _sign_everywhere(minor if len(chosen) == 1 else sp.expand(minor))
        if kind == "-":
            return False
        if kind == "?":
            return None
    return True
