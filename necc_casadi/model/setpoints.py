"""Set-points that move at run time, of fully actuated mechanical plants.

Seen from the set-point, q̂ = q − r + q* and û = u − B⁻¹(∇U(r) − ∇U(q*)), only the potential changes:

    Û(q̂; r) = U(q) − (∇U(r) − ∇U(q*))ᵀq̂,

whose slope at q̂ = q* is that of U there. So Casimirs, networks and damping of the design at q* hold
r, too; what has to be proved again is a region. Parameters θ of M and U that the controller is told
are held in the same way, by ∇U(r; θ) − ∇U(q*; θ₀) with θ₀ of the model.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import sympy as sp

from necc_casadi.arrays import Vector
from necc_casadi.model.lagrangian import Lagrangian, Plants, varied_plant
from necc_casadi.model.plant import Plant
from necc_casadi.model.ranges import Range
from necc_casadi.model.rescale import exactly
from necc_casadi.model.sizes import Sizes
from necc_casadi.symbolic.derivatives import gradient

__all__ = ["SetPoints", "moved", "set_points"]


@dataclass(frozen=True, eq=False)
class SetPoints:
    """A set-point for every coordinate, parameters that are told, and what they change.

    In the units of the model.
    """

    r: tuple[sp.Symbol, ...]  # (k,)
    ranges: tuple[Range, ...]  # (k,); a coordinate that does not move has (q*, q*)
    theta: tuple[sp.Symbol, ...]  # parameters that are told
    told: tuple[Range, ...]  # their ranges
    nominal: tuple[sp.Expr, ...]  # their values in the model
    shift: tuple[sp.Expr, ...]  # (k,) q − q̂, of r
    feedforward: sp.ImmutableMatrix  # (m, 1) u − û, of r and θ
    tilt: sp.ImmutableMatrix  # (k, 1) ∇U(r; θ) − ∇U(q*; θ₀)
    inertia: sp.ImmutableMatrix  # (k, k) M of q and θ
    potential: sp.Expr  # U of q and θ

    def energy(self, q: Sequence[sp.Symbol], rates: Sequence[sp.Symbol]) -> sp.Expr:
        """Of what moves, above its least at r: ½q̇ᵀMq̇ + U(q) − U(r) − tiltᵀ(q − r)."""
        v, U = sp.Matrix(rates), self.potential
        e = sp.Matrix([a - b for a, b in zip(q, self.r, strict=True)])
        there = U.subs(dict(zip(q, self.r, strict=True)))
        motion = (v.T * sp.Matrix(self.inertia) * v)[0, 0] / 2
        return sp.sympify(motion + U - there - (sp.Matrix(self.tilt).T * e)[0, 0])


def set_points(
    plant: Plant, q_star: Vector, ranges: Mapping[str, Range], told: Plants | None = None
) -> SetPoints:
    """The set-points of a plant that integral action would cover, by the names of coordinates.

    Parameters
    ----------
    plant
        Fully actuated and mechanical.
    q_star
        Coordinates of the target as the code has them, (k,).
    ranges
        By coordinate; those that are not named stay at q*.
    told
        The plant with parameters that are told at run time; these stand in M and U alone.

    Raises
    ------
    ValueError
        Where they stand elsewhere.
    """
    k, star = plant.n // 2, exactly(q_star)
    q = plant.x[:k]
    varied = varied_plant(plant, told)
    if varied is None or varied.inertia is None or varied.R != plant.R:
        raise ValueError("parameters that are told stand in M and U alone")
    r = tuple(sp.Dummy(f"r_{s}", real=True) for s in q)
    at_rest = dict.fromkeys(plant.x[k:], sp.Integer(0))
    U = varied.H.subs(at_rest)
    there, here = (dict(zip(q, at, strict=True)) for at in (r, star))
    own = sp.Matrix(gradient(plant.H.subs(at_rest), q)).subs(here)
    tilt = sp.Matrix(gradient(U, q)).subs(there) - own
    names = [] if told is None else list(told.ranges)
    return SetPoints(
        r=r,
        ranges=tuple(ranges.get(str(s), (v, v)) for s, v in zip(q, star, strict=True)),
        theta=tuple(sp.Symbol(name, real=True) for name in names),
        told=() if told is None else tuple(told.ranges.values()),
        nominal=() if told is None else tuple(told.parametric.values[name] for name in names),
        shift=tuple(a - b for a, b in zip(r, star, strict=True)),
        feedforward=sp.ImmutableMatrix(sp.Matrix(plant.G[k:, :]).inv() * tilt),
        tilt=sp.ImmutableMatrix(tilt),
        inertia=varied.inertia,
        potential=U,
    )


def moved(plant: Lagrangian, points: SetPoints, units: Sizes) -> Lagrangian:
    """M and U as functions of q̂, r and θ, which have ranges; in natural units but for these."""
    sizes = exactly(np.asarray(units.state[: len(plant.q)], float))
    place = {
        s: s + shift / size for s, shift, size in zip(plant.q, points.shift, sizes, strict=True)
    }
    still = {s: lo for s, (lo, hi) in zip(points.r, points.ranges, strict=True) if lo == hi}
    ranges = {s: side for s, side in zip(points.r, points.ranges, strict=True) if s not in still}

    def there(expr: sp.Expr) -> sp.Expr:
        return expr.subs(place, simultaneous=True).subs(still)

    M = sp.ImmutableMatrix(plant.M.applyfunc(there))
    return Lagrangian(plant.q, M, there(plant.U), plant.R, plant.B, {**ranges, **plant.ranges})
