"""Attraction by dissipation that vanishes at z̄, re-proved in balls.

A motion without loss keeps 𝒢ᵀw = 0 and wᵀRcl w = 0, w = ∇V. Where Rcl = Σ φₖrₖrₖᵀ + rest with every
φₖ ≥ 0 and everything is analytic, rₖᵀw or one factor of φₖ is zero all along it. Whichever are, the
outputs that vanish then must leave no motion of ż = Jcl w near z̄ unobserved. Gains and factors are
found by algebra and count only where they multiply out to Rcl and φₖ again.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain

import sympy as sp
from flint import arb, arb_mat, ctx

from necc_casadi.certificate.checker.arithmetic.balls import Box, ball, evaluate
from necc_casadi.certificate.checker.arithmetic.potential import Energy, hessian_hull
from necc_casadi.certificate.checker.arithmetic.smooth import is_smooth_on
from necc_casadi.symbolic.gains import Factor, Gains, factors, gains
from necc_casadi.symbolic.semidefinite import is_positive_semidefinite
from necc_casadi.symbolic.zero import is_zero

__all__ = ["no_motion_near"]


#: Precision of eliminations, and choices of vanishing factors that are looked at.
_BITS, _MOST_CHOICES = 128, 1000


Row = list[arb]


def no_motion_near(energy: Energy, box: Box) -> bool:
    """Whether only rest keeps V constant near z̄ in the box, in all states.

    That z̄ is an equilibrium of an analytic loop, along which V decreases, is left to others.
    """
    with ctx.workprec(_BITS):
        return _Outputs(energy, box).leave_nothing()


class _Outputs:
    """Rows that vanish on motions without loss, over a box that holds z̄."""

    def __init__(self, energy: Energy, box: Box) -> None:
        model = energy.model
        self.model, self.z, self.box = model, model.z, box
        self.values = {s: ball(*side) for s, side in zip(model.z, box, strict=True)}
        self.P = hessian_hull(energy, box)
        self.A = self._enclosed(model.Jcl) * self.P
        self.looked_at = 0

    def _enclosed(self, matrix: sp.Matrix) -> arb_mat:
        return arb_mat([[evaluate(e, self.values) for e in row] for row in matrix.tolist()])

    def _through(self, matrix: sp.Matrix) -> list[Row]:
        """Rows of a matrix times ∇²V."""
        product: list[Row] = (self._enclosed(matrix) * self.P).tolist()
        return product

    def leave_nothing(self) -> bool:
        """Whether the pair is observable, whatever vanishes of each gain."""
        split = gains(self.model.Rcl)
        if not _adds_up(split, self.model.Rcl):
            return False
        seen = self._through(self.model.ports.T) + self._through(split.rest)
        alternatives: list[list[list[Row]]] = []
        for phi, r in split.terms:
            output = self._through(r.T)
            if evaluate(phi, self.values) > 0:
                seen += output
                continue
            vanishing = self._vanishing(phi)
            if vanishing is None:
                return False
            alternatives.append([output, *vanishing])
        return self._whatever(seen, alternatives)

    def _vanishing(self, phi: sp.Expr) -> list[list[Row]] | None:
        """Rows that are zero along with a factor of φ, for each that may be; None: not known."""
        found = factors(phi)
        product = sp.Mul(*[factor.psi**factor.power for factor in found])
        if is_positive_semidefinite(sp.Matrix([[phi]])) is not True:
            return None  # φ ≥ 0 for all states
        if is_zero(product - phi) is not True:
            return None
        values = [evaluate(factor.psi, self.values) for factor in found]
        if not all(value.is_finite() for value in values):
            return None
        left = [f for f, value in zip(found, values, strict=True) if value.contains(0)]
        if not is_smooth_on([factor.psi for factor in left], self.z, self.box):
            return None
        rows = [self._with(factor, left) for factor in left]
        finite = all(value.is_finite() for table in rows for row in table for value in row)
        return rows if finite else None

    def _with(self, factor: Factor, left: Sequence[Factor]) -> list[Row]:
        slopes = [sp.diff(factor.psi, s) for s in self.z]
        rows = [slopes]
        if _has_one_sign(factor, alone=len(left) == 1):
            rows += [[sp.diff(slope, s) for s in self.z] for slope in slopes]
        table: list[Row] = self._enclosed(sp.Matrix(rows)).tolist()
        return table

    def _whatever(self, seen: list[Row], alternatives: Sequence[Sequence[list[Row]]]) -> bool:
        self.looked_at += 1
        if self.looked_at > _MOST_CHOICES:
            return False
        if _rank(self.A, seen) == len(self.z):
            return True
        if not alternatives:
            return False
        return all(self._whatever(seen + more, alternatives[1:]) for more in alternatives[0])


def _adds_up(split: Gains, R: sp.Matrix) -> bool:
    """Whether the gains and what is left are R, with constant directions, in blocks of their own.

    Rw = 0 then splits into rest·w = 0 and Σ φₖ(rₖᵀw)² = 0.
    """
    directions = [gain.direction for gain in split.terms]
    if any(r.free_symbols for r in directions):
        return False
    used = {i for r in directions for i, e in enumerate(r) if e != 0}
    if any(e != 0 for i in used for e in split.rest.row(i)):
        return False
    left = R - split.rest
    for phi, r in split.terms:
        left -= phi * r * r.T
    return all(is_zero(e) is True for e in left)


def _has_one_sign(factor: Factor, alone: bool) -> bool:
    """Whether ψ is ≥ 0 or ≤ 0 near z̄: everywhere, or as the one factor of φ ≥ 0 that is 0 there.

    φ/(what is not 0) = ψᵏ has one sign near z̄, and with an odd k so has ψ.
    """
    if alone and factor.power % 2:
        return True
    both = (factor.psi, -factor.psi)
    return any(is_positive_semidefinite(sp.Matrix([[psi]])) is True for psi in both)


def _rank(A: arb_mat, outputs: Sequence[Row]) -> int:
    """How many of the rows outputs·Aᵏ are certainly independent.

    Elimination with the largest pivots first, which leave the least doubt; a pivot whose ball
    holds 0 is none.
    """
    reduced: list[tuple[int, Row]] = []
    block = [list(row) for row in outputs]
    while block:
        fresh: list[Row] = []
        waiting = [_reduced(row, reduced) for row in block]
        while waiting:
            best = max(range(len(waiting)), key=lambda i: _certain(waiting[i])[0])
            size, lead = _certain(waiting[best])
            if size <= 0:
                break
            row = waiting.pop(best)
            row = [v / row[lead] for v in row]
            reduced.append((lead, row))
            fresh.append(row)
            waiting = [_reduced(other, [(lead, row)]) for other in waiting]
        block = (arb_mat(fresh) * A).tolist() if fresh else []
    return len(reduced)


def _certain(row: Row) -> tuple[float, int]:
    """The largest lower bound of an entry's size, and where; 0 where none excludes 0.

    Compared with the largest entry of the row, so that a row of mere doubt comes last.
    """
    sizes = [float(v.abs_lower()) if v.is_finite() else 0.0 for v in row]
    widest = max(chain([1e-300], (float(v.abs_upper()) for v in row if v.is_finite())))
    lead = max(range(len(row)), key=sizes.__getitem__)
    return sizes[lead] / widest, lead


def _reduced(row: Row, pivots: Sequence[tuple[int, Row]]) -> Row:
    for lead, other in pivots:
        factor = row[lead]
        if not factor.is_zero():
            row = [a - factor * b for a, b in zip(row, other, strict=True)]
            row[lead] = arb(0)
    return row
