"""Region of attraction in the coordinates g = (c(y), ξ), where V = K(c) + Hc(ξ) is a plain sum.

For plants whose energy is constant with the momenta at rest and whose Casimirs and controller
states are as many as the remaining states. Let y = ȳ + Bw, θ(w) = A(g(y) − ḡ) with A = diag(A_K,
A_H), and |w| = r ≤ ρ. Taylor's formula at ȳ, with bounds βₖ of ‖A Dᵏc(B·, …, B·)‖ at ȳ for k < 5
and on the whole ellipsoid for k = 5, gives for M = Dθ(0) with singular values within η of 1

    ‖Dθ(w) − M‖ ≤ Σ βₖ rᵏ⁻¹/(k−1)!      and      |θ(w)| ≥ m(r) = (1 − η)r − |θ(0)| − Σ βₖ rᵏ/k!.

Where the first is less than 1 − η at ρ, θ is one-to-one on the ellipsoid and covers the ball
|θ| ≤ m(ρ). If ∇²K ⪰ νA_KᵀA_K and ∇²Hc ⪰ νA_HᵀA_H there, ν > 0, then V has one critical point over
that ball, and exceeds K(c̄) + Hc(ξ̄) + ½ν|θ|² − |slope||θ| on its boundary: {V ≤ c} over the ball is
the image of a convex set, hence connected.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations_with_replacement

import numpy as np
import sympy as sp

from necc_casadi.artifact import Design
from necc_casadi.certificate.core import ellipsoid_cells, half_axes, lower_curvature
from necc_casadi.certificate.definite import norm, positive_definite
from necc_casadi.certificate.enclosures import Potential, over_pieces
from necc_casadi.certificate.intervals import Interval, concatenate, matmul, point, stack
from necc_casadi.certificate.jets import Jet, coordinates, expression_jets
from necc_casadi.networks import Network, Vector

__all__ = ["ChartRegion", "widest_chart"]

#: Order of the derivatives that are bounded on the whole ellipsoid; lower ones only at ȳ.
_ORDER = 5
#: Radii that are tried, as shares of the largest ellipsoid in the domain.
_SHARES = 0.85 ** np.arange(40)
#: Cells per axis on which the curvature of the networks is bounded.
_PARTS = {1: 64, 2: 16}
_FEWEST_PARTS = 6
#: Bounds leave this much room, so that other arithmetic can confirm them.
_EASE = 1 + 1e-6
#: The same for derivatives over the whole ellipsoid, which balls enclose less sharply.
_BALL_EASE = 1.4

Rows = tuple[tuple[float, ...], ...]


@dataclass(frozen=True)
class ChartRegion:
    """Ω as {V ≤ level} over |θ| ≤ size in the ellipsoid |w| ≤ radius."""

    level: float  # c
    active: tuple[int, ...]  # the states y
    center: tuple[float, ...]  # ȳ
    basis: Rows  # B, d × d
    middle: tuple[float, ...]  # the Casimirs' part of ḡ; ξ̄ is the end of ȳ
    scale_k: Rows  # A_K, r × r
    scale_h: Rows  # A_H, nc × nc
    radius: float  # ρ
    bends: tuple[float, ...]  # β₂ … β₅
    size: float  # < m(ρ)
    nu: float
    above: float  # ∇²K ⪯ above·A_KᵀA_K and ∇²Hc ⪯ above·A_HᵀA_H over the ball
    inner: float  # V ≤ c where |w| ≤ inner
    method: str = "chart"

    def contains(self, design: Design, z: Sequence[float]) -> bool:
        """Whether z is in Ω, by plain evaluation of V."""
        at, r = np.asarray(z, float), len(self.middle)
        e = at[list(self.active)] - np.array(self.center)
        c = np.asarray(design.lyapunov.terms.c(at), float).ravel()
        theta_k = np.array(self.scale_k) @ (c - np.array(self.middle))
        theta_h = np.array(self.scale_h) @ e[r:]
        theta = np.linalg.norm(np.concatenate([theta_k, theta_h]))
        inside = np.linalg.norm(np.linalg.solve(np.array(self.basis), e)) <= self.radius
        return bool(inside and theta <= self.size and design.V(z) <= self.level)


def widest_chart(
    potential: Potential, center: Vector, lo: Vector, hi: Vector, ceiling: float
) -> ChartRegion | None:
    """The ellipsoid in the box [lo, hi] with the largest proved level, at most `ceiling`."""
    form = potential.design.form
    separate = potential.energy.is_number and form.phi is None and not form.betas
    if not separate or len(potential.design.casimirs.functions) != center.size - form.hc.inputs:
        return None
    with np.errstate(all="ignore"):
        chart = _Chart.at(potential, center)
        if chart is None:
            return None
        widest = float(np.min(np.minimum(hi - center, center - lo) / chart.reach(1.0)))
        best: ChartRegion | None = None
        for share in _SHARES:
            found = chart.region(share * widest, ceiling)
            if found is not None and (best is None or found.inner > best.inner):
                best = found
            elif best is not None:
                break
    return best


@dataclass(frozen=True, eq=False)
class _Chart:
    """The map θ and what Taylor's formula needs of it at ȳ."""

    potential: Potential
    center: Vector  # ȳ (d,)
    B: Vector  # d × d
    middle: Vector  # (r,)
    A_K: Vector  # r × r
    A_H: Vector  # nc × nc
    offset: float  # ≥ |θ(0)|
    eta: float  # singular values of M are within η of 1
    entries: tuple[list[sp.Expr], ...]  # of Dᵏc, by k
    bends: tuple[float, ...]  # βₖ for 2 ≤ k < _ORDER

    @classmethod
    def at(cls, potential: Potential, center: Vector) -> _Chart | None:
        """Scales from ∇²V(ȳ), so that θ(w) is nearly a rotation of w; None where it is not PD."""
        c = _casimir_jets(potential, point(center[None]))
        r = len(c)
        slopes = np.vstack([[j.grad.mid[0] for j in c], np.eye(center.size)[r:]])
        hess = potential.jet(point(center[None])).hess.mid[0]
        try:
            inverse = np.linalg.inv(slopes)
            curvature = inverse.T @ (hess + hess.T) @ inverse / 2
            A_K = np.linalg.cholesky(curvature[:r, :r]).T
            A_H = np.linalg.cholesky(curvature[r:, r:]).T
            B = np.linalg.inv(np.linalg.cholesky((hess + hess.T) / 2)).T
        except np.linalg.LinAlgError:
            return None
        middle = np.array([j.value.mid[0] for j in c])
        offset = norm(matmul(A_K, stack([j.value[0] for j in c])[:, None] - middle[:, None])[:, 0])
        rows = matmul(A_K, stack([j.grad[0] for j in c], 0))
        below = point(np.hstack([np.zeros((len(A_H), r)), A_H]))
        M = matmul(concatenate(rows, below), point(B))
        eta = 2 * _spectral(_turned(M, len(B)) - np.eye(len(B))) + 1e-12
        entries = _derivatives(potential)
        chart = cls(potential, center, B, middle, A_K, A_H, float(offset), eta, entries, ())
        return replace(chart, bends=tuple(chart.bend(k, 0.0) for k in range(2, _ORDER)))

    def reach(self, radius: float) -> Vector:
        """Half the sides of the box around |w| ≤ radius, a little enlarged, (d,)."""
        return np.asarray(radius * np.sqrt((self.B**2).sum(1)) * (1 + 1e-9), float)

    def bend(self, order: int, radius: float) -> float:
        """β of an order on |w| ≤ radius."""
        half = self.reach(radius)
        box = Interval(self.center - half, self.center + half)[None]
        T = _tensor(self.potential, self.entries[order], order, box)
        A, B = self.A_K, self.B
        if radius > 0:  # entries vary independently in the box: only their magnitudes count
            T, A, B = point(T.magnitude), np.abs(A), np.abs(B)
        d, r = len(B), len(A)
        for _ in range(order):  # the last axis is turned, and becomes the first after the rows
            T = matmul(B.T, T.reshape(-1, d, 1)).reshape(r, -1, d)
            T = Interval(np.moveaxis(T.lo, -1, 1), np.moveaxis(T.hi, -1, 1))
        return _spectral(matmul(A, T.reshape(r, -1)).reshape(r * d ** (order // 2), -1))

    def region(self, radius: float, ceiling: float) -> ChartRegion | None:
        """What an ellipsoid proves; None where θ is not one-to-one or V not convex in θ."""
        bends = (*self.bends, _BALL_EASE * self.bend(_ORDER, radius))
        turn = sum(b * radius ** (k - 1) / math.factorial(k - 1) for k, b in enumerate(bends, 2))
        if not turn * _EASE + self.eta < 1:
            return None
        size = (2 - _EASE) * ((1 - self.eta) * radius - self.offset - _curl(bends, radius) * _EASE)
        if not size > 0:
            return None
        bottom, slope, nu, above = self.networks(size)
        low, high = float(bottom.lo), float(bottom.hi)
        level = min(ceiling, low + size * (nu * size * (2 - _EASE) / 2 - slope * _EASE))
        if not (nu > 0 and level > high):
            return None
        inner = self.inner(bends, size, (level - high, slope, above))
        return ChartRegion(
            float(level), self.potential.active, _numbers(self.center), _rows(self.B),
            _numbers(self.middle), _rows(self.A_K), _rows(self.A_H), float(radius), bends,
            float(size), nu, above, inner,
        )  # fmt: skip

    def inner(
        self, bends: Sequence[float], size: float, heights: tuple[float, float, float]
    ) -> float:
        """The largest r, by bisection, with V ≤ c on |w| ≤ r."""
        height, slope, above = heights
        root = math.sqrt(slope**2 + 2 * above * height)
        most = (2 - _EASE) * min(size, (root - slope) / above)  # of |θ|
        low, high = 0.0, most
        for _ in range(60):
            r = (low + high) / 2
            fits = (1 + self.eta) * r + self.offset + _curl(bends, r) <= most
            low, high = (r, high) if fits else (low, r)
        return low

    def networks(self, size: float) -> tuple[Interval, float, float, float]:
        """K(c̄) + Hc(ξ̄), its slope in θ, and bounds of its curvature on |θ| ≤ size."""
        design, r = self.potential.design, len(self.middle)
        hc, k = design.form.split(design.weights)[:2]
        parts = [
            _network(design.form.k, k, self.middle, self.A_K, size),
            _network(design.form.hc, hc, self.center[r:], self.A_H, size),
        ]
        bottom = parts[0][0] + parts[1][0]
        slope = math.hypot(*(part[1] for part in parts))
        return bottom, slope, min(p[2] for p in parts), max(p[3] for p in parts)


def _network(
    network: Network, weights: Vector, middle: Vector, A: Vector, size: float
) -> tuple[Interval, float, float, float]:
    """Value and slope at the middle; ν and `above` on |A(v − middle)| ≤ size."""
    at = over_pieces(network, weights, point(middle[None]))
    slope = norm(matmul(np.asarray(np.linalg.inv(A).T, float), at.grad[0][:, None])[:, 0])
    parts = _PARTS.get(len(A), _FEWEST_PARTS)
    step = np.asarray(np.exp2(np.round(np.log2(2 * half_axes(A.T, size) / parts))), float)
    cells, _, _ = ellipsoid_cells(middle, A.T, size, step)
    hess = over_pieces(network, weights, cells).hess
    nu, above = lower_curvature(hess, A.T).min(), -lower_curvature(-hess, A.T).min()
    return at.value[0], float(slope), float(nu), float(above)


def _curl(bends: Sequence[float], r: float) -> float:
    return float(sum(b * r**k / math.factorial(k) for k, b in enumerate(bends, 2)))


def _casimir_jets(potential: Potential, Z: Interval) -> list[Jet]:
    """The Casimirs over boxes of y."""
    symbols = [potential.design.loop.z[i] for i in potential.active]
    variables = dict(zip(symbols, coordinates(Z), strict=True))
    parts = expression_jets(list(potential.design.casimirs.functions), variables)
    return [part if isinstance(part, Jet) else coordinates(Z)[0] * 0.0 + part for part in parts]


def _derivatives(potential: Potential) -> tuple[list[sp.Expr], ...]:
    """Entries of Dᵏc for nondecreasing multi-indices, k = 0 … _ORDER, function by function."""
    symbols = [potential.design.loop.z[i] for i in potential.active]
    tables: list[dict[tuple[int, ...], sp.Expr]] = [
        {(): f} for f in potential.design.casimirs.functions
    ]
    result = [[table[()] for table in tables]]
    for order in range(1, _ORDER + 1):
        keys = list(combinations_with_replacement(range(len(symbols)), order))
        tables = [{k: sp.diff(t[k[:-1]], symbols[k[-1]]) for k in keys} for t in tables]
        result.append([entry for table in tables for entry in table.values()])
    return tuple(result)


def _tensor(potential: Potential, entries: list[sp.Expr], order: int, box: Interval) -> Interval:
    """Dᵏc over a box (1, d), r × d^k."""
    symbols, d = [potential.design.loop.z[i] for i in potential.active], box.shape[-1]
    values = expression_jets(entries, dict(zip(symbols, coordinates(box), strict=True)))
    flat = [v.value[0] if isinstance(v, Jet) else v for v in values]
    ends = np.array([[float(v.lo) for v in flat], [float(v.hi) for v in flat]])
    weight = d ** np.arange(order)[::-1]
    keys = np.array(list(combinations_with_replacement(range(d), order))) @ weight
    index = np.sort(np.indices((d,) * order).reshape(order, -1), axis=0)
    lo, hi = ends.reshape(2, -1, len(keys))[..., np.searchsorted(keys, weight @ index)]
    return Interval(lo, hi)


def _turned(M: Interval, d: int) -> Interval:
    """MᵀM."""
    return matmul(Interval(M.lo.T, M.hi.T), M).reshape(d, d)


def _spectral(X: Interval) -> float:
    """An upper bound of the largest singular value; ∞ where none is found."""
    T = Interval(X.lo.T, X.hi.T)
    gram = matmul(X, T) if X.shape[0] <= X.shape[1] else matmul(T, X)
    if not np.isfinite(gram.lo + gram.hi).all():
        return math.inf
    estimate = float(np.linalg.norm(gram.mid, 2)) * _EASE + 1e-24
    identity = np.eye(gram.shape[0])
    if positive_definite((identity * estimate - gram)[None])[0]:
        return math.sqrt(estimate) * _EASE
    return math.sqrt(float(gram.magnitude.sum(-1).max())) * _EASE + 1e-12


def _numbers(v: Vector) -> tuple[float, ...]:
    return tuple(map(float, v))


def _rows(A: Vector) -> Rows:
    return tuple(_numbers(row) for row in A)
