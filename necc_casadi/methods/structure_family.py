"""Linear families of B = G⊥F_d: symmetry of S = B(∂s/∂x)ᵀ, and the dissipation that they leave."""

from __future__ import annotations

from collections.abc import Sequence

import sympy as sp

from necc_casadi.symbolic.linear_algebra import kernel

__all__ = ["combined", "dissipation", "reduced", "symmetry_rows"]


def symmetry_rows(slopes: sp.Matrix) -> sp.Matrix:
    """Rows whose kernel are the B, row by row, with B slopesᵀ symmetric; slopes = ∂s/∂x."""
    r, n = slopes.shape
    rows = []
    for i in range(r):
        for j in range(i):
            row: list[sp.Expr] = [sp.Integer(0)] * (r * n)
            for k in range(n):
                row[i * n + k] += slopes[j, k]
                row[j * n + k] -= slopes[i, k]
            rows.append(row)
    return sp.Matrix(rows) if rows else sp.zeros(0, r * n)


def dissipation(B: sp.Matrix, annihilator: sp.Matrix) -> sp.Matrix:
    """−(BG⊥ᵀ + G⊥Bᵀ), to be ⪰ 0."""
    product = B * annihilator.T
    return -(product + product.T)


def reduced(family: list[sp.Matrix], annihilator: sp.Matrix) -> list[sp.Matrix]:
    """The part of a family that leaves no entry beside a diagonal entry that is always 0.

    Dissipation ⪰ 0 has none; without this step no point of the family is an interior one.
    """
    while family:
        losses = [dissipation(B, annihilator) for B in family]
        r = losses[0].rows
        never = [i for i in range(r) if all(D[i, i] == 0 for D in losses)]
        rows = [[D[i, j] for D in losses] for i in never for j in range(r)]
        rows = [row for row in rows if any(entry != 0 for entry in row)]
        if not rows:
            break
        basis = kernel(sp.Matrix(rows))
        family = [combined(family, list(basis[:, k])) for k in range(basis.cols)]
    return family


def combined(family: Sequence[sp.Matrix], weights: Sequence[sp.Expr]) -> sp.Matrix:
    """Σ weight · B."""
    total = sp.zeros(*family[0].shape)
    for weight, B in zip(weights, family, strict=True):
        total += weight * B
    return total
