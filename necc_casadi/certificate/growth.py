"""How a network rises around a point: f ≥ f(v̄) + k(ρ) where |A(v − v̄)| = ρ, by shells.

With ∇²f ⪰ ν(ρ)AᵀA on the shells of the ellipsoid |A(v − v̄)| ≤ size, the slope of f along every ray
from v̄ is at least s(ρ) = ∫₀^ρ ν less the tiny slope at v̄, and k(ρ) = ∫₀^ρ s. Shells end where s is
no longer positive: inside, f has no other critical point.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from necc_casadi.certificate.core import ellipsoid_cells, half_axes, lower_curvature
from necc_casadi.certificate.definite import norm
from necc_casadi.certificate.enclosures import over_pieces
from necc_casadi.certificate.intervals import Interval, matmul, point
from necc_casadi.networks import Network, Vector

__all__ = ["Growth", "growth"]

_SHELLS = 8
#: How far ν stays below what is proved: balls enclose less sharply.
_ROOM = 0.02
#: Cells per axis of the box around the ellipsoid, by dimension.
_PARTS = {1: 128, 2: 32, 3: 14}
_FEWEST_PARTS = 6
#: Bounds leave this much room, so that other arithmetic can confirm them.
_EASE = 1e-6


@dataclass(frozen=True, eq=False)
class Growth:
    """Shells |A(v − v̄)| ≤ radii with ∇²f ⪰ νAᵀA, and ∇²f ⪯ above·AᵀA on all of them."""

    bottom: Interval  # f(v̄)
    slope: float  # ≥ the steepest slope at v̄, in the norm |A·|
    radii: Vector  # (shells,), outer radius of each
    nu: Vector  # (shells,)
    above: float

    @property
    def dip(self) -> float:
        """How far f may fall below f(v̄)."""
        return self.slope**2 / (2 * float(self.nu[0])) * (1 + _EASE)

    def radius(self, height: float) -> float:
        """A radius beyond which f − f(v̄) exceeds `height`, up to the last shell; ∞ if none."""
        for inner, width, slope, start, nu in self._pieces():
            end = slope + nu * width
            if start + width * (slope + end) / 2 * (1 - _EASE) > height:
                left = height - start
                root = math.sqrt(max(slope**2 + 2 * nu * left, 0.0))
                step = 2 * left / (slope + root) if slope + root > 0 else width
                return inner + min(step * (1 + _EASE), width)
        return math.inf

    def rise(self, rho: float) -> float:
        """A lower bound of f − f(v̄) where |A(v − v̄)| ≥ ρ, up to the last shell."""
        total = -self.dip
        for inner, width, slope, start, nu in self._pieces():
            step = min(width, rho - inner)
            if step > 0:
                total = max(total, start + step * (slope + nu * step / 2) - 1e-15)
        return total

    @property
    def height(self) -> float:
        """The rise at the last radius."""
        return self.rise(float(self.radii[-1]))

    def _pieces(self) -> Iterator[tuple[float, float, float, float, float]]:
        """(inner radius, width, slope and rise there, ν) of each shell."""
        slope, rise = -self.slope, 0.0
        for (inner, outer), nu in zip(pairwise([0.0, *self.radii]), self.nu, strict=True):
            width = float(outer - inner)
            yield float(inner), width, slope, rise, float(nu)
            rise += width * (slope + nu * width / 2)
            slope += float(nu) * width


def growth(network: Network, weights: Vector, middle: Vector, A: Vector, size: float) -> Growth:
    """Shells around `middle` up to `size`; none where f is not convex there."""
    at = over_pieces(network, weights, point(middle[None]))
    slope = norm(matmul(np.asarray(np.linalg.inv(A).T, float), at.grad[0][:, None])[:, 0])
    steepest = float(slope) * (1 + _EASE) + 1e-15
    parts = _PARTS.get(len(A), _FEWEST_PARTS)
    step = np.asarray(np.exp2(np.round(np.log2(2 * half_axes(A.T, size) / parts))), float)
    cells, lowest, highest = ellipsoid_cells(middle, A.T, size, step)
    hess = over_pieces(network, weights, cells).hess
    curvature = lower_curvature(hess, A.T)
    outer = size * np.arange(1, _SHELLS + 1) / _SHELLS
    inner = np.concatenate([[0.0], outer[:-1]])
    meets = (lowest[:, None] <= outer) & (highest[:, None] >= inner)
    nu = np.where(meets, curvature[:, None], np.inf).min(0) - _ROOM
    ends = np.cumsum(nu * (outer - inner)) - steepest
    count = int(np.argmax(~(ends > 0))) if not (ends > 0).all() else _SHELLS
    kept = lowest <= (outer[count - 1] if count else 0.0)
    above = _ROOM - float(lower_curvature(-hess[kept], A.T).min()) if count else math.inf
    return Growth(at.value[0], steepest, outer[:count], nu[:count], above)
