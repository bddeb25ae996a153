"""Region of attraction in the coordinates (c, ξ), where V = e₀ + K(c) + Hc(ξ) is a plain sum.

For plants whose energy is constant with the momenta s at rest, with as many Casimirs as remaining
plant states q, and as many momenta as controller states. Motions along the Casimirs (transport.py)
carry the fibre ξ = ξ̄ to every other one and change V by Hc alone. V ≤ c implies
k(|α|) + k_H(|η|) ≤ c − e₀ − K(c̄) − Hc(ξ̄), with α = A_K(c − c̄), η = A_H(ξ − ξ̄) and k, k_H the
growth of K and Hc. Let |α| ≤ a on the fibre be compact and free of
folds, q̄ in it, and let q stay in the domain on the way from there to |η| ≤ b. Then (q₀, ξ) ↦ (q, ξ)
maps the part {V ≤ c} of that product one-to-one onto components of {V ≤ c}, Ω around z̄ among them:
its image is closed, and open in {V ≤ c}. ∇V = 0 there means ∇K = ∇Hc = 0, since ∂c/∂q is regular,
and every such point is a nondegenerate minimum: a connected sublevel set has one, z̄.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import sympy as sp

from necc_casadi.arrays import Vector
from necc_casadi.certificate.claims.regions import ChartRegion, numbers, rows
from necc_casadi.certificate.prover.arithmetic.boxes import subdivide
from necc_casadi.certificate.prover.arithmetic.intervals import Interval, point
from necc_casadi.certificate.prover.arithmetic.jets import constant
from necc_casadi.certificate.prover.arithmetic.potential import Potential
from necc_casadi.certificate.prover.region.fibre import Fibre, FibreChart
from necc_casadi.certificate.prover.region.shells import Shells, half_axes, shells_of_network
from necc_casadi.certificate.prover.region.sizes import ball_volume
from necc_casadi.certificate.prover.region.transport import Transport, values_on

__all__ = ["Chart", "ChartExtent", "widest_chart"]


#: Shells of |η| on the way from the fibre.
_STEPS = 16


#: The box around the fibre is this much wider than its ellipsoid in the linearisation.
_WIDER = 1.25


#: Share of the domain's sides that q keeps away from its border, for other arithmetic to confirm.
_MARGIN = 0.01


#: Levels between the highest that the networks allow and this share of it are searched.
_DEEPEST, _BISECTIONS = 1e-4, 9


#: Parts per axis on which ∂c/∂q is bounded for the volume, and of ways along which V is.
_COARSE, _PIECES = 3, 24


#: How much shorter a way is than in plain floating point, in this order.
_SLACK = (0.002, 0.01, 0.03, 0.1, 0.3)


#: Room for the checker's arithmetic in a level and in radii.
_EASE = 1e-6


#: Sizes leave this much room for the other arithmetic of the checker.
_SIZES, _VOLUME = 0.99, 0.95


def widest_chart(
    potential: Potential, center: Vector, lo: Vector, hi: Vector, ceiling: float
) -> tuple[ChartRegion, dict[str, float]] | None:
    """The region in the box [lo, hi] with the largest proved level ≤ `ceiling`, and its sizes."""
    with np.errstate(all="ignore"):
        chart = Chart.at(potential, center, lo, hi)
        return None if chart is None else chart.widest(ceiling)


@dataclass(frozen=True, eq=False)
class ChartExtent:
    """Where a region in the coordinates (c, ξ) is: q somewhere in the domain."""

    region: ChartRegion
    domain: Interval  # (d,)

    def hull(self) -> Interval:
        """A box (d,) that holds it: q in the domain, |η| ≤ b."""
        r, (lo, hi) = len(self.region.middle), (self.domain.lo.copy(), self.domain.hi.copy())
        half = half_axes(np.array(self.region.scale_h).T, self.region.b)
        xi_bar = np.array(self.region.center[r:])
        lo[r:] = np.nextafter(xi_bar - half, -np.inf)
        hi[r:] = np.nextafter(xi_bar + half, np.inf)
        return Interval(lo, hi)

    def boxes(self) -> None:
        """No smaller boxes are known."""
        return


@dataclass(frozen=True, eq=False)
class Chart:
    """The coordinates and the shells of V in them."""

    potential: Potential
    domain: Interval  # (d,)
    center: Vector  # ȳ (d,)
    slopes: Vector  # ∂c/∂y at ȳ, r × d
    energy: Interval  # e₀
    fold: FibreChart
    transport: Transport
    k: Shells
    hc: Shells

    @classmethod
    def at(cls, potential: Potential, center: Vector, lo: Vector, hi: Vector) -> Chart | None:
        """Scales from ∇²V(ȳ); None where V is no such sum or not convex at ȳ."""
        design = potential.design
        loop, form, casimirs = design.loop, design.form, design.casimirs.functions
        r, nc = len(casimirs), loop.controller.nc
        separate = potential.energy.is_number and form.phi is None and not form.betas
        if not separate or r + nc != center.size or len(potential.resting) != nc:
            return None
        columns = loop.M.extract(list(potential.active), list(potential.resting))
        y = [loop.z[i] for i in potential.active]
        q, xi = y[:r], y[r:]
        if columns[:r, :].free_symbols - set(q) or columns[r:, :].free_symbols - set(xi):
            return None
        at = point(center[None])
        slopes = values_on([sp.diff(c, s) for c in casimirs for s in y], y, at).mid.reshape(r, -1)
        scales = _scales(potential.jet(at).hess.mid[0], slopes)
        if scales is None:
            return None
        A_K, A_H = scales
        middle = values_on(list(casimirs), y, at).mid[0]
        xi_bar, room = center[r:], np.minimum(hi - center, center - lo)[r:]
        size = float(np.min(room / half_axes(A_H.T, 1.0))) * (1 - 1e-9)
        if not size > 0:
            return None
        weights = form.split(design.weights)
        return cls(
            potential, Interval(lo, hi), center, slopes, constant(potential.energy),
            FibreChart(casimirs, q, xi, xi_bar, middle, A_K),
            Transport(columns[:r, :], columns[r:, :], q, xi, xi_bar, A_H),
            shells_of_network(form.k, weights[1], middle, A_K, size),
            shells_of_network(form.hc, weights[0], xi_bar, A_H, size),
        )  # fmt: skip

    @property
    def r(self) -> int:
        """Number of Casimirs and of plant states."""
        return len(self.slopes)

    @cached_property
    def bottom(self) -> Interval:
        """e₀ + K(c̄) + Hc(ξ̄), about V(ȳ)."""
        return self.k.bottom + self.hc.bottom + self.energy

    def widest(self, ceiling: float) -> tuple[ChartRegion, dict[str, float]] | None:
        """The highest level that is proved, by bisection on a logarithmic scale."""
        if not (self.k.radii.size and self.hc.radii.size):
            return None
        top = min(self.k.height, self.hc.height, ceiling - float(self.bottom.lo)) * (1 - _EASE)
        best, low, high = None, 0.0, 1.0
        for _ in range(_BISECTIONS):
            middle = (low + high) / 2
            found = self.region(top * _DEEPEST**middle)
            best, low, high = (best, middle, high) if found is None else (found, low, middle)
        if best is None:
            return None
        region, fibre, Q = best
        return region, self.sizes(region, fibre, Q)

    def region(self, height: float) -> tuple[ChartRegion, Fibre, Interval] | None:
        """What is proved at a level this far above V(ȳ); None where it is too high."""
        level = float(self.bottom.lo) + height
        allowed = height * (1 + 1e-12) + self.k.dip + self.hc.dip
        a, b = self.k.radius(allowed), self.hc.radius(allowed)
        if not (level > float(self.bottom.hi) and math.isfinite(a + b)):
            return None
        fibre = self.fold.cover(self._fibre_box(a), self.center[: self.r], a)
        if fibre is None:
            return None
        radii = np.linspace(0.0, b, _STEPS + 1)
        starts = [
            fibre.within(min(a, self.k.radius(allowed - self.hc.rise(rho)))) for rho in radii[:-1]
        ]
        Q = self.transport.hull(radii, starts, *self._room())
        if Q is None:
            return None
        region = ChartRegion(
            level, self.potential.active, numbers(self.center), numbers(self.fold.middle),
            rows(self.fold.scale), rows(self.transport.scale),
            numbers(self.k.radii), numbers(self.k.nu),
            numbers(self.hc.radii), numbers(self.hc.nu), max(self.k.above, self.hc.above),
            a, b, rows(np.stack([fibre.box.lo, fibre.box.hi], -1)),
        )  # fmt: skip
        return region, fibre, Q

    def _room(self) -> tuple[Vector, Vector]:
        """The domain of q, less a margin."""
        lo, hi = self.domain.lo[: self.r], self.domain.hi[: self.r]
        return lo + _MARGIN * (hi - lo), hi - _MARGIN * (hi - lo)

    def _fibre_box(self, a: float) -> Interval:
        along = np.linalg.inv(self.fold.scale @ self.slopes[:, : self.r])  # ∂q/∂α at ȳ
        half = _WIDER * a * np.linalg.norm(along, axis=1)
        q_bar, (lo, hi) = self.center[: self.r], self._room()
        return Interval(np.maximum(lo, q_bar - half), np.minimum(hi, q_bar + half))

    # --- sizes ------------------------------------------------------------------------------------

    def sizes(self, region: ChartRegion, fibre: Fibre, Q: Interval) -> dict[str, float]:
        """Lower bounds of what Ω covers; see :mod:`necc_casadi.certificate.prover.region.sizes`."""
        sides = self.domain.hi - self.domain.lo
        height = region.level - float(self.bottom.hi)
        rho = min(self._inner(height, region.above), region.a, region.b)
        # dα dη = |det A_K ∂c/∂q| |det A_H| dq dξ, and |det ∂c/∂q| ≤ Π ‖∂cᵢ/∂q‖ (Hadamard)
        ball = ball_volume(len(sides)) * rho ** len(sides)
        scale = abs(np.linalg.det(self.fold.scale) * np.linalg.det(self.transport.scale))
        volume = _VOLUME * ball / float(scale * self._steepest(Q, region.b))
        sizes = {
            "volume": volume,
            "domain_share": volume / float(np.prod(sides)),
            "slice_share": fibre.volume(rho) / float(np.prod(sides[: self.r])),
        }
        names = [self.potential.design.loop.states[i] for i in region.active]
        # every ξ with |η| ≤ rho is reached from q̄ along the Casimirs
        far = [*self._reach(region), *half_axes(self.transport.scale.T, rho)]
        sizes |= {f"reach_{s}": v for s, v in zip(names, far, strict=True)}
        return {key: _SIZES * float(value) for key, value in sizes.items()}

    def _inner(self, height: float, above: float) -> float:
        """A radius of (α, η) up to which V ≤ V(ȳ) + height."""
        slope = math.hypot(self.k.slope, self.hc.slope)
        return (math.sqrt(slope**2 + 2 * above * max(height, 0.0)) - slope) / above * (1 - _EASE)

    def _steepest(self, Q: Interval, b: float) -> float:
        """An upper bound of Π ‖∂cᵢ/∂q‖ over q in Q and |η| ≤ b."""
        half = half_axes(self.transport.scale.T, b)
        xi = self.transport.xi_bar
        box = Interval(np.concatenate([Q.lo, xi - half]), np.concatenate([Q.hi, xi + half]))
        entries = [sp.diff(c, s) for c in self.fold.casimirs for s in self.fold.q]
        slopes = values_on(entries, [*self.fold.q, *self.fold.xi], subdivide(box, _COARSE))
        squares = slopes.reshape(-1, self.r, self.r).square().sum().hi
        return float(np.sqrt(squares.prod(1).max())) * (1 + _EASE)

    def _reach(self, region: ChartRegion) -> Vector:
        """How far points of Ω are from q̄ in each qᵢ, both ways: V ≤ c on straight ways there."""
        at = point(self.center[None])
        directions = np.linalg.inv(self.potential.jet(at).hess.mid[0])
        reach = np.zeros(self.r)
        for i, way in enumerate(directions[: self.r]):
            longest = [self._longest(region, sign * way / way[i]) for sign in (-1.0, 1.0)]
            reach[i] = min(longest)
        return reach

    def _longest(self, region: ChartRegion, way: Vector) -> float:
        """An s with V ≤ c proved on ȳ + [0, s]·way, near the largest."""
        low, high = 0.0, float(np.max(self.domain.hi - self.domain.lo))
        z = np.zeros((_PIECES + 1, self.potential.design.loop.n))
        share = np.linspace(0.0, 1.0, _PIECES + 1)[:, None]
        for _ in range(14):
            s = (low + high) / 2
            z[:, list(region.active)] = self.center + share * s * way
            below = self.potential.design.lyapunov.V(z) <= region.level
            low, high = (s, high) if below.all() else (low, s)
        tried = (low * (1 - slack) for slack in _SLACK)
        return next((s for s in tried if self._below(region.level, s * way)), 0.0)

    def _below(self, level: float, way: Vector) -> bool:
        ends = self.center + np.linspace(0.0, 1.0, _PIECES + 1)[:, None] * way
        pieces = Interval(np.minimum(ends[:-1], ends[1:]), np.maximum(ends[:-1], ends[1:]))
        value = self.potential.jet(pieces).value
        inside = (pieces.lo >= self.domain.lo).all() and (pieces.hi <= self.domain.hi).all()
        return bool(inside and (value.hi <= level).all())


def _scales(hess: Vector, slopes: Vector) -> tuple[Vector, Vector] | None:
    """(A_K, A_H) from ∇²V in the coordinates (c, ξ); None where it is not positive definite."""
    r, d = slopes.shape
    try:
        inverse = np.linalg.inv(np.vstack([slopes, np.eye(d)[r:]]))
        curvature = inverse.T @ (hess + hess.T) @ inverse / 2
        blocks = curvature[:r, :r], curvature[r:, r:]
        A_K, A_H = (np.asarray(np.linalg.cholesky(block).T, float) for block in blocks)
    except np.linalg.LinAlgError:
        return None
    return A_K, A_H
