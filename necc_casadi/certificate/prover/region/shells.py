"""How a function rises around a point: f ≥ f(v̄) + k(ρ) where |A(v − v̄)| = ρ, by shells.

With ∇²f ⪰ ν(ρ)AᵀA on the shells of the ellipsoid |A(v − v̄)| ≤ size, the slope of f along every ray
from v̄ is at least s(ρ) = ∫₀^ρ ν less the tiny slope at v̄, and k(ρ) = ∫₀^ρ s (Taylor's formula along
the ray). Shells end where s is no longer positive: inside, f has no other critical point. Used for
a network, and for V with A = Lᵀ, P = LLᵀ.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from necc_casadi.arrays import Truth, Vector
from necc_casadi.certificate.prover.arithmetic.definite import norm, positive_definite
from necc_casadi.certificate.prover.arithmetic.intervals import Interval, matmul, point
from necc_casadi.certificate.prover.arithmetic.jets import Jet
from necc_casadi.certificate.prover.arithmetic.potential import over_pieces
from necc_casadi.lyapunov.networks import Network

__all__ = [
    "Curved",
    "Shells",
    "cell_sides",
    "corners",
    "ellipsoid_cells",
    "half_axes",
    "lower_curvature",
    "shells",
    "shells_of_network",
]


#: How far below its estimate ν is tried, in this order.
_SLACK = (0.01, 0.03, 0.1, 0.3, 1.0, 3.0)


#: Shells of a network.
_SHELLS = 8


#: How far ν stays below what is proved: balls enclose less sharply.
_ROOM = 0.02


#: Cells per axis of the box around the ellipsoid, by dimension.
_PARTS = {1: 128, 2: 32, 3: 14}
_FEWEST_PARTS = 6


#: Bounds leave this much room, so that other arithmetic can confirm them.
_EASE = 1e-6


#: Keeps a slope that is 0 in doubles from counting as exact.
_TINY = 1e-15


@dataclass(frozen=True, eq=False)
class Shells:
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
                total = max(total, start + step * (slope + nu * step / 2) - _TINY)
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


@dataclass(frozen=True, eq=False)
class Curved:
    """A function over boxes: its jet, and matrices below its Hessian, which may be sharper."""

    jet: Callable[[Interval], Jet]
    below: Callable[[Interval], Interval]


def cell_sides(A: Vector, size: float, parts: int) -> Vector:
    """Sides of about `parts` cells per axis of the box around |A·| ≤ size, powers of two, (d,)."""
    return np.asarray(np.exp2(np.round(np.log2(2 * half_axes(A.T, size) / parts))), float)


def shells(
    f: Curved, middle: Vector, A: Vector, size: float, step: Vector, count: int, room: float
) -> Shells:
    """`count` shells around `middle` up to `size`, less those from where f may fall on.

    ν stays below, and `above` above, what is proved by `room`.
    """
    at = f.jet(point(middle[None]))
    slope = norm(matmul(np.asarray(np.linalg.inv(A).T, float), at.grad[0][:, None])[:, 0])
    steepest = float(slope) * (1 + _EASE) + _TINY
    cells, lowest, highest = ellipsoid_cells(middle, A.T, size, step)
    curvature = lower_curvature(f.below(cells), A.T)
    outer = size * np.arange(1, count + 1) / count
    inner = np.concatenate([[0.0], outer[:-1]])
    meets = (lowest[:, None] <= outer) & (highest[:, None] >= inner)
    nu = np.where(meets, curvature[:, None], np.inf).min(0) - room
    rising = np.cumsum(nu * (outer - inner)) - steepest > 0
    kept = count if rising.all() else int(np.argmax(~rising))
    above = math.inf
    if kept:
        inside = cells[lowest <= outer[kept - 1]]
        above = room - float(lower_curvature(-f.jet(inside).hess, A.T).min())
    return Shells(at.value[0], steepest, outer[:kept], nu[:kept], above)


def shells_of_network(
    network: Network, weights: Vector, middle: Vector, A: Vector, size: float
) -> Shells:
    """Shells around `middle` up to `size`; none where f is not convex there."""

    def jet(boxes: Interval) -> Jet:
        return over_pieces(network, weights, boxes)

    step = cell_sides(A, size, _PARTS.get(len(A), _FEWEST_PARTS))
    curved = Curved(jet, lambda boxes: jet(boxes).hess)
    return shells(curved, middle, A, size, step, _SHELLS, _ROOM)


def half_axes(L: Vector, radius: float) -> Vector:
    """Half the sides of the box around the ellipsoid ‖Lᵀe‖ ≤ radius, a little enlarged, (d,)."""
    inverse = np.linalg.inv(L)
    return np.asarray(radius * np.sqrt((inverse**2).sum(0)) * (1 + 1e-9), float)


def ellipsoid_cells(
    center: Vector, L: Vector, radius: float, step: Vector
) -> tuple[Interval, Vector, Vector]:
    """Cells (B, d) with corners at multiples of `step` that cover |e| ≤ radius; bounds of |e|.

    Such cells share their shadows on planes, where the networks live, so few are evaluated.
    """
    first, last = corners(center, L, radius, step)
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


def corners(
    center: Vector, L: Vector, radius: float, step: Vector
) -> tuple[npt.NDArray[np.int_], npt.NDArray[np.int_]]:
    """First and last cell of the box around the ellipsoid on each axis, (d,) each."""
    half = half_axes(L, radius)
    low, high = (np.floor(end / step).astype(int) for end in (center - half, center + half))
    return low, high
