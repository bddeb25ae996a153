"""Proofs that no constant F_d exists: an uncontrollable mode, or a dual certificate.

A refusal needs every B with a symmetric B(∂s/∂x)ᵀ: sampled at exact rational points the condition
gives a family that contains all of them. A solver that finds nothing has proved nothing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import flint
import numpy as np
import sympy as sp

from necc_casadi.arrays import Vector
from necc_casadi.methods.semidefinite_program import SemidefiniteProgram
from necc_casadi.methods.structure_family import dissipation, reduced, symmetry_rows
from necc_casadi.symbolic.arb import independent_rows
from necc_casadi.symbolic.definiteness import definiteness, rational
from necc_casadi.symbolic.derivatives import at
from necc_casadi.symbolic.expressions import is_finite
from necc_casadi.symbolic.floats import float_matrix
from necc_casadi.symbolic.linear_algebra import kernel
from necc_casadi.symbolic.zero import Undecided, random_point

__all__ = ["no_constant_structure", "nothing_is_conserved", "uncontrollable_growth"]


#: Denominators with which a dual certificate is rounded, the simplest first.
_DENOMINATORS = (1, 12, 1000, 10**6)


#: Points at which the rows of ∂s/∂x are told apart.
_POINTS = 16


def nothing_is_conserved(slopes: sp.Matrix) -> bool:
    """Whether a·s ≡ 0 is proved to have no solution a ≠ 0, from ∂s/∂x: then G⊥F_d has full rank.

    aG⊥x would be constant whatever the inputs do; F_d may hold it, and be singular along aG⊥.
    """
    symbols = slopes.free_symbols
    return independent_rows(slopes, (random_point(symbols, seed) for seed in range(_POINTS)))


def uncontrollable_growth(A: sp.Matrix, G: sp.Matrix, conserved: bool = False) -> bool:
    """Whether (A, G) is proved to have an uncontrollable eigenvalue λ with Re λ > 0, or λ = 0.

    With g⊥ a left eigenvector, F_d∇²H₀ = A + GK has it too, but F_d∇²H₀ with ∇²H₀ ≻ 0 is stable.
    λ = 0 counts unless something may be `conserved`: it asks for aG⊥F_d = 0.
    """
    reached = [sp.Matrix(G)]
    for _ in range(A.rows - 1):
        reached.append(A * reached[-1])
    try:
        left = kernel(sp.Matrix.hstack(*reached).T).T
    except Undecided:
        return False
    if left.rows == 0:
        return False
    modes = left * A * left.T * (left * left.T).inv()
    entries = [[e for e in row if isinstance(e, sp.Rational)] for row in modes.tolist()]
    if any(len(row) < modes.cols for row in entries):
        return False
    table = flint.fmpq_mat([[flint.fmpq(e.p, e.q) for e in row] for row in entries])
    if not conserved and table.rank() < modes.rows:
        return True
    return any(root.real > 0 for root, _ in table.charpoly().numer().complex_roots())


def no_constant_structure(
    slopes: sp.Matrix, annihilator: sp.Matrix, x_star: Mapping[sp.Symbol, sp.Expr]
) -> bool:
    """Whether (i), (ii), (iii) are proved to have no solution, by an exact dual certificate.

    For Z, Y ⪰ 0, Z ≠ 0 with ⟨Z, S(B)⟩ = ⟨Y, BG⊥ᵀ + G⊥Bᵀ⟩ for every B of the family, S(B) ≻ 0 and
    BG⊥ᵀ + G⊥Bᵀ ⪯ 0 exclude each other. That F_d asks for (iii) rests on nothing being conserved.
    """
    family = _family(slopes)
    r, n = slopes.shape
    there = sp.Matrix(at(slopes, x_star))
    entries = [*there, *annihilator]
    if family is None or not all(entry.is_Rational for entry in entries):
        return False
    members = [sp.Matrix(r, n, list(family[:, k])) for k in range(family.cols)]
    members = reduced(members, annihilator)
    curved = [_even(B * there.T) for B in members]
    losing = [-dissipation(B, annihilator) for B in members]
    return _dual_exists(curved, losing, r)


def _family(slopes: sp.Matrix) -> sp.Matrix | None:
    """Basis of the B that are symmetric at some rational points, where the rows are rational."""
    rows = symmetry_rows(slopes)
    points = slopes.cols + 3
    sampled = [sp.zeros(0, rows.cols)]
    for seed in range(points):
        values = at(rows, random_point(rows.free_symbols, seed))
        kept = [i for i in range(rows.rows) if all(e.is_Rational for e in values[i, :])]
        if kept and is_finite(values):
            sampled.append(sp.Matrix(values.extract(kept, list(range(rows.cols)))))
    stacked = sp.Matrix.vstack(*sampled)
    return kernel(stacked) if stacked.rows else sp.eye(rows.cols)


def _even(matrix: sp.Matrix) -> sp.Matrix:
    return (matrix + matrix.T) / 2


def _dual_exists(curved: Sequence[sp.Matrix], losing: Sequence[sp.Matrix], r: int) -> bool:
    """Whether an exact pair (Z, Y) is found; floating point proposes it."""
    if not curved:
        return True  # only B = 0
    units = _symmetric_units(r)
    inner = np.array(
        [
            [float(np.sum(float_matrix(Q) * E)) for E in units]
            + [-float(np.sum(float_matrix(L) * E)) for E in units]
            for Q, L in zip(curved, losing, strict=True)
        ]
    )
    scale = np.abs(inner).max(axis=1)
    zeros = np.zeros((len(units), r, r))
    parts = np.array(units)
    trace = np.array([np.trace(E) for E in units] + [0.0] * len(units))
    program = SemidefiniteProgram(
        cost=np.zeros(2 * len(units)),
        inequalities=[
            (np.zeros((r, r)), np.concatenate([parts, zeros])),
            (np.zeros((r, r)), np.concatenate([zeros, parts])),
        ],
        equations=[(row / (size or 1.0), 0.0) for row, size in zip(inner, scale, strict=True)]
        + [(trace, 1.0)],
    )
    proposed = program.solution()
    if proposed is None:
        return False
    return any(_certifies(curved, losing, proposed, most, r) for most in _DENOMINATORS)


def _symmetric_units(r: int) -> list[Vector]:
    """A basis of the symmetric matrices."""
    units = []
    for i in range(r):
        for j in range(i + 1):
            unit = np.zeros((r, r))
            unit[i, j] = unit[j, i] = 1.0
            units.append(unit)
    return units


def _certifies(
    curved: Sequence[sp.Matrix],
    losing: Sequence[sp.Matrix],
    proposed: Vector,
    most: int,
    r: int,
) -> bool:
    """Whether the proposal, rounded and moved onto the equations, is an exact certificate."""
    scaled = proposed / np.abs(proposed).max()
    rounded = sp.Matrix([rational(float(v), most) for v in scaled])
    units = [sp.Matrix(E.astype(int).tolist()) for E in _symmetric_units(r)]
    equations = sp.Matrix(
        [
            [_inner(Q, E) for E in units] + [-_inner(L, E) for E in units]
            for Q, L in zip(curved, losing, strict=True)
        ]
    )
    basis = kernel(equations)
    if basis.cols == 0:
        return False
    exact = basis * (basis.T * basis).LUsolve(basis.T * rounded)
    half = len(units)
    Z, Y = (
        sum((exact[start + k] * E for k, E in enumerate(units)), sp.zeros(r)) for start in (0, half)
    )
    semidefinite = all(definiteness(matrix)[0] in ("positive", "flat") for matrix in (Z, Y))
    return semidefinite and not Z.is_zero_matrix


def _inner(P: sp.Matrix, Q: sp.Matrix) -> sp.Expr:
    return sp.Add(*[a * b for a, b in zip(P, Q, strict=True)])
