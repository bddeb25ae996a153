"""ẋ = f + G u in natural units, as the search for a constant structure sees it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import sympy as sp

from necc_casadi.arrays import Vector
from necc_casadi.methods.structure_family import dissipation
from necc_casadi.symbolic.definiteness import definiteness, rational
from necc_casadi.symbolic.derivatives import at
from necc_casadi.symbolic.expressions import split_logarithms
from necc_casadi.symbolic.floats import float_matrix, to_float
from necc_casadi.symbolic.linear_algebra import kernel

__all__ = ["DIGITS", "PARALLEL", "Question", "natural_sizes", "power_of_two", "rounded"]


#: Decimal digits to which proposals are rounded, the fewest first.
DIGITS = (2, 3, 5, 8, 12)


#: Share of a vector across another one below which it is taken as rounding.
PARALLEL = 1e-9


@dataclass(frozen=True, eq=False)
class Question:
    """ẋ = f + G u at an equilibrium, in units in which every state has a natural size."""

    f: sp.Matrix  # n × 1
    G: sp.Matrix  # n × m, constant
    x: tuple[sp.Symbol, ...]
    x_star: Mapping[sp.Symbol, sp.Expr]
    sizes: tuple[sp.Rational, ...]  # (n,) powers of two
    cheap: Vector | None = None  # (m, n) gains of LQR, in the units of the model

    @property
    def T(self) -> sp.Matrix:
        """The sizes as a diagonal matrix."""
        return sp.diag(*self.sizes)

    @cached_property
    def annihilator(self) -> sp.Matrix:
        """G⊥, its rows scaled to about 1 in natural units."""
        rows = kernel(self.G.T).T
        sized = float_matrix(rows * self.T)
        scale = [power_of_two(1 / float(np.linalg.norm(row))) for row in sized]
        return sp.diag(*scale) * rows if scale else rows

    @cached_property
    def s(self) -> sp.Matrix:
        """G⊥f."""
        return (self.annihilator * self.f.applyfunc(split_logarithms)).applyfunc(sp.expand)

    @cached_property
    def slopes(self) -> sp.Matrix:
        """∂s/∂x."""
        return sp.Matrix(self.s).jacobian(self.x)

    @cached_property
    def slopes_there(self) -> sp.Matrix:
        """∂s/∂x at x*."""
        return sp.Matrix(at(self.slopes, self.x_star))

    @property
    def inputs(self) -> Vector:
        """G, in natural units, its columns scaled to 1."""
        G = float_matrix(self.T.inv() * self.G)
        return np.asarray(G / np.linalg.norm(G, axis=0), float)

    @cached_property
    def cheap_loop(self) -> Vector | None:
        """A − GK of LQR, in natural units."""
        if self.cheap is None:
            return None
        size = np.diag(float_matrix(self.T))
        A = float_matrix(at(self.f.jacobian(self.x), self.x_star))
        return np.asarray((A - float_matrix(self.G) @ self.cheap) * size / size[:, None], float)

    @cached_property
    def rate(self) -> float:
        """The fastest rate of the linearised plant, in natural units."""
        A = float_matrix(at(self.f.jacobian(self.x), self.x_star) * self.T)
        return float(np.linalg.norm(A / np.diag(float_matrix(self.T))[:, None], 2)) or 1.0

    def proved(self, B: sp.Matrix) -> bool:
        """Whether (ii) and (iii) are proved; (i) holds by the family that B is taken from."""
        curved = B * self.slopes_there.T
        if definiteness((curved + curved.T) / 2)[0] != "positive":
            return False
        return definiteness(dissipation(B, self.annihilator))[0] in ("positive", "flat")


def rounded(values: Vector, digits: int) -> sp.Matrix:
    """A matrix of rationals with so many decimal digits."""
    return sp.Matrix([[rational(float(v), 10**digits) for v in row] for row in values])


def natural_sizes(
    x: Sequence[sp.Symbol],
    A: sp.Matrix,
    given: Mapping[sp.Symbol, float],
    domain: Mapping[str, tuple[sp.Expr, sp.Expr]],
) -> list[sp.Rational]:
    """Powers of two near the sizes of the states.

    Those that nobody gave fit the others best: within the mean time τ of the plant's modes a state
    moves another one by its size, sᵢ = τ|aᵢⱼ|sⱼ. A common factor does not matter.
    """
    known: dict[int, float] = {}
    for i, s in enumerate(x):
        if s in given:
            known[i] = float(given[s])
        elif str(s) in domain:
            lo, hi = domain[str(s)]
            known[i] = to_float(hi - lo) / 4
    rates = float_matrix(A)
    modes = np.abs(np.linalg.eigvals(rates))
    modes = modes[modes > PARALLEL * modes.max()]
    rate = float(np.exp(np.mean(np.log(modes)))) if len(modes) else 1.0
    pairs = [(i, j) for i, j in np.argwhere(rates) if i != j]
    unknown = np.zeros((len(pairs), len(x)))
    for row, (i, j) in zip(unknown, pairs, strict=True):
        row[i], row[j] = 1.0, -1.0
    ratios = np.array([np.log(abs(rates[i, j]) / rate) for i, j in pairs])
    size = np.array([np.log(known.get(i, 1.0)) for i in range(len(x))])
    free = [i for i in range(len(x)) if i not in known]
    if pairs and free:
        rest = ratios - unknown @ size
        size[free] += np.linalg.lstsq(unknown[:, free], rest, rcond=None)[0]
    return [power_of_two(float(value)) for value in np.exp(size)]


def power_of_two(value: float) -> sp.Rational:
    """The nearest power of two, exact in binary and in decimal."""
    exponent = round(float(np.log2(value)))
    return sp.Rational(2**exponent) if exponent >= 0 else sp.Rational(1, 2**-exponent)
