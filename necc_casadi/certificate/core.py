"""Region of attraction in an ellipsoid around z̄, for more coupled states than a grid can hold.

With P = ∇²V(z̄) and |e| the norm (eᵀPe)^½ of e = y − ȳ, let ∇²V ⪰ ν(|e|)P on the ellipsoid |e| ≤ ρ,
ν constant on shells and negative where it must be. Along every ray from ȳ the slope of V is then
at least s(r) = ∫₀ʳ ν less the tiny slope at ȳ: while it is positive V has no other critical point,
and V ≥ V(ȳ) + ∫₀^ρ s on the boundary of the ellipsoid, which bounds the component of {V ≤ c}.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from necc_casadi.certificate.definite import Truth, positive_definite
from necc_casadi.certificate.enclosures import Potential
from necc_casadi.certificate.intervals import Interval, matmul, point
from necc_casadi.networks import Vector

__all__ = ["Core", "widest_core"]

#: Half-axes that are tried, as shares of the largest ellipsoid in the domain.
_SCALES = 0.8 ** np.arange(12.0)
_SHELLS = 12
#: Cells per axis of the box around the ellipsoid, by dimension.
_PARTS = {1: 64, 2: 32, 3: 16, 4: 10, 5: 7, 6: 5, 7: 4, 8: 4}
#: How far below its estimate ν is tried, in this order.
_SLACK = (1e-6, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0)


@dataclass(frozen=True, eq=False)
class Core:
    """Shells |e| ≤ radii with ∇²V ⪰ νP, checked on cells of the box around the ellipsoid."""

    center: Vector  # ȳ (d,)
    P: Vector  # d × d
    radii: Vector  # (shells,), outer radius of each
    nu: Vector  # (shells,)
    parts: int  # cells per axis
    level: float  # c

    @property
    def radius(self) -> float:
        """ρ."""
        return float(self.radii[-1])


def widest_core(potential: Potential, center: Vector, lo: Vector, hi: Vector) -> Core | None:
    """The ellipsoid in the box [lo, hi] with the largest proved level; None where there is none."""
    at = potential.jet(point(center[None]))
    P = (at.hess.mid[0] + at.hess.mid[0].T) / 2
    values = np.linalg.eigvalsh(P) if np.isfinite(P).all() else np.array([-1.0])
    if values[0] <= 0:
        return None
    reach = np.sqrt(np.diagonal(np.linalg.inv(P)))
    widest = float(np.min(np.minimum(hi - center, center - lo) / reach)) * (1 - 1e-9)
    best: Core | None = None
    for scale in _SCALES:
        found = _shells(potential, center, P, scale * widest)
        if found is not None and (best is None or found.level > best.level):
            best = found
        elif best is not None:
            break
    return best


def _shells(potential: Potential, center: Vector, P: Vector, radius: float) -> Core | None:
    """Shells of one ellipsoid, cut where the slope along rays is no longer positive."""
    parts = _PARTS.get(center.size, 3)
    cells = ellipsoid_cells(center, P, radius, parts)
    lowest, highest = norms(cells - center, P)
    keep = lowest <= radius
    cells, lowest, highest = cells[keep], lowest[keep], highest[keep]
    nu_cell = _curvature(potential, cells, P)
    outer = radius * np.arange(1, _SHELLS + 1) / _SHELLS
    inner = np.concatenate([[0.0], outer[:-1]])
    meets = (lowest[:, None] <= outer) & (highest[:, None] >= inner)
    nu = np.where(meets, nu_cell[:, None], np.inf).min(0)
    level, count = climb(potential, center, P, outer, nu)
    if count == 0:
        return None
    return Core(center, P, outer[:count], nu[:count], parts, level)


def ellipsoid_cells(center: Vector, P: Vector, radius: float, parts: int) -> Interval:
    """The box around the ellipsoid, cut into parts^d cells, (cells, d)."""
    half = radius * np.sqrt(np.diagonal(np.linalg.inv(P))) * (1 + 1e-9)
    d = center.size
    edges = center + half * np.linspace(-1, 1, parts + 1)[:, None]  # (parts + 1, d)
    index = np.array(list(product(range(parts), repeat=d)))
    axes = np.arange(d)
    return Interval(edges[index, axes], edges[index + 1, axes])


def norms(e: Interval, P: Vector) -> tuple[Vector, Vector]:
    """Bounds of (eᵀPe)^½ over boxes (B, d), from the distance of Lᵀe to 0, P = LLᵀ."""
    L = np.linalg.cholesky(P)
    image = matmul(L.T, e[..., None])[..., 0]
    squares = image.square().sum()
    slack = 1e-9  # P − LLᵀ and the roots are far more accurate than this
    low, high = np.sqrt(np.maximum(squares.lo, 0.0)), np.sqrt(squares.hi)
    return np.maximum(low * (1 - slack), 0.0), high * (1 + slack)


def _curvature(potential: Potential, cells: Interval, P: Vector) -> Vector:
    """Proved ν with ∇²V ⪰ νP on each cell, −∞ where none is found, (cells,)."""
    whitener = np.linalg.inv(np.linalg.cholesky(P))
    hess = potential.jet(cells).hess
    scaled = matmul(whitener, _swapped(matmul(whitener, hess)))
    finite = np.isfinite(scaled.lo + scaled.hi).all((-1, -2))
    middle = np.where(finite[:, None, None], scaled.mid, 0.0)
    spread = np.where(finite[:, None, None], scaled.rad, 0.0)
    estimate = np.linalg.eigvalsh((middle + np.swapaxes(middle, -1, -2)) / 2)[:, 0]
    estimate = estimate - np.linalg.eigvalsh(np.maximum(spread, np.swapaxes(spread, -1, -2)))[:, -1]
    nu = np.full(len(estimate), -np.inf)
    for slack in _SLACK:
        todo: Truth = finite & ~np.isfinite(nu)
        if not todo.any():
            break
        trial = estimate[todo] - slack
        proved = positive_definite(hess[todo] - trial[:, None, None] * point(P))
        nu[todo] = np.where(proved, trial, -np.inf)
    return nu


def _swapped(v: Interval) -> Interval:
    return Interval(np.swapaxes(v.lo, -1, -2), np.swapaxes(v.hi, -1, -2))


def climb(
    potential: Potential, center: Vector, P: Vector, radii: Vector, nu: Vector
) -> tuple[float, int]:
    """(c, shells): integrate ν twice along rays, as long as the slope stays positive."""
    at = potential.jet(point(center[None]))
    whitener = np.linalg.inv(np.linalg.cholesky(P))
    start = matmul(whitener, at.grad[0][:, None])
    slope = -(1 + 1e-9) * float(np.sqrt((start.magnitude**2).sum()))  # at ȳ, steepest
    level, inner, count = float(at.value.lo[0]), 0.0, 0
    result = level
    for outer, curvature in zip(radii, nu, strict=True):
        width = float(outer) - inner
        end = slope + curvature * width
        if not end > 0:
            break
        level += width * (slope + end) / 2
        slope, inner, count, result = end, float(outer), count + 1, level
    return result - 1e-9 * abs(result) - 1e-12, count
