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
from necc_casadi.certificate.prover.arithmetic.intervals import Interval, point
from necc_casadi.certificate.prover.arithmetic.potential import Potential
from necc_casadi.certificate.prover.region.shells import (
    climb,
    corners,
    ellipsoid_cells,
    half_axes,
    lower_curvature,
)

__all__ = ["Ellipsoid", "corners", "widest_ellipsoid"]


#: Half-axes that are tried, as shares of the largest ellipsoid in the domain.
_SCALES = (1.0, 0.7, 0.5, 0.35, 0.25, 0.15, 0.1, 0.05, 0.02, 0.01, 5e-3, 2e-3, 1e-3)


_SHELLS = 16


#: Cells per axis of the box around the ellipsoid, by dimension, about.
_PARTS = {2: 64, 3: 24, 4: 14, 5: 8}


_FEWEST_PARTS = 4


#: More cells than this would not fit into memory: no region is claimed then.
_MOST_CELLS = 300_000


@dataclass(frozen=True, eq=False)
class Ellipsoid:
    """Shells |e| ≤ radii with ∇²V ⪰ νP, checked on cells of the box around the ellipsoid."""

    center: Vector  # ȳ (d,)
    L: Vector  # d × d, lower triangular; P = LLᵀ
    radii: Vector  # (shells,), outer radius of each
    nu: Vector  # (shells,)
    step: Vector  # (d,), sides of the cells, powers of two
    level: float  # c
    above: float  # ∇²V ⪯ above·P there

    @property
    def radius(self) -> float:
        """ρ."""
        return float(self.radii[-1])


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
        found = _shells(potential, center, L, scale * widest * (1 - 1e-9))
        if found is not None and (best is None or found.level > best.level):
            best = found
        elif best is not None:
            break
    return best


def _shells(potential: Potential, center: Vector, L: Vector, radius: float) -> Ellipsoid | None:
    """Shells of one ellipsoid, cut where the slope along rays is no longer positive."""
    parts = _PARTS.get(center.size, _FEWEST_PARTS)
    step = np.asarray(np.exp2(np.round(np.log2(2 * half_axes(L, radius) / parts))), float)
    central = Interval(center - step / 2, center + step / 2)[None, :]
    if not lower_curvature(potential.lower_hessian(central), L)[0] > 0:
        return None
    first, last = corners(center, L, radius, step)
    if np.prod(last - first + 1.0) > _MOST_CELLS:
        return None
    cells, lowest, highest = ellipsoid_cells(center, L, radius, step)
    nu_cell = lower_curvature(potential.lower_hessian(cells), L)
    outer = radius * np.arange(1, _SHELLS + 1) / _SHELLS
    inner = np.concatenate([[0.0], outer[:-1]])
    meets = (lowest[:, None] <= outer) & (highest[:, None] >= inner)
    nu = np.where(meets, nu_cell[:, None], np.inf).min(0)
    level, count = climb(potential, center, L, outer, nu)
    if count == 0:
        return None
    inside = cells[lowest <= outer[count - 1]]
    above = -float(lower_curvature(-potential.jet(inside).hess, L).min())
    return Ellipsoid(center, L, outer[:count], nu[:count], step, level, above)
