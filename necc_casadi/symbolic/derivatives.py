"""Gradients and Hessians of expressions, and their values at a point."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import sympy as sp

__all__ = ["at", "column", "gradient", "sparse_hessian", "value_at"]


def gradient(f: sp.Expr, variables: Sequence[sp.Symbol]) -> sp.ImmutableMatrix:
    """∇f as a column, len(variables) × 1; a term costs only the variables that it contains."""
    slopes: dict[sp.Symbol, list[sp.Expr]] = {v: [] for v in variables}
    for term in sp.Add.make_args(f):
        for v in term.free_symbols & slopes.keys():
            slopes[v].append(sp.diff(term, v))
    return sp.ImmutableMatrix([sp.Add(*terms) for terms in slopes.values()])


def sparse_hessian(f: sp.Expr, variables: Sequence[sp.Symbol]) -> sp.ImmutableMatrix:
    """∇²f; variables that do not occur together cost nothing."""
    size = len(variables)
    place = {v: i for i, v in enumerate(variables)}
    entries: dict[tuple[int, int], sp.Expr] = {}
    for i, slope in enumerate(gradient(f, variables)):
        for j in sorted(place[v] for v in slope.free_symbols if v in place):
            if j <= i:
                entries[i, j] = entries[j, i] = sp.diff(slope, variables[j])
    return sp.ImmutableMatrix(sp.SparseMatrix(size, size, entries))


def column(entries: Sequence[sp.Expr]) -> sp.ImmutableMatrix:
    """`entries` as one column."""
    return sp.ImmutableMatrix(len(entries), 1, list(entries))


def at(matrix: sp.MatrixBase, point: Mapping[sp.Symbol, sp.Expr]) -> sp.ImmutableMatrix:
    """`matrix` at exact values of some symbols."""
    entries = {place: value_at(entry, point) for place, entry in matrix.todok().items()}
    return sp.ImmutableMatrix(sp.SparseMatrix(*matrix.shape, entries))


def value_at(expr: sp.Expr, point: Mapping[sp.Symbol, sp.Expr]) -> sp.Expr:
    """`expr` at exact values of some symbols; costs nothing where none of them occurs."""
    known = {s: point[s] for s in expr.free_symbols if s in point}
    return expr.subs(known) if known else expr
