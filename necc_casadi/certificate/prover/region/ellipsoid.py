"""Region of attraction in an ellipsoid around z̄, for more coupled states than a grid can hold.

With P = LLᵀ near ∇²V(z̄) and |e| = ‖Lᵀe‖ for e = y − ȳ, let ∇²V ⪰ ν(|e|)P on the ellipsoid |e| ≤ ρ,
ν constant on shells and negative where it must be. Along every ray from ȳ the slope of V is then
at least s(r) = ∫₀ʳ ν less the tiny slope at ȳ: while it is positive V has no other critical point,
and V ≥ V(ȳ) + ∫₀^ρ s on the boundary of the ellipsoid, which bounds the component of {V ≤ c}.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from necc_casadi.arrays import Vector
from necc_casadi.certificate.claims.regions import EllipsoidRegion, numbers, rows
from necc_casadi.certificate.prover.arithmetic.intervals import Interval, point
from necc_casadi.certificate.prover.arithmetic.potential import Potential
from necc_casadi.certificate.prover.region.shells import (
    Curved,
    Shells,
    cell_sides,
    corners,
    ellipsoid_cells,
    half_axes,
    lower_curvature,
    shells,
)

__all__ = ["Ellipsoid", "widest_ellipsoid"]


#: Half-axes that are tried, as shares of the largest ellipsoid in the domain.
_SCALES = (1.0, 0.7, 0.5, 0.35, 0.25, 0.15, 0.1, 0.05, 0.02, 0.01, 5e-3, 2e-3, 1e-3)


#: Shells of V.
_SHELLS = 16


#: Cells per axis of the box around the ellipsoid, by dimension, about.
_PARTS = {2: 64, 3: 24, 4: 14, 5: 8}
_FEWEST_PARTS = 4


#: More cells than this would not fit into memory: no region is claimed then.
_MOST_CELLS = 300_000


#: Shares of the height and of V(ȳ) that are given up, so that other arithmetic can confirm c.
_EASED, _ROUND = 1e-9, 1e-12


@dataclass(frozen=True, eq=False)
class Ellipsoid:
    """Shells ‖Lᵀe‖ ≤ radii with ∇²V ⪰ νP, checked on cells of the box around the ellipsoid."""

    center: Vector  # ȳ (d,)
    L: Vector  # d × d, lower triangular; P = LLᵀ
    step: Vector  # (d,), sides of the cells, powers of two
    shells: Shells

    @property
    def level(self) -> float:
        """c, which V exceeds on the boundary of the ellipsoid."""
        bottom, height = float(self.shells.bottom.lo), self.shells.height
        return bottom + height - _EASED * height - _ROUND * abs(bottom)

    @property
    def radius(self) -> float:
        """ρ."""
        return float(self.shells.radii[-1])

    def boxes(self) -> Interval:
        """Cells that cover the ellipsoid, (B, d)."""
        return ellipsoid_cells(self.center, self.L, self.radius, self.step)[0]

    def hull(self) -> Interval:
        """The box around the ellipsoid, (d,)."""
        half = half_axes(self.L, self.radius)
        lo, hi = self.center - half, self.center + half
        return Interval(np.nextafter(lo, -np.inf), np.nextafter(hi, np.inf))

    def region(self, level: float, active: tuple[int, ...]) -> EllipsoidRegion:
        """What it claims of a level, at most its own."""
        shells = self.shells
        return EllipsoidRegion(
            level, active, numbers(self.center), rows(self.L), numbers(shells.radii),
            numbers(shells.nu), numbers(self.step), shells.above,
        )  # fmt: skip


def widest_ellipsoid(
    potential: Potential, center: Vector, lo: Vector, hi: Vector
) -> Ellipsoid | None:
    """The ellipsoid in the box [lo, hi] with the largest proved level; None where there is none."""
    hess = potential.jet(point(center[None])).hess.mid[0]
    if not np.isfinite(hess).all() or np.linalg.eigvalsh(hess + hess.T)[0] <= 0:
        return None
    L = np.asarray(np.linalg.cholesky((hess + hess.T) / 2), float)
    widest = float(np.min(np.minimum(hi - center, center - lo) / half_axes(L, 1.0)))
    best: Ellipsoid | None = None
    for scale in _SCALES:
        found = _ellipsoid(potential, center, L, scale * widest * (1 - 1e-9))
        if found is not None and (best is None or found.level > best.level):
            best = found
        elif best is not None:
            break
    return best


def _ellipsoid(potential: Potential, center: Vector, L: Vector, radius: float) -> Ellipsoid | None:
    """Shells of one ellipsoid; None where V is not proved convex at its centre."""
    step = cell_sides(L.T, radius, _PARTS.get(center.size, _FEWEST_PARTS))
    central = Interval(center - step / 2, center + step / 2)[None, :]
    if not lower_curvature(potential.lower_hessian(central), L)[0] > 0:
        return None
    first, last = corners(center, L, radius, step)
    if np.prod(last - first + 1.0) > _MOST_CELLS:
        return None
    V = Curved(potential.jet, potential.lower_hessian)
    found = shells(V, center, L.T, radius, step, _SHELLS, 0.0)
    return Ellipsoid(center, L, step, found) if found.radii.size else None
