"""Q of W = V + ½∇VᵀQ∇V, and where {W < w₀} is: proposals in floating point."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from necc_casadi.arrays import Indices, Truth, Vector
from necc_casadi.certificate.prover.arithmetic.intervals import Interval
from necc_casadi.certificate.prover.sampled.step import Step
from necc_casadi.designs.design import Design
from necc_casadi.methods.semidefinite_program import SemidefiniteProgram

__all__ = ["Guide", "choose_metric"]


#: −βS⁻¹ ⪯ Q ⪯ βS⁻¹ with S = ∇²V(z̄): sublevel sets of W are not far from those of V.
_SHARE = 0.4
#: Periods at which Π is asked to be ≺ 0, as shares of the longest.
_PERIODS = (0.02, 0.5, 1.0)
#: Points of the first program, and those added to the next at most; programs; a point is added
#: where its margin is less than this share of what the program says.
_FIRST, _TIMES, _NEAR = 60, 4, 0.98
#: Rays on which a level is sought, and where on each, in units in which ∇²V(z̄) = I.
_RAYS, _PLACES = 400, 2.0 ** np.arange(-4, 6, 1 / 16)
#: Halvings between two places; steps of a local search, and how much wider than by rays, as a
#: share, it may find a region: beyond that it went over a pass.
_HALVINGS, _STEPS, _WIDER = 12, 40, 0.1
#: The box around {W ≤ w₀} is wider by one of these shares, the first with W > w₀ on a side.
_ROOMS = (0.5, 0.3, 0.15, 0.1, 0.06, 0.03, 0.01)


def choose_metric(step: Step, points: Vector, period: float) -> Vector | None:
    """The Q with the largest t for which Π ⪯ −tS⁻¹ at points (B, N), symmetric; None: t ≤ 0.

    Some of the points make a program, to which those at which its answer is worst are added.
    """
    longest = _Samples(step, points, period)
    design = step.potential.design
    S = design.lyapunov.hessian(design.z_bar)
    usable = longest.usable
    used, best = usable[:_FIRST], None
    for _ in range(_TIMES):
        found = _program([_Samples(step, points[used], share * period) for share in _PERIODS], S)
        if found is None:
            return None if best is None else best[1]
        Q, t = found
        margins = longest.margins(Q, S)
        worst = usable[np.argsort(margins[usable])][:_FIRST]
        least = float(margins[worst[0]])
        if best is None or least > best[0]:
            best = (least, Q)
        added = np.setdiff1d(worst[margins[worst] < _NEAR * t], used)
        if not added.size:
            break
        used = np.concatenate([used, added])
    return best[1] if best is not None and best[0] > 0 else None


@dataclass(frozen=True, eq=False)
class _Samples:
    """Samples of one length from points (B, N)."""

    step: Step
    points: Vector
    period: float

    @cached_property
    def _parts(self) -> tuple[Vector, Vector, Vector]:
        """Ñ, S̄ and S̃, (B, N, N)."""
        s = np.full(len(self.points), self.period)
        sample = self.step.over(Interval(self.points, self.points), Interval(s, s))
        return sample.step.center, sample.mean.center, sample.weighted.center

    @property
    def known(self) -> Truth:
        """Which samples are known, (B,)."""
        return np.asarray(np.all([np.isfinite(A).all((-1, -2)) for A in self._parts], 0))

    @property
    def usable(self) -> Indices:
        """Their indices."""
        return np.flatnonzero(self.known)

    def inequality(self, k: int, shapes: list[Vector], unit: Vector) -> tuple[Vector, Vector]:
        """−Π − t unit ⪰ 0 at a point, as a linear matrix inequality in Q and t."""
        N, mean, weighted = (A[k] for A in self._parts)
        X, s = mean @ N, self.period
        free = N + N.T + s * N.T @ weighted @ N
        parts = [E @ X + X.T @ E + s * X.T @ E @ X for E in shapes]
        return -_half(free), np.array([*(-_half(p) for p in parts), -unit])

    def margins(self, Q: Vector, S: Vector) -> Vector:
        """The largest t with Π ⪯ −tS⁻¹ at each point, (B,)."""
        N, mean, weighted = self._parts
        NT, X = np.swapaxes(N, 1, 2), mean @ N
        form = N + Q @ X + (NT @ weighted @ N + np.swapaxes(X, 1, 2) @ Q @ X) * (self.period / 2)
        values, vectors = np.linalg.eigh(S)
        root = (vectors * np.sqrt(values)) @ vectors.T
        safe = root @ np.where(self.known[:, None, None], form, 0.0) @ root
        greatest: Vector = np.linalg.eigvalsh((safe + np.swapaxes(safe, 1, 2)) / 2)[:, -1]
        return np.where(self.known, -greatest, np.inf)


def _program(samples: list[_Samples], S: Vector) -> tuple[Vector, float] | None:
    """(Q, t), largest t, for these samples; None: t ≤ 0."""
    size, inverse = len(S), np.linalg.inv(S)
    inverse = (inverse + inverse.T) / 2
    shapes = [_symmetric(size, i, j) for i in range(size) for j in range(i, size)]
    unit = np.zeros((size, size))
    near = (_SHARE * inverse, np.array([*shapes, unit]))
    far = (_SHARE * inverse, np.array([*(-E for E in shapes), unit]))
    falling = [sample.inequality(k, shapes, inverse) for sample in samples for k in sample.usable]
    cost = np.zeros(len(shapes) + 1)
    cost[-1] = -1.0
    found = SemidefiniteProgram(cost, [near, far, *falling]).solution()
    if found is None or not found[-1] > 0:
        return None
    Q = sum((q * E for q, E in zip(found[:-1], shapes, strict=True)), unit)
    return Q, float(found[-1])


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
        with np.errstate(all="ignore"):
            return self._box_around(height)

    def _box_around(self, height: float) -> Interval | None:
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
    def stiffness(self) -> Vector:
        """∇²V(z̄)."""
        return self.design.lyapunov.hessian(self.design.z_bar)

    @cached_property
    def root(self) -> Vector:
        """Its square root."""
        values, vectors = np.linalg.eigh(self.stiffness)
        root: Vector = (vectors * np.sqrt(values)) @ vectors.T
        return root

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
