"""Proposals B = G⊥F_d for a constant target structure."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import sympy as sp

from necc_casadi.arrays import Vector
from necc_casadi.methods.constant_question import (
    DIGITS,
    PARALLEL,
    Question,
    power_of_two,
)
from necc_casadi.methods.semidefinite_program import SemidefiniteProgram
from necc_casadi.methods.structure_family import combined, reduced, symmetry_rows
from necc_casadi.symbolic.definiteness import rational
from necc_casadi.symbolic.floats import float_matrix
from necc_casadi.symbolic.linear_algebra import constant_kernel

__all__ = ["Proposal", "candidates"]


#: Shares of the fastest rate by which dissipation is asked to exceed zero, the largest first.
_MARGINS = (0.1, 0.01, 1e-3, 0.0)


#: States beyond which subsets of coordinates are not tried one after another.
_MOST_STATES = 6


@dataclass(frozen=True, eq=False)
class Proposal:
    """B, exact, and what it was made with, in natural units."""

    B: sp.Matrix
    P: Vector | None = None  # (n, n) ∇²H₀(x*)⁻¹; None: any
    F: Vector | None = None  # (n, n) F_d; None: any


def candidates(question: Question) -> Iterator[Iterator[Proposal]]:
    """For each proposal its roundings B, which satisfy (i)."""
    if question.annihilator.rows == 1:
        for roundings in _single_rows(question):
            yield map(Proposal, roundings)
        return
    family = [
        B / power_of_two(float(np.abs(float_matrix(B * question.T.inv())).max()))
        for B in reduced(_symmetric_family(question), question.annihilator)
    ]
    if not family:
        return
    if question.cheap_loop is not None:
        for margin in _MARGINS:
            found = _well_conditioned(question, family, margin, question.cheap_loop)
            if found is not None:
                weights, P = found
                yield _cheap_proposals(family, weights, P / question.rate, question.cheap_loop)
                break
    for margin in _MARGINS:
        found = _well_conditioned(question, family, margin)
        if found is not None:
            yield (Proposal(combined(family, w)) for w in _roundings(found[0]))


def _cheap_proposals(
    family: Sequence[sp.Matrix], weights: Vector, P: Vector, closed: Vector
) -> Iterator[Proposal]:
    """Proposals with F_d = (A − GK)P, so that F_d ∇²H₀ = A − GK."""
    scale = np.abs(weights).max()
    for rounded in _roundings(weights, 1):
        yield Proposal(combined(family, rounded), P / scale, closed @ P / scale)


def _roundings(values: Vector, first: int = 0) -> Iterator[list[sp.Expr]]:
    """The values, up to a common factor, to more and more digits."""
    scaled = values / np.abs(values).max()
    for digits in DIGITS[first:]:
        yield [rational(float(v), 10**digits) for v in scaled]


def _single_rows(question: Question) -> Iterator[Iterator[sp.Matrix]]:
    """One unactuated direction: b with b·∇s(x*) > 0 > b·g⊥, by linear algebra.

    ∇s = κg⊥ + w with w ⊥ g⊥ in natural units. For κ < 0 ∇s itself will do; otherwise b is ∇s less
    enough of g⊥. Then the same on fewer coordinates, where quadratures are simpler.
    """
    T = question.T
    slope, row = question.slopes_there * T, question.annihilator * T
    n = len(question.x)
    for size in range(n, 0, -1) if n <= _MOST_STATES else (n,):
        for kept in combinations(range(n), size):
            mask = sp.diag(*[int(k in kept) for k in range(n)])
            a, g = float_matrix(slope * mask)[0], float_matrix(row * mask)[0]
            b = _between(a, g)
            if b is not None:
                yield (sp.Matrix([exact]) * T for exact in _roundings(b))


def _between(a: Vector, g: Vector) -> Vector | None:
    """Find b with b·a > 0 > b·g, midway; None where a = κg, κ ≥ 0."""
    length = float(np.linalg.norm(g))
    if length == 0:
        return a if np.any(a) else None
    unit = g / length
    kappa = float(a @ unit)
    across = a - kappa * unit
    w = float(np.linalg.norm(across))
    if kappa < 0:
        return a
    if w <= PARALLEL * float(np.linalg.norm(a)):
        return None
    return across - min(w / 2, w**2 / (2 * kappa) if kappa else w / 2) * unit


def _symmetric_family(question: Question) -> list[sp.Matrix]:
    """A basis of constant B with a symmetric S for all x, each one proved."""
    basis = constant_kernel(symmetry_rows(question.slopes))
    shape = question.slopes.shape
    return [sp.Matrix(*shape, list(basis[:, k])) for k in range(basis.cols)]


def _well_conditioned(
    question: Question,
    family: Sequence[sp.Matrix],
    margin: float,
    closed: Vector | None = None,
) -> tuple[Vector, Vector] | None:
    """Weights of the family with B = G⊥AP, I ⪯ P ⪯ κI and the least κ, in natural units, and P.

    With a loop ẋ = closed·x of the linearised plant, P⁻¹ is to be a Lyapunov function of it too.
    """
    size = np.diag(float_matrix(question.T))
    row = float_matrix(question.annihilator * question.T)
    slope = float_matrix(question.slopes_there * question.T) / question.rate
    members = np.array([float_matrix(B) / size for B in family])
    r, n = row.shape
    units = [(i, j) for i in range(n) for j in range(i + 1)]
    count, width = len(members), len(members) + len(units) + 1
    P = np.zeros((width, n, n))
    for k, (i, j) in enumerate(units):
        P[count + k, i, j] = P[count + k, j, i] = 1.0
    top, losing = np.zeros((width, n, n)), np.zeros((width, r, r))
    top[-1] = np.eye(n)
    products = members @ row.T
    losing[:count] = -(products + products.transpose(0, 2, 1))
    free = [np.abs(losing[:, i, i]).max() > 0 for i in range(r)]
    equations = []
    for i in range(r):
        for j in range(n):
            entry = np.zeros(width)
            entry[:count] = members[:, i, j]
            entry -= np.einsum("k,wk->w", slope[i], P[:, :, j])
            equations.append((entry, 0.0))
    inequalities = [
        (-np.eye(n), P),
        (np.zeros((n, n)), top - P),
        (-margin * np.diag(np.array(free, float)), losing),
    ]
    if closed is not None:
        frame = np.hstack([row.T, question.inputs])
        falling = -frame.T @ (closed @ P + P @ closed.T) @ frame / question.rate
        kept = np.array([*np.flatnonzero(free), *range(r, n)])
        inequalities.append((-margin * np.eye(len(kept)), falling[:, kept][:, :, kept]))
        lossless = [i for i in range(r) if not free[i]]
        equations += [(falling[:, i, j], 0.0) for i in lossless for j in range(r, n)]
    found = SemidefiniteProgram(np.eye(width)[-1], inequalities, equations).solution()
    return None if found is None else (found[:count], np.einsum("k,kij->ij", found, P))
