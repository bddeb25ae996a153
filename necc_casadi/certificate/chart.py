"""Region of attraction in the coordinates (c, ξ), where V = e₀ + K(c) + Hc(ξ) is a plain sum.

For plants whose energy is constant with the momenta s at rest, with as many Casimirs as there are
remaining plant states q. By the Casimir condition c is constant along the columns of M = Jcl − Rcl
that belong to s, so along dq = A(q)B(ξ)⁻¹dξ with A, B the rows of those columns for q and ξ. Such
motions carry the fibre ξ = ξ̄ to every other one, and V splits:

*Fibre.* With α = A_K(c(q, ξ̄) − c̄), cells of a box around q̄ either have |α| > a, or lie inside and
have a regular ∂α/∂q: the set F of |α| ≤ a is compact, and α has no fold on it.

*Motion.* Along straight lines from ξ̄ to ξ, with η = A_H(ξ − ξ̄), |Δqᵢ| ≤ Lᵢ|η| as long as q stays in a
box Q, Lᵢ ≥ ‖eᵢᵀA(q)B(ξ)⁻¹A_H⁻¹‖ on Q × {|η| ≤ b}. Where that and the reach of F leave q inside Q,
which lies in the domain, it does stay.

Then (q₀, ξ) ↦ (q, ξ) maps {q₀ in F, V ≤ c} one-to-one onto a neighbourhood of z̄ in {V ≤ c}, whose
component Ω is compact, with critical points only where ∇K = ∇Hc = 0: nondegenerate minima, hence
z̄ alone. K and Hc enter by their growth: V ≤ c implies k(|α|) + k_H(|η|) ≤ c − V(z̄).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
import sympy as sp

from necc_casadi.artifact import Design
from necc_casadi.certificate.core import ellipsoid_cells, half_axes
from necc_casadi.certificate.definite import Truth
from necc_casadi.certificate.enclosures import Potential
from necc_casadi.certificate.growth import Growth, growth
from necc_casadi.certificate.intervals import Interval, matmul, point, stack
from necc_casadi.certificate.jets import constant, expression_values
from necc_casadi.certificate.structure import subdivide
from necc_casadi.networks import Vector

__all__ = ["ChartRegion", "widest_chart"]

#: Cells per axis of the fibre, by dimension.
FIBRE = {1: 512, 2: 64, 3: 24}
FEWEST = 5
#: Cells per axis on each face of the cube of directions, steps along them, pieces of q per axis.
CONES, STEPS, PIECES = 5, 8, 2
#: The box around the fibre is this much wider than its ellipsoid in the linearisation.
_WIDER = 1.25
#: Share of the domain's sides that q keeps away from its border, for other arithmetic to confirm.
_MARGIN = 0.005
#: Tries of Picard's condition, and how much wider each is.
_PICARD, _SLACK = 6, 0.1
#: Levels between the highest that the networks allow and this share of it are searched.
_DEEPEST, _BISECTIONS = 1e-4, 9
_EASE = 1e-6

Rows = tuple[tuple[float, ...], ...]


@dataclass(frozen=True)
class ChartRegion:
    """Ω as a level and what proves it: scales, shells of growth, and the box Q."""

    level: float  # c
    active: tuple[int, ...]  # the states y = (q, ξ)
    center: tuple[float, ...]  # ȳ
    middle: tuple[float, ...]  # c̄
    scale_k: Rows  # A_K, r × r
    scale_h: Rows  # A_H, nc × nc
    radii_k: tuple[float, ...]  # shells of K in |α|
    nu_k: tuple[float, ...]
    radii_h: tuple[float, ...]  # shells of Hc in |η|
    nu_h: tuple[float, ...]
    above: float  # ∇²K ⪯ above·A_KᵀA_K and ∇²Hc ⪯ above·A_HᵀA_H on them
    fibre: Rows  # (lo, hi) of the box around the fibre
    method: str = "chart"

    def contains(self, design: Design, z: Sequence[float]) -> bool:
        """Whether z is in Ω, by plain evaluation of V on the way there from its centre."""
        end, r = np.asarray(z, float), len(self.middle)
        start = end.copy()
        start[list(self.active)] = self.center
        path = start + np.linspace(0.0, 1.0, 65)[:, None] * (end - start)
        y = path[:, list(self.active)]
        eta = (y[:, r:] - np.array(self.center[r:])) @ np.array(self.scale_h).T
        lo, hi = np.array(self.boxes).min((0, 1)), np.array(self.boxes).max((0, 1))
        near = (y[:, :r] >= lo).all() and (y[:, :r] <= hi).all()
        near = near and (np.linalg.norm(eta, axis=1) <= self.radii_h[-1]).all()
        return bool(near and all(design.V(point_) <= self.level for point_ in path))


def widest_chart(
    potential: Potential, center: Vector, lo: Vector, hi: Vector, ceiling: float
) -> ChartRegion | None:
    """The region in the box [lo, hi] with the largest proved level, at most `ceiling`."""
    with np.errstate(all="ignore"):
        chart = _Chart.at(potential, center, lo, hi)
        return None if chart is None else chart.widest(ceiling)


@dataclass(frozen=True, eq=False)
class _Chart:
    """The coordinates and the growth of V in them."""

    potential: Potential
    lo: Vector  # domain of y
    hi: Vector
    center: Vector  # ȳ (d,)
    middle: Vector  # c̄ (r,)
    A_K: Vector  # r × r
    A_H: Vector  # nc × nc
    slopes: Vector  # ∂c/∂y at ȳ, r × d
    energy: Interval  # e₀
    k: Growth
    hc: Growth
    columns: sp.Matrix  # rows of M for y, columns for the momenta

    @classmethod
    def at(cls, potential: Potential, center: Vector, lo: Vector, hi: Vector) -> _Chart | None:
        """Scales from ∇²V(ȳ); None where V is no such sum or not convex at ȳ."""
        design = potential.design
        loop, form, casimirs = design.loop, design.form, design.casimirs.functions
        r, nc = len(casimirs), loop.controller.nc
        separate = potential.energy.is_number and form.phi is None and not form.betas
        if not separate or r + nc != center.size or len(potential.resting) != nc:
            return None
        columns = loop.M.extract(list(potential.active), list(potential.resting))
        q, xi = _symbols(potential)
        if columns[:r, :].free_symbols - set(q) or columns[r:, :].free_symbols - set(xi):
            return None
        at = point(center[None])
        slopes = _values([sp.diff(c, s) for c in casimirs for s in (*q, *xi)], (*q, *xi), at)
        slopes_mid = slopes.mid.reshape(r, center.size)
        hess = potential.jet(at).hess.mid[0]
        try:
            full = np.vstack([slopes_mid, np.eye(center.size)[r:]])
            inverse = np.linalg.inv(full)
            curvature = inverse.T @ (hess + hess.T) @ inverse / 2
            A_K = np.linalg.cholesky(curvature[:r, :r]).T
            A_H = np.linalg.cholesky(curvature[r:, r:]).T
        except np.linalg.LinAlgError:
            return None
        middle = _values(list(casimirs), (*q, *xi), at).mid[0]
        reach = half_axes(A_H.T, 1.0)
        size = float(np.min(np.minimum(hi[r:] - center[r:], center[r:] - lo[r:]) / reach))
        if not size > 0:
            return None
        weights = form.split(design.weights)
        return cls(
            potential, lo, hi, center, middle, A_K, A_H, slopes_mid, constant(potential.energy),
            growth(form.k, weights[1], middle, A_K, size),
            growth(form.hc, weights[0], center[r:], A_H, size * (1 - 1e-9)),
            columns,
        )  # fmt: skip

    @property
    def r(self) -> int:
        """Number of Casimirs and of plant states."""
        return len(self.A_K)

    @cached_property
    def symbols(self) -> tuple[list[sp.Symbol], list[sp.Symbol]]:
        """(q, ξ)."""
        return _symbols(self.potential)

    @cached_property
    def linear(self) -> tuple[Vector, Vector]:
        """∂q/∂α along the fibre and ∂q/∂η along the motion, at ȳ."""
        inverse = np.linalg.inv(self.slopes[:, : self.r])
        along = -inverse @ self.slopes[:, self.r :] @ np.linalg.inv(self.A_H)
        return inverse @ np.linalg.inv(self.A_K), along

    def widest(self, ceiling: float) -> ChartRegion | None:
        """The highest level that is proved, by bisection on a logarithmic scale."""
        if not (self.k.radii.size and self.hc.radii.size):
            return None
        bottom = self.k.bottom + self.hc.bottom + self.energy
        top = min(self.k.height, self.hc.height, ceiling - float(bottom.lo)) * (1 - _EASE)
        best, low, high = None, 0.0, float(_BISECTIONS)
        for _ in range(_BISECTIONS):
            middle = (low + high) / 2
            found = self.region(top * _DEEPEST ** (middle / _BISECTIONS), bottom)
            best, low, high = (best, middle, high) if found is None else (found, low, middle)
        return best

    def region(self, height: float, bottom: Interval) -> ChartRegion | None:
        """What is proved at a level this far above V(ȳ); None where it is too high."""
        level = float(bottom.lo) + height
        allowed = height * (1 + 1e-12) + self.k.dip + self.hc.dip
        a, b = self.k.radius(allowed), self.hc.radius(allowed)
        if not (level > float(bottom.hi) and math.isfinite(a + b)):
            return None
        fibre = self.fibre(a)
        if fibre is None:
            return None
        box, cells, least = fibre
        if not self.stays(cells, least, allowed, b):
            return None
        return ChartRegion(
            level, self.potential.active, _numbers(self.center), _numbers(self.middle),
            _rows(self.A_K), _rows(self.A_H), _numbers(self.k.radii), _numbers(self.k.nu),
            _numbers(self.hc.radii), _numbers(self.hc.nu), max(self.k.above, self.hc.above),
            _rows(np.stack([box.lo, box.hi], -1)),
        )  # fmt: skip

    def fibre(self, a: float) -> tuple[Interval, Interval, Vector] | None:
        """A box around |α| ≤ a, its cells, and a lower bound of |α| on each.

        None where cells on the border or with a fold of α may have |α| ≤ a.
        """
        r, parts = self.r, FIBRE.get(self.r, FEWEST)
        q_bar, half = self.center[:r], _WIDER * a * np.linalg.norm(self.linear[0], axis=1)
        box = Interval(
            np.maximum(self.lo[:r], q_bar - half), np.minimum(self.hi[:r], q_bar + half)
        )
        cells = subdivide(box, parts)
        least, regular = self._least(cells)
        index = np.stack(np.unravel_index(np.arange(parts**r), (parts,) * r), -1)
        border = ((index == 0) | (index == parts - 1)).any(1)
        near = least <= a
        if (near & (border | ~regular)).any():
            return None
        return box, cells[near], least[near]

    def stays(self, cells: Interval, least: Vector, allowed: float, b: float) -> bool:
        """Whether q stays in the domain on all ways ξ̄ + sA_H⁻¹v, 0 ≤ s, |η| ≤ b, v on a cube.

        Cone by cone, step by step in s: q − q₀ is enclosed. A way that gets to |η| = ρ has
        Hc − Hc(ξ̄) ≥ k_H(ρ) at its end, so a small |α| throughout.
        """
        r = self.r
        v = _cones(len(self.A_H), CONES)
        shortest = np.sqrt(np.square(np.maximum(np.maximum(v.lo, -v.hi), 0.0)).sum(1)) * (1 - _EASE)
        scaled = matmul(_inverse(self.A_H), v[..., None])[..., 0]  # A_H⁻¹v
        margin = _MARGIN * (self.hi[:r] - self.lo[:r])
        lo, hi = self.lo[:r] + margin, self.hi[:r] - margin
        moved = point(np.zeros((v.shape[0], r)))
        for inner, outer in pairwise(np.linspace(0.0, b, STEPS + 1)):
            near = least <= self.k.radius(allowed - self.hc.rise(inner))
            start = Interval(cells.lo[near].min(0), cells.hi[near].max(0)) + moved
            s, width = Interval(inner / shortest, outer / shortest), (outer - inner) / shortest
            xi = scaled * s[:, None] + self.center[r:]
            found = self._step(start, xi, scaled, width * (1 + _EASE))
            if found is None or (found[0].lo < lo).any() or (found[0].hi > hi).any():
                return False
            moved = moved + found[1]
        return True

    def _step(
        self, start: Interval, xi: Interval, v: Interval, width: Vector
    ) -> tuple[Interval, Interval] | None:
        """(q during a step, its change at the end) by Picard's condition; None where it fails."""
        span = Interval(np.zeros_like(width), width)[:, None]
        turned = self._turned(xi, v)
        if turned is None:
            return None
        Q = start
        for _ in range(_PICARD):
            rate = self._rate(Q, turned)
            reached = start + rate * span
            if ((reached.lo >= Q.lo) & (reached.hi <= Q.hi)).all():
                return reached, rate * point(width)[:, None]
            slack = _SLACK * (reached.hi - reached.lo)
            Q = Interval(np.minimum(Q.lo, reached.lo - slack), np.maximum(Q.hi, reached.hi + slack))
        return None

    def _turned(self, xi: Interval, v: Interval) -> Interval | None:
        """B(ξ)⁻¹A_H⁻¹v, (cones, nc); None where B is not proved regular."""
        nc = len(self.A_H)
        B = _values(list(self.columns[self.r :, :]), self.symbols[1], xi).reshape(-1, nc, nc)
        if not np.isfinite(B.lo + B.hi).all():
            return None
        inverse = np.linalg.inv(B.mid)
        E = matmul(point(inverse), B) - np.eye(nc)
        excess = point(E.magnitude).sum().hi.max(-1)
        if not (excess < 1).all():
            return None
        # B⁻¹ = (I + E)⁻¹N = (I − E)N + E²(I + E)⁻¹N for N near it
        x = matmul(point(inverse), v[..., None])
        slack = excess**2 / (1 - excess) * (1 + _EASE) * x.magnitude.max((1, 2))
        x = (x - matmul(E, x))[..., 0]
        return x + Interval(-slack[:, None], slack[:, None])

    def _rate(self, Q: Interval, turned: Interval) -> Interval:
        """A(q)B(ξ)⁻¹A_H⁻¹v over boxes of q, (cones, r); boxes are cut for sharpness."""
        (q, _), nc, along = self.symbols, len(self.A_H), self.columns[: self.r, :]
        pieces = _cut(Q, [k for k, s in enumerate(q) if along.has(s)], PIECES)
        A = _values(list(along), q, pieces).reshape(-1, self.r, nc)
        count = pieces.shape[0] // Q.shape[0]
        x = Interval(*(np.repeat(end, count, 0)[..., None] for end in (turned.lo, turned.hi)))
        rate = matmul(A, x)[..., 0].reshape(-1, count, self.r)
        return Interval(rate.lo.min(1), rate.hi.max(1))

    def _least(self, cells: Interval) -> tuple[Vector, Truth]:
        """Lower bound of |α| on cells of q at ξ̄, and where ∂α/∂q is proved regular."""
        q, xi = self.symbols
        casimirs = self.potential.design.casimirs.functions
        r, middle = self.r, cells.mid
        half = (cells - middle).magnitude
        value = matmul(self.A_K, (self._on_fibre(list(casimirs), point(middle)) - self.middle)[..., None])
        entries = [sp.diff(c, s) for c in casimirs for s in q]
        G = matmul(self.A_K, self._on_fibre(entries, cells).reshape(-1, r, r))
        alpha, spread = value[..., 0], matmul(G, point(half)[..., None])
        spread = (point(G.magnitude) * half[:, None, :]).sum().hi
        apart = point(np.maximum(np.maximum(alpha.lo, -alpha.hi) - spread, 0.0) * (1 - 1e-12))
        by_box = apart.square().sum().lo
        u = alpha.mid / (np.linalg.norm(alpha.mid, axis=1) * (1 + 1e-12) + 1e-300)[:, None]
        along = matmul(point(u[:, None, :]), G)[:, 0].magnitude
        by_side = ((alpha * u).sum() - (point(along) * half).sum().hi).lo
        least = np.maximum(np.sqrt(np.maximum(by_box, 0.0)) * (1 - 1e-12), by_side)
        finite = np.isfinite(G.lo + G.hi).all((1, 2))
        inverse = np.linalg.inv(np.where(finite[:, None, None], G.mid, np.eye(r)) + 1e-14 * np.eye(r))
        excess = (matmul(point(inverse), G) - np.eye(r)).magnitude
        regular = finite & (point(excess).sum().hi.max(-1) < 1)
        return np.where(finite, least, -np.inf), regular

    def _on_fibre(self, expressions: list[sp.Expr], q: Interval) -> Interval:
        """Expressions at (q, ξ̄), boxes first."""
        xi = np.broadcast_to(self.center[self.r :], (q.shape[0], len(self.center) - self.r))
        box = Interval(np.hstack([q.lo, xi]), np.hstack([q.hi, xi]))
        return _values(expressions, [*self.symbols[0], *self.symbols[1]], box)


def _cones(d: int, parts: int) -> Interval:
    """The surface of the cube ‖v‖∞ = 1 in cells, (cells, d)."""
    if d == 1:
        return point(np.array([[-1.0], [1.0]]))
    face = subdivide(Interval(-np.ones(d - 1), np.ones(d - 1)), parts)
    sides = [
        Interval(*(np.insert(end, axis, sign, axis=1) for end in (face.lo, face.hi)))
        for axis in range(d)
        for sign in (-1.0, 1.0)
    ]
    return Interval(*(np.concatenate(ends) for ends in zip(*((v.lo, v.hi) for v in sides), strict=True)))


def _cut(boxes: Interval, used: list[int], parts: int) -> Interval:
    """Boxes (B, d) cut into parts along some of their axes, (B·partsᵏ, d), box by box."""
    for axis in used:
        edges = boxes.lo[:, axis, None] + (boxes.hi - boxes.lo)[:, axis, None] * (
            np.arange(parts + 1) / parts
        )
        edges[:, -1] = boxes.hi[:, axis]
        lo, hi = (np.repeat(end, parts, 0) for end in (boxes.lo, boxes.hi))
        lo[:, axis], hi[:, axis] = edges[:, :-1].ravel(), edges[:, 1:].ravel()
        boxes = Interval(lo, hi)
    return boxes


def _symbols(potential: Potential) -> tuple[list[sp.Symbol], list[sp.Symbol]]:
    loop = potential.design.loop
    q = [loop.z[i] for i in potential.active if i < loop.plant.n]
    return q, list(loop.controller.xi)


def _values(expressions: Sequence[sp.Expr], symbols: Sequence[sp.Symbol], box: Interval) -> Interval:
    """Expressions over boxes (B, symbols), (B, expressions)."""
    variables = {s: box[:, k] for k, s in enumerate(symbols)}
    zero = point(np.zeros(box.shape[0]))
    return stack([zero + v for v in expression_values(list(expressions), variables)], 1)


def _inverse(A: Vector) -> Interval:
    """A⁻¹ for a well-conditioned matrix: with T near it and E = I − TA, (I − E)⁻¹T."""
    T = np.linalg.inv(A)
    excess = float(point((matmul(T, point(A)) - np.eye(len(A))).magnitude).sum().hi.max())
    slack = 2 * excess * np.abs(T).max(0)
    return Interval(T - slack, T + slack)


def _numbers(v: Vector) -> tuple[float, ...]:
    return tuple(map(float, v))


def _rows(A: Vector) -> Rows:
    return tuple(_numbers(row) for row in A)
