"""Regions of plants whose curved Casimirs alone shape V, as data: a level, and where q stays.

With H constant in q when the momenta rest, as many Casimirs c as states q, and
∇²K ⪰ F_K ≻ 0, ∇²Hc ⪰ F_H ≻ 0 for all arguments,

    V − V(z̄) ≥ f = ½|c − c̄|²_{F_K} + ½|ξ − ξ̄|²_{F_H},

which no network enters. Where f > h on the faces that q may not cross, and each q of the fibre
ξ = ξ̄ has f > h or det ∂c/∂q ≠ 0, the component of {V ≤ V(z̄) + h} with z̄ is compact and z̄ its one
critical point (docs/theory.md, curved Casimirs).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from necc_casadi.arrays import Vector
from necc_casadi.symbolic.expressions import parse

__all__ = ["CurvedRegion", "Faces"]

#: Points at which V is looked at on a straight way, at least and at most, their distance in natural
#: units at most, so that no period of an angle is stepped over; and descents that are tried.
_POINTS, _MOST_POINTS, _STRIDE, _DESCENTS = 65, 10_000, 0.1, 200


@dataclass(frozen=True)
class Faces:
    """Where a state q ends, as exact numbers: poles of the loop, or bounds of the user's."""

    state: int  # position in `active`
    lo: str
    hi: str


@dataclass(frozen=True)
class CurvedRegion:
    """Ω as a level and what proves it; the states q between no faces are angles."""

    level: float  # c
    active: tuple[int, ...]  # the states y = (q, ξ), indices in z; the others are momenta
    floor_k: tuple[float, ...]  # F_K, diagonal, one per state q
    floor_h: tuple[float, ...]  # F_H, one per ξ
    height: float  # h ≥ c − V(z̄)
    faces: tuple[Faces, ...]
    columns: tuple[int, ...]  # of the rows of ξ in Jcl − Rcl: a regular block
    center: tuple[float, ...]  # near z̄, in the active states
    method: Literal["curved"] = "curved"

    @property
    def r(self) -> int:
        """Number of states q and of Casimirs."""
        return len(self.floor_k)

    def contains(self, V: Callable[[Sequence[float]], float], z: Sequence[float]) -> bool:
        """Whether z is in Ω, by plain evaluation of V.

        Other components may have the same level: c does not tell all attitudes apart. A way from z
        to z̄ inside {V ≤ c} is looked for, down the slope and then straight. Ω holds no critical
        point but z̄, so that all ways down lead there; angles count as they stand.
        """

        def value(v: Vector) -> float:
            return V(v.tolist())

        at, end = np.asarray(z, float), np.zeros(len(z))
        end[list(self.active)] = self.center
        far = float(np.abs(end - at).max())
        if not (far <= _STRIDE * _MOST_POINTS and self._may_hold(at) and value(at) <= self.level):
            return False
        step = 0.1
        for _ in range(_DESCENTS):
            count = max(_POINTS, math.ceil(np.abs(end - at).max() / _STRIDE) + 1)
            ways = at + np.linspace(0.0, 1.0, count)[:, None] * (end - at)
            if all(value(way) <= self.level for way in ways):
                return True
            slope = _slope(value, at)
            size = float(np.linalg.norm(slope))
            lower = at - step * slope / (size or 1.0)
            while step > 1e-9 and not value(lower) <= value(at) - 0.1 * step * size:
                step /= 2
                lower = at - step * slope / (size or 1.0)
            if not value(lower) < value(at):
                return False
            at, step = lower, min(0.1, 2 * step)
        return False

    def _may_hold(self, z: Vector) -> bool:
        """Whether q is between its faces and ξ in the ellipsoid f ≤ h."""
        sides = [(self.active[f.state], parse(f.lo), parse(f.hi)) for f in self.faces]
        off = (z[list(self.active)] - self.center)[self.r :]
        rise = float(np.asarray(self.floor_h) @ off**2) / 2
        return rise <= self.height and all(float(lo) < z[i] < float(hi) for i, lo, hi in sides)


def _slope(V: Callable[[Vector], float], z: Vector) -> Vector:
    """∇V by central differences."""
    steps = 1e-6 * np.maximum(1.0, np.abs(z))
    units = np.eye(len(z)) * steps[:, None]
    return np.array([(V(z + u) - V(z - u)) / (2 * h) for u, h in zip(units, steps, strict=True)])
