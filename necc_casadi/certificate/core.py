"""Region of attraction in an ellipsoid around z̄, for more coupled states than a grid can hold.

With P = LLᵀ near ∇²V(z̄) and |e| = ‖Lᵀe‖ for e = y − ȳ, let ∇²V ⪰ ν(|e|)P on the ellipsoid |e| ≤ ρ,
ν constant on shells and negative where it must be. Along every ray from ȳ the slope of V is then
at least s(r) = ∫₀ʳ ν less the tiny slope at ȳ: while it is positive V has no other critical point,
and V ≥ V(ȳ) + ∫₀^ρ s on the boundary of the ellipsoid, which bounds the component of {V ≤ c}.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from necc_casadi.certificate.definite import Truth, positive_definite
from necc_casadi.certificate.enclosures import Potential
from necc_casadi.certificate.intervals import Interval, matmul, point
from necc_casadi.networks import Vector

__all__ = ["Core", "widest_core"]

#: Half-axes that are tried, as shares of the largest ellipsoid in the domain.
_SCALES = (1.0, 0.7, 0.5, 0.35, 0.25, 0.15, 0.1, 0.05, 0.02, 0.01, 5e-3, 2e-3, 1e-3)
_SHELLS = 16
#: Cells per axis of the box around the ellipsoid, by dimension, about.
_PARTS = {2: 64, 3: 24, 4: 14, 5: 8}
_FEWEST_PARTS = 4
#: More cells than this would not fit into memory: no region is claimed then.
_MOST_CELLS = 300_000
#: How far below its estimate ν is tried, in this order.
_SLACK = (0.01, 0.03, 0.1, 0.3, 1.0, 3.0)


@dataclass(frozen=True, eq=False)
class Core:
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


def widest_core(potential: Potential, center: Vector, lo: Vector, hi: Vector) -> Core | None:
    """The ellipsoid in the box [lo, hi] with the largest proved level; None where there is none."""
    hess = potential.jet(point(center[None])).hess.mid[0]
    if not np.isfinite(hess).all() or np.linalg.eigvalsh(hess + hess.T)[0] <= 0:
        return None
    L = np.asarray(np.linalg.cholesky((hess + hess.T) / 2), float)
    widest = float(np.min(np.minimum(hi - center, center - lo) / half_axes(L, 1.0)))
    best: Core | None = None
    for scale in _SCALES:
        found = _shells(potential, center, L, scale * widest * (1 - 1e-9))
        if found is not None and (best is None or found.level > best.level):
            best = found
        elif best is not None:
            break
    return best


def _shells(potential: Potential, center: Vector, L: Vector, radius: float) -> Core | None:
    """Shells of one ellipsoid, cut where the slope along rays is no longer positive."""
    parts = _PARTS.get(center.size, _FEWEST_PARTS)
    step = np.asarray(np.exp2(np.round(np.log2(2 * half_axes(L, radius) / parts))), float)
    central = Interval(center - step / 2, center + step / 2)[None, :]
    if not lower_curvature(potential.lower_hessian(central), L)[0] > 0:
        return None
    first, last = _corners(center, L, radius, step)
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
    return Core(center, L, outer[:count], nu[:count], step, level, above)


def half_axes(L: Vector, radius: float) -> Vector:
    """Half the sides of the box around the ellipsoid ‖Lᵀe‖ ≤ radius, a little enlarged, (d,)."""
    inverse = np.linalg.inv(L)
    return np.asarray(radius * np.sqrt((inverse**2).sum(0)) * (1 + 1e-9), float)


def _corners(
    center: Vector, L: Vector, radius: float, step: Vector
) -> tuple[npt.NDArray[np.int_], npt.NDArray[np.int_]]:
    """First and last cell of the box around the ellipsoid on each axis, (d,) each."""
    half = half_axes(L, radius)
    low, high = (np.floor(end / step).astype(int) for end in (center - half, center + half))
    return low, high


def ellipsoid_cells(
    center: Vector, L: Vector, radius: float, step: Vector
) -> tuple[Interval, Vector, Vector]:
    """Cells (B, d) with corners at multiples of `step` that cover |e| ≤ radius; bounds of |e|.

    Such cells share their shadows on planes, where the networks live, so few are evaluated.
    """
    first, last = _corners(center, L, radius, step)
    ranges = [range(a, b + 1) for a, b in zip(first, last, strict=True)]
    index = np.stack([v.ravel() for v in np.meshgrid(*ranges, indexing="ij")], -1)
    cells = Interval(index * step, (index + 1) * step)
    image = matmul(L.T, (cells - center)[..., None])[..., 0]
    squares = image.square().sum()
    length = Interval(np.maximum(squares.lo, 0.0), squares.hi).sqrt()
    keep = length.lo <= radius
    return cells[keep], length.lo[keep], length.hi[keep]


def lower_curvature(hess: Interval, L: Vector) -> Vector:
    """Proved ν with A ⪰ νLLᵀ for every matrix A enclosed, −∞ where none is found, (cells,)."""
    P = matmul(L, point(L.T))
    whitener = np.asarray(np.linalg.inv(L), float)
    scaled = matmul(whitener, _swapped(matmul(whitener, hess)))
    finite: Truth = np.asarray(np.isfinite(scaled.lo + scaled.hi).all((-1, -2)))
    middle = np.where(finite[:, None, None], scaled.mid, 0.0)
    spread = np.where(finite[:, None, None], scaled.rad, 0.0)
    spread = np.maximum(spread, np.swapaxes(spread, -1, -2))
    lowest = np.linalg.eigvalsh((middle + np.swapaxes(middle, -1, -2)) / 2)[:, 0]
    estimate = lowest - np.linalg.eigvalsh(spread)[:, -1]
    nu = np.full(len(estimate), -np.inf)
    for slack in _SLACK:
        todo: Truth = np.asarray(finite & ~np.isfinite(nu))
        if not todo.any():
            break
        trial = estimate[todo] - slack
        proved = positive_definite(hess[todo] - P * trial[:, None, None])
        nu[todo] = np.where(proved, trial, -np.inf)
    return nu


def _swapped(v: Interval) -> Interval:
    return Interval(np.swapaxes(v.lo, -1, -2), np.swapaxes(v.hi, -1, -2))


def climb(
    potential: Potential, center: Vector, L: Vector, radii: Vector, nu: Vector
) -> tuple[float, int]:
    """(c, shells): integrate ν twice along rays, as long as the slope stays positive."""
    at = potential.jet(point(center[None]))
    whitener = np.asarray(np.linalg.inv(L), float)
    start = matmul(whitener, at.grad[0][:, None])
    slope = -(1 + 1e-6) * float(np.sqrt((start.magnitude**2).sum()))  # at ȳ, steepest
    bottom, inner, count = float(at.value.lo[0]), 0.0, 0
    rise = result = 0.0
    for outer, curvature in zip(radii, nu, strict=True):
        width = float(outer) - inner
        end = slope + curvature * width
        if not end > 0:
            break
        rise += width * (slope + end) / 2
        slope, inner, count, result = end, float(outer), count + 1, rise
    return bottom + result - 1e-9 * result - 1e-12 * (1 + abs(bottom)), count
