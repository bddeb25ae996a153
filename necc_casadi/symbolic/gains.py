"""Dissipation as a sum of gains, R(z) = Σ φₖ(z) rₖrₖᵀ + rest, and what vanishes where a gain does.

If ψ ≥ 0 near a point, or ψ ≤ 0, then ∇ψ = 0 wherever ψ = 0 there, so that ∇ψ vanishes along with
ψ. Without that a Hessian says nothing: ψ = p² + q³ has ∇²ψ(0) ⪰ 0 and zeros with p ≠ 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import sympy as sp

from necc_casadi.symbolic.linear_algebra import tidy
from necc_casadi.symbolic.semidefinite import blocks, is_positive_semidefinite
from necc_casadi.symbolic.zero import is_zero

__all__ = ["Factor", "Gain", "Gains", "factors", "gains", "has_one_sign", "is_never_negative"]


class Gain(NamedTuple):
    """One term φ(z) rrᵀ."""

    phi: sp.Expr
    direction: sp.Matrix  # (n, 1), constant


@dataclass(frozen=True, eq=False)
class Gains:
    """R(z) = Σ φₖ(z) rₖrₖᵀ + rest, the rₖ independent of each other."""

    terms: tuple[Gain, ...]
    rest: sp.Matrix  # n × n, the diagonal blocks for which no constant rₖ were found


class Factor(NamedTuple):
    """One factor ψᵏ of a gain."""

    psi: sp.Expr
    power: int


def gains(R: sp.Matrix) -> Gains:
    """The gains of a symmetric n × n matrix: R = LDLᵀ, block by block, where L is constant."""
    terms: list[Gain] = []
    rest = sp.zeros(R.rows, R.rows)
    for block in blocks(R):
        part = R.extract(block, block)
        found = _eliminated(part)
        if found is None:
            for a, i in enumerate(block):
                for b, j in enumerate(block):
                    rest[i, j] = part[a, b]
            continue
        for phi, short in found:
            direction = sp.zeros(R.rows, 1)
            for a, i in enumerate(block):
                direction[i] = short[a]
            terms.append(Gain(phi, direction))
    return Gains(tuple(terms), rest)


def _eliminated(block: sp.Matrix) -> list[Gain] | None:
    """Pivots and columns of L; None where no pivot has a constant column."""
    remaining, found = sp.Matrix(block), list[Gain]()
    while not remaining.is_zero_matrix:
        columns = (_constant_column(remaining, i) for i in range(block.rows))
        gain = next((gain for gain in columns if gain is not None), None)
        if gain is None:
            return None
        found.append(gain)
        taken = gain.phi * gain.direction * gain.direction.T
        remaining = (remaining - taken).applyfunc(tidy)
    return found


def _constant_column(matrix: sp.Matrix, i: int) -> Gain | None:
    """The i-th column over its pivot, if that is constant."""
    phi = matrix[i, i]
    if is_zero(phi) is not False:
        return None
    column = matrix[:, i].applyfunc(lambda e: tidy(e / phi))
    return None if column.free_symbols else Gain(phi, column)


def factors(phi: sp.Expr) -> tuple[Factor, ...]:
    """Factors with Π ψᵏ = φ, as far as algebra finds any; constants are among them.

    A zero of φ is one of a factor: whether the factors are irreducible does not matter.
    """
    exponentials = {e: sp.Dummy(positive=True) for e in phi.atoms(sp.exp)}
    back = {dummy: e for e, dummy in exponentials.items()}
    try:
        product = sp.factor(phi.xreplace(exponentials)).xreplace(back)
    except (sp.PolynomialError, NotImplementedError):
        product = phi
    found = []
    for part in sp.Mul.make_args(product):
        base, power = part.as_base_exp()
        whole = power.is_Integer and power > 0
        found.append(Factor(base, int(power)) if whole else Factor(part, 1))
    return tuple(found)


def is_never_negative(expr: sp.Expr) -> bool:
    """Whether an expression is proved to be ≥ 0 for all real values of its symbols."""
    return is_positive_semidefinite(sp.Matrix([[expr]])) is True


def has_one_sign(factor: Factor, others: Sequence[Factor]) -> bool:
    """Whether ψ is proved to be ≥ 0, or to be ≤ 0, near a point.

    `others` are those factors of a φ ≥ 0 that may vanish there too: where there are none, an odd
    power of ψ has the one sign of φ.
    """
    alone = not others and factor.power % 2 == 1
    return alone or is_never_negative(factor.psi) or is_never_negative(-factor.psi)
