"""Set-points that move at run time, of fully actuated mechanical plants.

Seen from the set-point, q̂ = q − r + q* and û = u − B⁻¹(∇U(r) − ∇U(q*)), only the potential changes:

    Û(q̂; r) = U(q) − (∇U(r) − ∇U(q*))ᵀq̂,

whose slope at q̂ = q* is that of U there. So Casimirs, networks and damping of the design at q* hold
r, too; what has to be proved again is a region.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import sympy as sp

from necc_casadi.arrays import Vector
from necc_casadi.model.lagrangian import Lagrangian
from necc_casadi.model.plant import Plant
from necc_casadi.model.ranges import Range
from necc_casadi.model.rescale import exactly
from necc_casadi.model.sizes import Sizes
from necc_casadi.symbolic.derivatives import gradient

__all__ = ["SetPoints", "moved", "set_points"]


@dataclass(frozen=True, eq=False)
class SetPoints:
    """A set-point for every coordinate, and what it changes; in the units of the model."""

    r: tuple[sp.Symbol, ...]  # (k,)
    ranges: tuple[Range, ...]  # (k,); a coordinate that does not move has (q*, q*)
    shift: tuple[sp.Expr, ...]  # (k,) q − q̂, of r
    feedforward: sp.ImmutableMatrix  # (m, 1) u − û, of r
    tilt: sp.ImmutableMatrix  # (k, 1) ∇U(r) − ∇U(q*), of r


def set_points(plant: Plant, q_star: Vector, ranges: Mapping[str, Range]) -> SetPoints:
    """The set-points of a plant that integral action would cover, by the names of coordinates.

    Parameters
    ----------
    plant
        Fully actuated and mechanical.
    q_star
        Coordinates of the target as the code has them, (k,).
    ranges
        By coordinate; those that are not named stay at q*.
    """
    k, star = plant.n // 2, exactly(q_star)
    q = plant.x[:k]
    r = tuple(sp.Dummy(f"r_{s}", real=True) for s in q)
    U = plant.H.subs(dict.fromkeys(plant.x[k:], sp.Integer(0)))
    slope = sp.Matrix(gradient(U, q))
    there, here = (dict(zip(q, at, strict=True)) for at in (r, star))
    tilt = slope.subs(there) - slope.subs(here)
    return SetPoints(
        r=r,
        ranges=tuple(ranges.get(str(s), (v, v)) for s, v in zip(q, star, strict=True)),
        shift=tuple(a - b for a, b in zip(r, star, strict=True)),
        feedforward=sp.ImmutableMatrix(sp.Matrix(plant.G[k:, :]).inv() * tilt),
        tilt=sp.ImmutableMatrix(tilt),
    )


def moved(plant: Lagrangian, points: SetPoints, units: Sizes) -> Lagrangian:
    """M and U as functions of q̂ and r, which has ranges; in natural units but for r."""
    sizes = exactly(np.asarray(units.state[: len(plant.q)], float))
    place = {
        s: s + shift / size for s, shift, size in zip(plant.q, points.shift, sizes, strict=True)
    }
    still = {s: lo for s, (lo, hi) in zip(points.r, points.ranges, strict=True) if lo == hi}
    ranges = {s: side for s, side in zip(points.r, points.ranges, strict=True) if s not in still}

    def there(expr: sp.Expr) -> sp.Expr:
        return expr.subs(place, simultaneous=True).subs(still)

    M = sp.ImmutableMatrix(plant.M.applyfunc(there))
    return Lagrangian(plant.q, M, there(plant.U), plant.R, plant.B, ranges)
