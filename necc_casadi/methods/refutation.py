"""Proofs that no constant F_d exists: an uncontrollable mode, or a dual certificate.

A refusal needs every B with a symmetric B(∂s/∂x)ᵀ: sampled at exact rational points the condition
gives a family that contains all of them. What is said of states near x* says nothing of another
branch of a root or an arc: there points are taken where everything is smooth on the way from x*. A
solver that finds nothing has proved nothing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

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
from necc_casadi.symbolic.pieces import Box, branches, piece_around
from necc_casadi.symbolic.zero import Undecided, random_point

__all__ = ["no_constant_structure", "nothing_is_conserved", "uncontrollable_growth"]


#: Denominators with which a dual certificate is rounded, the simplest first.
_DENOMINATORS = (1, 12, 1000, 10**6)


#: Points at which the rows of ∂s/∂x are told apart.
_POINTS = 16


def nothing_is_conserved(slopes: sp.Matrix, x_star: Mapping[sp.Symbol, sp.Expr]) -> bool:
    """Whether a·s ≡ 0 near x* is proved to ask for a = 0, from ∂s/∂x: then G⊥F_d has full rank.

    aG⊥x would be constant whatever the inputs do; F_d may hold it, and be singular along aG⊥.
    """
    symbols, box = slopes.free_symbols, _branch(slopes, x_star)
    if box is None:
        return False
    points = (random_point(symbols, seed, box) for seed in range(_POINTS))
    return independent_rows(slopes, points)


def _branch(slopes: sp.Matrix, x_star: Mapping[sp.Symbol, sp.Expr]) -> Box | None:
    """A box around x* on which the slopes are analytic; none is needed for one branch alone.

    None where they are not proved to be smooth at x*.
    """
    if not branches(slopes):
        return {}
    symbols = slopes.free_symbols
    piece = piece_around(
        list(slopes), {s: x_star[s] for s in symbols}, dict.fromkeys(symbols, sp.Integer(2))
    )
    return None if piece is None else piece.box


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
    family = _family(slopes, x_star)
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


def _family(slopes: sp.Matrix, x_star: Mapping[sp.Symbol, sp.Expr]) -> sp.Matrix | None:
    """Basis of the B that are symmetric at some rational points, where the rows are rational.

    None where no points are known on the branch of x*.
    """
    rows, box = symmetry_rows(slopes), _branch(slopes, x_star)
    if box is None:
        return None
    points = slopes.cols + 3
    sampled = [sp.zeros(0, rows.cols)]
    for seed in range(points):
        values = _at_rational_point(rows, seed, box)
        kept = [i for i in range(rows.rows) if all(e.is_Rational for e in values[i, :])]
        if kept and is_finite(values):
            sampled.append(sp.Matrix(values.extract(kept, list(range(rows.cols)))))
    stacked = sp.Matrix.vstack(*sampled)
    return kernel(stacked) if stacked.rows else sp.eye(rows.cols)


def _at_rational_point(rows: sp.Matrix, seed: int, box: Box) -> sp.Matrix:
    """Rows at a point, of a box where one is given.

    Else with rational sines and cosines, where angles stand in nothing else.
    """
    rows = rows.applyfunc(sp.expand_trig)
    point = random_point(rows.free_symbols, seed, box)
    if box:
        return sp.Matrix(at(rows, point))
    found = {f.args[0] for entry in rows for f in entry.atoms(sp.sin, sp.cos)}
    angles = {s for s in point if s in found}
    half = {s: point[s] for s in angles}  # tan(s/2)
    turned: dict[sp.Expr, sp.Expr] = {sp.sin(s): 2 * t / (1 + t**2) for s, t in half.items()}
    turned |= {sp.cos(s): (1 - t**2) / (1 + t**2) for s, t in half.items()}
    circled = sp.Matrix(rows.xreplace(turned))
    return sp.Matrix(at(rows if circled.free_symbols & angles else circled, point))


def _even(matrix: sp.Matrix) -> sp.Matrix:
    return (matrix + matrix.T) / 2


def _dual_exists(curved: Sequence[sp.Matrix], losing: Sequence[sp.Matrix], r: int) -> bool:
    """Whether an exact pair (Z, Y) is found; floating point proposes it."""
    if not curved:
        return True  # only B = 0
    dual = _faced(curved, losing, r)
    if not dual.sizes[0]:
        return False  # Z = 0
    units = dual.units
    inner = float_matrix(dual.equations)
    scale = np.abs(inner).max(axis=1)
    inequalities = []
    for block, size in enumerate(dual.sizes):
        if size:
            parts = [float_matrix(E) if k == block else np.zeros((size, size)) for k, E in units]
            inequalities.append((np.zeros((size, size)), np.array(parts)))
    trace = np.array([float(np.trace(float_matrix(E))) if k == 0 else 0.0 for k, E in units])
    program = SemidefiniteProgram(
        cost=np.zeros(len(units)),
        inequalities=inequalities,
        equations=[(row / (size or 1.0), 0.0) for row, size in zip(inner, scale, strict=True)]
        + [(trace, 1.0)],
    )
    proposed = program.solution()
    if proposed is None:
        return False
    return any(dual.certifies(proposed, most) for most in _DENOMINATORS)


@dataclass(frozen=True)
class _Dual:
    """⟨Z, S⟩ = ⟨Y, L⟩ for each member of the family, with Z and Y in what they may be in."""

    curved: tuple[sp.Matrix, ...]  # S of each member, on the face of Z
    losing: tuple[sp.Matrix, ...]  # L of each member, on the face of Y

    @property
    def sizes(self) -> tuple[int, int]:
        """Rows of Z and of Y."""
        return self.curved[0].rows, self.losing[0].rows

    @cached_property
    def units(self) -> list[tuple[int, sp.Matrix]]:
        """A basis of the symmetric matrices Z (0) and Y (1)."""
        return [(block, E) for block in (0, 1) for E in _symmetric_units(self.sizes[block])]

    @cached_property
    def equations(self) -> sp.Matrix:
        """One row per member, one column per unit."""
        members = zip(self.curved, self.losing, strict=True)
        return sp.Matrix(
            [[_inner(Q, E) if k == 0 else -_inner(L, E) for k, E in self.units] for Q, L in members]
        )

    def certifies(self, proposed: Vector, most: int) -> bool:
        """Whether the proposal, rounded and moved onto the equations, is an exact certificate."""
        scaled = proposed / np.abs(proposed).max()
        rounded = sp.Matrix([rational(float(v), most) for v in scaled])
        basis = kernel(self.equations)
        if basis.cols == 0:
            return False
        exact = basis * (basis.T * basis).LUsolve(basis.T * rounded)
        found = [sp.zeros(size) for size in self.sizes]
        for weight, (k, E) in zip(exact, self.units, strict=True):
            found[k] += weight * E
        semidefinite = all(definiteness(matrix)[0] in ("positive", "flat") for matrix in found)
        return semidefinite and not found[0].is_zero_matrix


def _faced(curved: Sequence[sp.Matrix], losing: Sequence[sp.Matrix], r: int) -> _Dual:
    """The same on smaller faces, where members with L = 0 or S = 0 leave Z or Y no more.

    ⟨Z, S⟩ = 0 with S semidefinite asks for ZS = 0, which no rounding of another Z would keep.
    """
    faces = [sp.eye(r), sp.eye(r)]
    kinds = [list(curved), list(losing)]
    while True:
        seen = [[N.T * Q * N for Q in kind] for N, kind in zip(faces, kinds, strict=True)]
        cut = next(
            (
                (k, Q)
                for k in (0, 1)
                for Q, other in zip(seen[k], seen[1 - k], strict=True)
                if other.is_zero_matrix and not Q.is_zero_matrix and _is_semidefinite(Q)
            ),
            None,
        )
        if cut is None:
            return _Dual(_of_size_one(seen[0]), _of_size_one(seen[1]))
        faces[cut[0]] = faces[cut[0]] * kernel(cut[1])


def _of_size_one(matrices: Sequence[sp.Matrix]) -> tuple[sp.Matrix, ...]:
    """The same up to one positive factor, which Z or Y makes up for."""
    largest = max((abs(e) for Q in matrices for e in Q), default=sp.Integer(0)) or sp.Integer(1)
    return tuple(Q / largest for Q in matrices)


def _is_semidefinite(Q: sp.Matrix) -> bool:
    return any(definiteness(sign * Q)[0] in ("positive", "flat") for sign in (1, -1))


def _symmetric_units(r: int) -> list[sp.Matrix]:
    """A basis of the symmetric matrices."""
    units = []
    for i in range(r):
        for j in range(i + 1):
            unit = sp.zeros(r)
            unit[i, j] = unit[j, i] = 1
            units.append(unit)
    return units


def _inner(P: sp.Matrix, Q: sp.Matrix) -> sp.Expr:
    return sp.Add(*[a * b for a, b in zip(P, Q, strict=True)])
