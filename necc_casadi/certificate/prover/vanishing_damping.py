"""z̄ attracts though the linearisation is not Hurwitz: dissipation that vanishes there does it.

With Rcl = Σ φₖ(z) rₖrₖᵀ + rest ⪰ 0, an analytic motion without loss keeps 𝒢ᵀ∇V = 0, rest·∇V = 0 and
every φₖ·(rₖᵀ∇V)² = 0, so that rₖᵀ∇V or a factor ψ of φₖ vanishes identically along it. For each
such choice the pair (Jcl(z̄)∇²V(z̄), outputs) is proved to be observable, for every place z̄ in a
box: then no motion near z̄ but rest makes it (docs/theory.md#damping-that-vanishes-at-the-target).
A ψ that is not told from 0 at z̄ counts as a choice; where ψ(z̄) ≠ 0 no motion near z̄ makes it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import sympy as sp

from necc_casadi.arrays import Vector
from necc_casadi.certificate.claims import statements
from necc_casadi.certificate.claims.claim import Claim
from necc_casadi.certificate.prover.arithmetic.boxes import matrix_enclosure
from necc_casadi.certificate.prover.arithmetic.definite import regular
from necc_casadi.certificate.prover.arithmetic.intervals import (
    Interval,
    concatenate,
    matmul,
    stack,
)
from necc_casadi.certificate.prover.arithmetic.potential import Potential
from necc_casadi.certificate.prover.arithmetic.smooth import is_smooth_on
from necc_casadi.designs.design import Design
from necc_casadi.symbolic.derivatives import gradient, sparse_hessian
from necc_casadi.symbolic.gains import factors, gains, has_one_sign, is_never_negative

__all__ = ["prove_slow_attraction"]


#: Choices of vanishing factors that are looked at; beyond, nothing is proved.
_MOST_CHOICES = 1000


#: A row counts as independent where it is this many times as long as its entries are uncertain.
_CLEAR = 1e3


def prove_slow_attraction(potential: Potential, box: Interval) -> Claim | None:
    """z̄ in a box (N,) is locally asymptotically stable, without a rate; None: not proved.

    An equilibrium of an analytic loop along which V decreases has to be proved as well.
    """
    with np.errstate(all="ignore"):
        holds = _Choices(potential, box).all_observable()
    return Claim("attraction", True, statements.attraction(None)) if holds else None


class _Choices:
    """Outputs that vanish along a motion without loss, over a box that holds z̄."""

    def __init__(self, potential: Potential, box: Interval) -> None:
        self.design: Design = potential.design
        self.box, self.z, self.tests = box, self.design.loop.z, 0
        self.P = potential.jet(box[None, :]).hess[0]
        self.A = matmul(self._enclosed(self.design.loop.J), self.P)

    def _enclosed(self, matrix: sp.MatrixBase) -> Interval:
        return matrix_enclosure(matrix, self.z, self.box[None, :])[0]

    def _through(self, rows: sp.MatrixBase) -> Interval:
        """The rows, k × N, times ∇²V."""
        return matmul(self._enclosed(rows), self.P)

    def all_observable(self) -> bool:
        """Whether the pair is observable for every choice."""
        split = gains(sp.Matrix(self.design.loop.R))
        always = concatenate(
            self._through(sp.Matrix(self.design.loop.ports).T), self._through(split.rest)
        )
        choices: list[list[Interval]] = []
        for phi, r in split.terms:
            seen = self._through(r.T)
            if self._value(phi).lo > 0:
                always = concatenate(always, seen)
            else:
                vanishing = self._rows(phi) if is_never_negative(phi) else None
                if vanishing is None:
                    return False
                choices.append([seen, *vanishing])
        return self._from(always, choices)

    def _value(self, expr: sp.Expr) -> Interval:
        return self._enclosed(sp.Matrix([[expr]]))[0, 0]

    def _may_vanish(self, psi: sp.Expr) -> bool:
        value = self._value(psi)
        return not (value.lo > 0 or value.hi < 0)

    def _rows(self, phi: sp.Expr) -> list[Interval] | None:
        """The rows that vanish with each factor of a gain that may vanish at z̄.

        None where a factor is not proved to be analytic there.
        """
        left = [factor for factor in factors(phi) if self._may_vanish(factor.psi)]
        if not is_smooth_on([factor.psi for factor in left], self.z, self.box):
            return None
        found = []
        for factor in left:
            rows = self._enclosed(gradient(factor.psi, self.z).T)
            if has_one_sign(factor, [other for other in left if other is not factor]):
                bent = self._enclosed(sparse_hessian(factor.psi, self.z))
                rows = concatenate(rows, bent)
            found.append(rows)
        return found

    def _from(self, rows: Interval, choices: Sequence[Sequence[Interval]]) -> bool:
        """With the rows that are chosen, for every choice that is left."""
        self.tests += 1
        if self.tests > _MOST_CHOICES:
            return False
        if _observable(self.A, rows):
            return True
        if not choices:
            return False
        return all(self._from(concatenate(rows, more), choices[1:]) for more in choices[0])


def _observable(A: Interval, outputs: Interval) -> bool:
    """Whether the rows outputs·Aᵏ are proved to span everything, for all that is enclosed.

    From them N rows are combined, with plain numbers as coefficients, that look orthonormal; a
    regular matrix of such rows leaves no motion unobserved.
    """
    size = A.shape[-1]
    length = float(np.abs(A.mid).max())
    if not (np.isfinite(length) and length > 0):
        return False
    A = A * (1 / length)
    kept: list[Interval] = []
    block = [outputs[i] for i in range(outputs.shape[0])]
    while block and len(kept) < size:
        fresh = []
        for row in block:
            left = _independent_part(row, kept)
            if left is not None:
                kept.append(left)
                fresh.append(left)
        block = [matmul(row.reshape(1, size), A)[0] for row in fresh]
    return len(kept) == size and bool(regular(stack(kept, 0)[None])[0])


def _independent_part(row: Interval, kept: Sequence[Interval]) -> Interval | None:
    """The row less its part along others, of length one; None where nothing certain is left."""
    for _ in range(2):  # the second time takes off what rounding left
        for other in kept:
            along = float(np.dot(row.mid, other.mid))
            row = row - other * along
    length = float(np.linalg.norm(row.mid))
    doubt: Vector = row.rad
    if not length > _CLEAR * float(doubt.max()):
        return None
    return row * (1 / length)
