"""Q of W = V + ½∇VᵀQ∇V, and where {W < w₀} is: proposals in floating point."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from necc_casadi.arrays import Vector
from necc_casadi.certificate.prover.arithmetic.intervals import Interval
from necc_casadi.certificate.prover.sampled.step import Step
from necc_casadi.designs.design import Design
from necc_casadi.methods.semidefinite_program import SemidefiniteProgram

__all__ = ["Guide", "choose_metric"]


#: −βS⁻¹ ⪯ Q ⪯ βS⁻¹ with S = ∇²V(z̄): sublevel sets of W are not far from those of V.
_SHARE = 0.4
#: Periods at which Π is asked to be ≺ 0, as shares of the longest.
_PERIODS = (0.02, 0.5, 1.0)
#: Rays on which a level is sought, and where on each, in units in which ∇²V(z̄) = I.
_RAYS, _PLACES = 400, 2.0 ** np.arange(-4, 6, 1 / 16)
#: Halvings between two places; steps of a local search, and how much wider than by rays, as a
#: share, it may find a region: beyond that it went over a pass.
_HALVINGS, _STEPS, _WIDER = 12, 40, 0.1
#: The box around {W ≤ w₀} is wider by one of these shares, the first with W > w₀ on a side.
_ROOMS = (0.5, 0.3, 0.15, 0.1, 0.06, 0.03, 0.01)


def choose_metric(step: Step, points: Vector, period: float) -> Vector | None:
    """The Q with the largest t for which Π ⪯ −tS⁻¹ at points (B, N), symmetric; None: t ≤ 0."""
    design = step.potential.design
    S = design.lyapunov.hessian(design.z_bar)
    size, inverse = len(S), np.linalg.inv(S)
    inverse = (inverse + inverse.T) / 2
    shapes = [_symmetric(size, i, j) for i in range(size) for j in range(i, size)]
    unit = np.zeros((size, size))
    count = len(shapes)
    near = (_SHARE * inverse, np.array([*shapes, unit]))
    far = (_SHARE * inverse, np.array([*(-E for E in shapes), unit]))
    inequalities = [near, far]
    for share in _PERIODS:
        s = np.full(len(points), share * period)
        sample = step.over(Interval(points, points), Interval(s, s))
        N, mean, weighted = (v.center for v in (sample.step, sample.mean, sample.weighted))
        for k in range(len(points)):
            if not np.isfinite(N[k]).all():
                continue
            X = mean[k] @ N[k]
            free = N[k] + N[k].T + s[k] * N[k].T @ weighted[k] @ N[k]
            parts = [E @ X + X.T @ E + s[k] * X.T @ E @ X for E in shapes]
            inequalities.append((-_half(free), np.array([*(-_half(p) for p in parts), -inverse])))
    cost = np.zeros(count + 1)
    cost[-1] = -1.0
    found = SemidefiniteProgram(cost, inequalities).solution()
    if found is None or not found[-1] > 0:
        return None
    return sum((q * E for q, E in zip(found[:-1], shapes, strict=True)), unit)


def _symmetric(size: int, i: int, j: int) -> Vector:
    E = np.zeros((size, size))
    E[i, j] = E[j, i] = 1.0
    return E


def _half(A: Vector) -> Vector:
    return (A + A.T) / 4


@dataclass(frozen=True, eq=False)
class Guide:
    """W in floating point."""

    design: Design  # in natural units
    Q: Vector

    def W(self, z: Vector) -> Vector:
        """W − V(z̄) at states (…, N)."""
        lyapunov, flat = self.design.lyapunov, np.reshape(z, (-1, np.shape(z)[-1]))
        g = lyapunov.gradient(flat)
        least = float(lyapunov.V(self.design.z_bar))
        value: Vector = lyapunov.V(flat) - least + ((g @ self.Q) * g).sum(-1) / 2
        return value.reshape(np.shape(z)[:-1])

    def slope(self, z: Vector) -> Vector:
        """∇W at one state (N,)."""
        g, S = self.design.lyapunov.gradient(z), self.design.lyapunov.hessian(z)
        total: Vector = g + S @ self.Q @ g
        return total

    def box_around(self, height: float) -> Interval | None:
        """A box (N,) around {W − V(z̄) ≤ height} near z̄; None where it goes too far."""
        z_bar, rays = self.design.z_bar, self._rays
        above = self.W(z_bar + _PLACES[:, None, None] * rays) > height
        if not above.any(0).all():
            return None
        first = above.argmax(0)
        hi, lo = _PLACES[first], np.where(first > 0, _PLACES[first - 1], 0.0)
        for _ in range(_HALVINGS):
            middle = (lo + hi) / 2
            out = self.W(z_bar + middle[:, None] * rays) > height
            lo, hi = np.where(out, lo, middle), np.where(out, middle, hi)
        ends = z_bar + lo[:, None] * rays
        least, most = ends.min(0), ends.max(0)
        wider = _WIDER * (most - least)
        for k in range(len(z_bar)):
            below = self._extreme(ends[ends[:, k].argmin()], k, -1.0, height)
            above_it = self._extreme(ends[ends[:, k].argmax()], k, 1.0, height)
            least[k] = below if least[k] - wider[k] < below < least[k] else least[k]
            most[k] = above_it if most[k] < above_it < most[k] + wider[k] else most[k]
        return self._with_room(least, most, height)

    def _with_room(self, least: Vector, most: Vector, height: float) -> Interval:
        """A wider box, so that W is well above the height on its sides where it can be."""
        width = most - least
        shares = np.random.default_rng(2).uniform(size=(_RAYS, len(least)))
        lo, hi = least - _ROOMS[-1] * width, most + _ROOMS[-1] * width
        for k in range(len(least)):
            for ends, end, sign in ((lo, least, -1.0), (hi, most, 1.0)):
                for room in _ROOMS:
                    side = least + shares * width
                    side[:, k] = end[k] + sign * room * width[k]
                    if (self.W(side) > height).all():
                        ends[k] = end[k] + sign * room * width[k]
                        break
        return Interval(lo, hi)

    def inside(self, height: float, count: int) -> Vector:
        """States (count, N) of {W − V(z̄) ≤ height} along rays from z̄."""
        z_bar, rays = self.design.z_bar, self._rays
        out = self.W(z_bar + _PLACES[:, None, None] * rays) > height
        reach = np.where(out.any(0), _PLACES[out.argmax(0)], _PLACES[-1])
        shares = np.random.default_rng(0).uniform(size=len(rays)) ** (1 / len(z_bar))
        points = z_bar + (shares * reach)[:, None] * rays
        inside: Vector = points[self.W(points) <= height][:count]
        return inside

    @cached_property
    def _rays(self) -> Vector:
        """Directions (rays, N) of length 1 where ∇²V(z̄) = I."""
        z_bar = self.design.z_bar
        rays = np.random.default_rng(1).standard_normal((_RAYS, len(z_bar)))
        rays /= np.linalg.norm(rays, axis=1)[:, None]
        values, vectors = np.linalg.eigh(self.design.lyapunov.hessian(z_bar))
        scaled: Vector = rays @ (vectors * values**-0.5).T
        return scaled

    def _extreme(self, start: Vector, k: int, sign: float, height: float) -> float:
        """How far {W ≤ height} reaches in z_k, up (1) or down (−1), near a point of its boundary.

        By steps to the farthest point of the level of W's quadratic model, with ∇²V(z̄) for its
        Hessian.
        """
        S = self.design.lyapunov.hessian(self.design.z_bar)
        turned = np.linalg.solve(S, np.eye(len(S))[k])
        z, best = start.copy(), float(start[k])
        for _ in range(_STEPS):
            slope = self.slope(z)
            back = np.linalg.solve(S, slope)
            room = 2 * (height - float(self.W(z))) + slope @ back
            if not room > 0:
                break
            z = z + (sign * np.sqrt(room / turned[k]) * turned - back) / 2
            if self.W(z) <= height:
                best = max(best, float(z[k]), key=lambda value: sign * value)
        return best
