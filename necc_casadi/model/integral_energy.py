"""The energy W of integral action that x alone gives, for each end of what is not known.

    W = ½vᵀMv + Ũ + K₀ + H₀ + ½eᵀ(BDBᵀ + R − M/τ)e/τ + ½(ζ − ζ*)ᵀKᵢ⁻¹(ζ − ζ*)/τ,   v = q̇ + e/τ.

Parameters θ that enter M, U and R to the first power make W largest at an end of each.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
import sympy as sp

from necc_casadi.arrays import Vector
from necc_casadi.model.lagrangian import Plants, varied_plant
from necc_casadi.model.measurement import Measurement
from necc_casadi.model.parametric import Parametric
from necc_casadi.model.plant import Plant
from necc_casadi.model.rescale import exactly
from necc_casadi.symbolic.derivatives import gradient
from necc_casadi.symbolic.expressions import parse
from necc_casadi.symbolic.zero import is_zero

__all__ = ["KnownEnergy", "known_energy"]


#: Unknown parameters of which all ends are looked at.
_MOST = 6


@dataclass(frozen=True, eq=False)
class KnownEnergy:
    """M, U and R of a plant at all ends of the parameters that are not known."""

    plant: Plant  # of the design
    inertias: tuple[sp.ImmutableMatrix, ...]
    potentials: tuple[sp.Expr, ...]
    frictions: tuple[sp.ImmutableMatrix, ...]

    @cached_property
    def measured(self) -> Measurement:
        """Symbols of what is measured, (q, q̇)."""
        return Measurement(self.plant)

    def parts(self, q_star: Vector, tau: float, D: Vector, slope: Vector) -> list[sp.Expr]:
        """W without K₀ + H₀ and ζ, but less `slope` of Hc + K at rest (k,) times e, at each end."""
        k, measured = self.plant.n // 2, self.measured
        q, rates = measured.y[:k], sp.Matrix(measured.y[k:])
        (step,), star = exactly(np.array([tau])), exactly(q_star)
        there, e = dict(zip(q, star, strict=True)), sp.Matrix(q) - sp.Matrix(star)
        B, damping = sp.Matrix(self.plant.G[k:, :]), sp.Matrix(k, k, exactly(D.ravel()))
        own, v, found = sp.Matrix(exactly(slope)), rates + e / step, []
        ends = zip(self.inertias, self.potentials, self.frictions, strict=True)
        for M, U, R in ends:
            stiff = B * damping * B.T + R - M / step
            along = sp.Matrix(gradient(U, q)).subs(there) + own
            energy = (v.T * sp.Matrix(M) * v)[0, 0] / 2 + (e.T * stiff * e)[0, 0] / (2 * step)
            found.append(energy + U - U.subs(there) - (along.T * e)[0, 0])
        return found


def known_energy(
    plant: Plant, ranges: Mapping[str, Sequence[str]], parametric: Parametric | None
) -> KnownEnergy | str:
    """At all ends of these ranges; or why W is not known to be largest at one.

    Parameters
    ----------
    plant
        Of the design, without :func:`integral_obstacle`.
    ranges
        Parameter -> its ends as texts; {}: the plant is that of the design.
    parametric
        The plant with its parameters as symbols.
    """
    if len(ranges) > _MOST:
        return f"more than {_MOST} parameters are not known"
    sides = {name: (parse(lo, {}), parse(hi, {})) for name, (lo, hi) in ranges.items()}
    varied: Plant | None = plant
    if sides:
        here = parametric is not None and set(sides) <= set(parametric.values)
        varied = varied_plant(plant, Plants(parametric, sides)) if parametric and here else None
    if varied is None or varied.inertia is None:
        return "the plant with its unknown parameters did not come with the design"
    k, inertia = plant.n // 2, varied.inertia
    U, R = varied.H.subs(dict.fromkeys(plant.x[k:], sp.Integer(0))), varied.R[k:, k:]
    symbols = [sp.Symbol(name, real=True) for name in sides]
    for s in symbols:
        if any(is_zero(sp.diff(sp.diff(v, s), s)) is not True for v in (U, *inertia, *R)):
            return f"{s} does not enter W to the first power"
    ends = [dict(zip(symbols, values, strict=True)) for values in product(*sides.values())]
    return KnownEnergy(
        plant,
        tuple(sp.ImmutableMatrix(inertia.subs(theta)) for theta in ends),
        tuple(U.subs(theta) for theta in ends),
        tuple(sp.ImmutableMatrix(R.subs(theta)) for theta in ends),
    )
