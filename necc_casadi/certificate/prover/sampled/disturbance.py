"""What a disturbed sample is, over boxes: how far u and ξ⁺ are from the law, and what falls.

    z⁺ − z = s (Ñ∇V + n),    W(z⁺) − W(z) = s (gᵀΠg + gᵀB n + (s/2) nᵀM n),
    M = S̃ + S̄QS̄,    B = I + QS̄ + s ÑᵀM

where n holds the error of u through the plant and that of ξ⁺. With a delay e = u − law(z) is a part
of n, and S = W + αT|e|² takes the place of W.

References
----------
docs/theory.md#rounding-noise-and-delay.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import sympy as sp

from necc_casadi.arrays import Truth, Vector
from necc_casadi.certificate.prover.arithmetic.affine import Affine, negative_definite
from necc_casadi.certificate.prover.arithmetic.boxes import matrix_enclosure, subdivide
from necc_casadi.certificate.prover.arithmetic.intervals import Interval, matmul, point
from necc_casadi.certificate.prover.arithmetic.potential import over_pieces
from necc_casadi.certificate.prover.sampled.measured import Measured, Taken
from necc_casadi.certificate.prover.sampled.step import Push, Sample, Step

__all__ = ["Computed", "Disturbed", "Falls"]


#: How close to its limit Π ≺ 0 may be, so that other arithmetic can confirm it; more than what is
#: left out of second order; more than the error of C⁻¹.
_EASED, _SECOND, _INVERSE = 0.8, 1 + 1e-6, 1 + 1e-9
#: How much farther than the states arguments of the law may be, as a share of a box's width.
_BESIDE = 0.25


@dataclass(frozen=True, eq=False)
class Falls:
    """Whether W, or S, falls wherever |(Cg, e)| > δ, by boxes (B,)."""

    proved: Truth
    least: Vector  # δ, (B,)
    rise: Vector  # of W at most, (B,)
    inputs: Interval  # u of the law and what it may be off, (B, m)


@dataclass(frozen=True, eq=False)
class Computed:
    """How far the computed law is off on a box."""

    box: Interval  # (N,)
    inputs: Vector  # (m,)
    rates: Vector  # of ξ̇, (nc,)
    earlier: Vector | None = None  # of a u that was computed a sample before, noise and all, (m,)


@dataclass(frozen=True, eq=False)
class Disturbed:
    """The sampled loop of a design under errors that are bounded; natural units."""

    step: Step
    measured: Measured
    Q: Vector
    frame: Vector  # C
    noise: Vector  # of y, (n,)
    input_error: Vector  # (m,)
    unit: float  # half the spacing of the numbers next to 1
    shortest: float
    longest: float
    delay: float | None  # α
    reach: Vector  # of e, at most, (m,); 0 without delay

    def over(self, Z: Interval, s: Interval, rate: float, rounding: Computed) -> Falls:
        """Samples from boxes (B, N) that last between the ends of s (B,), with Π ⪯ −rate CᵀC."""
        with np.errstate(all="ignore"):
            return self._over(Z, s, rate, rounding)

    def seen(self, Z: Interval) -> Interval:
        """A box (N,) that holds all arguments of the law in samples from a box (N,)."""
        taken, more = self._taken(Z[None]).states[0], _BESIDE * (Z.hi - Z.lo)
        return Interval(taken.lo - more, taken.hi + more)

    def earlier(self, box: Interval, rounding: Computed, pieces: int) -> Vector:
        """How far a u that is computed anywhere in a box (N,) is off at most, (m,)."""
        Z = subdivide(box, max(1, int(pieces ** (1 / len(box.lo)))))
        taken = self._taken(Z)
        off = taken.moved(self._slopes(taken.states), taken.errors)[:, : self._m].max(0)
        return np.asarray((off + rounding.inputs) * _SECOND, float)

    def _over(self, Z: Interval, s: Interval, rate: float, rounding: Computed) -> Falls:
        own, push, near = self._pushed(Z, s, rounding)
        wide = Push(push.inputs + self.reach, push.rates)
        sample = self.step.over(Z, s, wide)
        period, metric = sample.period, _fixed(self.Q, sample.step)
        turned = metric @ sample.mean
        bend = sample.weighted + sample.mean @ turned  # M
        first = _fixed(np.eye(len(self.Q)), sample.step) + turned
        first = first + (sample.step.T @ bend).scaled(period)  # B
        through = self._through(sample, Z)
        reached = np.concatenate(
            [(through.magnitude @ push.inputs[..., None])[..., 0], push.rates], 1
        )
        form, linear, square = self._with_delay(
            sample, first, bend, through, self._slopes(sample.reached), reached, rate
        )
        falls = negative_definite(form, _EASED)
        turned_back: Vector = np.asarray(np.linalg.inv(self.frame), float)
        lengths = _lengths(turned_back.T, first, linear, reached, self._weight(rate))
        square = square + 0.5 * s.hi * _quadratic(bend.magnitude, reached)
        root = np.sqrt(lengths**2 + 4 * rate * square)
        least = (lengths + root) / (2 * rate) * _SECOND
        rise = self.longest * (lengths**2 / (4 * rate) + square) * _SECOND
        known = near & np.isfinite(least) & np.isfinite(rise)
        inputs = sample.inputs + Interval(-own, own)
        return Falls(falls & known, least, rise, inputs)

    def largest_rate(self, Z: Vector, s: Vector) -> Vector:
        """The largest rate with Π ⪯ −rate CᵀC at states (B, N) and periods (B,), about."""
        with np.errstate(all="ignore"):
            return self._largest_rate(Z, s)

    def _largest_rate(self, Z: Vector, s: Vector) -> Vector:
        at = Interval(Z, Z)
        sample = self.step.over(at, Interval(s, s))
        form = sample.form(self.Q).center
        if self.delay is not None:
            bare = replace(self, frame=np.zeros_like(self.frame))
            turned = _fixed(self.Q, sample.step) @ sample.mean
            bend = sample.weighted + sample.mean @ turned
            first = _fixed(np.eye(len(self.Q)), sample.step) + turned
            first = first + (sample.step.T @ bend).scaled(sample.period)
            through = self._through(sample, at)
            none = np.zeros((len(Z), len(self.Q) - self._n + self._n))
            block, _, _ = bare._with_delay(
                sample, first, bend, through, self._slopes(at), none, 1.0
            )
            corner, side, last = _cut(block.center, len(self.Q))
            form = corner - side @ np.linalg.solve(last, np.swapaxes(side, 1, 2))
            form[(np.linalg.eigvalsh(last) >= 0).any(-1)] = np.eye(len(self.Q))
        back = np.linalg.inv(self.frame)
        best: Vector = -np.linalg.eigvalsh(back.T @ form @ back)[:, -1]
        return best

    def _weight(self, rate: float) -> float:
        """Of |e|² beside |Cg|²."""
        return 1.0 if self.delay is None else self.delay / (2 * rate)

    def _with_delay(
        self,
        sample: Sample,
        first: Affine,
        bend: Affine,
        through: Affine,
        slopes: Interval,
        reached: Vector,
        rate: float,
    ) -> tuple[Affine, Vector | None, Vector]:
        """The form that is to be ≺ 0, what is linear in n beside Bn, and what is of n alone."""
        own = _fixed(rate * self.frame.T @ self.frame, sample.step)
        form = (sample.form(self.Q) + own).symmetric()
        none = np.zeros(len(reached))
        if self.delay is None:
            return form, None, none
        n, m, size = self._n, self._m, len(self.Q)
        share = self.delay * self.longest**2  # αT²
        given = _placed(through, n, size)  # n = given e
        J = _free(slopes, sample.step)
        F, E = J @ sample.step, J @ given
        corner = form + (F.T @ F).times(share)
        side = (first @ given).times(0.5) + (F.T @ E).times(share)
        pushed = (given.T @ bend @ given).scaled(sample.period).times(0.5)
        last = pushed + (E.T @ E).times(share)
        last = last + _fixed((rate * self._weight(rate) - self.delay) * np.eye(m), sample.step)
        moved = (slopes.magnitude @ reached[..., None])[..., 0]  # |J n|
        onto_g = 2 * share * (np.swapaxes(F.magnitude, 1, 2) @ moved[..., None])[..., 0]
        onto_e = 2 * share * (np.swapaxes(E.magnitude, 1, 2) @ moved[..., None])[..., 0]
        bent = (given.T @ bend).scaled(sample.period).magnitude
        onto_e = onto_e + (bent @ reached[..., None])[..., 0]
        linear = np.concatenate([onto_g, onto_e], 1)
        return _block(corner, side, last), linear, share * (moved**2).sum(-1)

    def _through(self, sample: Sample, Z: Interval) -> Affine:
        """How an error of u moves x: x⁺ is off by s times this and the error, (B, n, m)."""
        G = matrix_enclosure(sp.Matrix(self.step.potential.design.loop.plant.G), self._z, Z)
        n = self._n
        factor = sample.factor
        block = Affine(
            factor.center[:, :n, :n], factor.parts[:, :, :n, :n], factor.error[:, :n, :n]
        )
        return block @ _free(G, sample.step)

    # --- errors of the law ------------------------------------------------------------------------

    def _pushed(self, Z: Interval, s: Interval, rounding: Computed) -> tuple[Vector, Push, Truth]:
        """Errors of the computed u, of the applied u and of ξ⁺; whether they hold, (B,)."""
        m, n, u = self._m, self._n, self.unit
        taken = self._taken(Z)
        seen, blur = taken.states, taken.errors
        first = taken.moved(self._slopes(seen), blur)
        own = first[:, :m] + rounding.inputs
        rate_off = first[:, m:] + rounding.rates
        rates = self._rates(seen)
        size, upto = rates.magnitude, Interval(np.zeros_like(s.hi), s.hi)[:, None]
        last = s.hi[:, None]
        held, off = seen, rate_off
        if self.step.integrator == "heun":
            xi = Z[:, n:].magnitude
            away = blur[:, n:] + last * rate_off + 4 * u * (xi + blur[:, n:] + last * size)
            there = Z[:, n:] + upto * rates + Interval(-away, away)
            held = Interval(
                np.concatenate([seen.lo[:, :n], np.minimum(seen.lo[:, n:], there.lo)], 1),
                np.concatenate([seen.hi[:, :n], np.maximum(seen.hi[:, n:], there.hi)], 1),
            )
            blurred = np.concatenate([blur[:, :n], away], 1)
            second = taken.moved(self._slopes(held), blurred)[:, m:]
            off = 0.5 * (rate_off + second + rounding.rates)
            size = np.maximum(size, self._rates(held).magnitude)
        floor = 2 * u**2 * (Z[:, n:].magnitude + last * size) / self.shortest
        rates_off = (off + 8 * u * (size + off) + floor) * _SECOND
        inside = (held.lo >= rounding.box.lo) & (held.hi <= rounding.box.hi)
        known = np.isfinite(own).all(-1) & np.isfinite(rates_off).all(-1)
        near: Truth = np.asarray(known & inside.all(-1), dtype=bool)
        applied = own if rounding.earlier is None else np.broadcast_to(rounding.earlier, own.shape)
        return own * _SECOND, Push((applied + self.input_error) * _SECOND, rates_off), near

    def _taken(self, Z: Interval) -> Taken:
        """What the code takes for (x, ξ) of boxes (B, N)."""
        return self.measured.taken(Z, self.noise, self.unit)

    def _slopes(self, Z: Interval) -> Interval:
        """Derivatives of (u, ξ̇) in (x, ξ), (B, m + nc, N)."""
        potential, n, z = self.step.potential, self._n, self._z
        jet, (slope, bend) = potential.jet(Z), self._controller(Z)
        E = matrix_enclosure(self._law, z, Z)
        inner = np.zeros((1, len(slope.lo[0]), len(z)))
        inner[0, :, n:] = np.eye(len(slope.lo[0]))
        curved = matmul(bend, point(inner))
        stacked = _on_top(jet.hess, curved)
        total = matmul(E, stacked)
        both = _beside(jet.grad, slope)[..., None]
        for j, A in self._law_slopes.items():
            column = matmul(matrix_enclosure(A, z, Z), both)[..., 0]
            unit = np.zeros((1, 1, len(z)))
            unit[..., j] = 1.0
            total = total + column[..., None] * point(unit)
        return total

    def _rates(self, Z: Interval) -> Interval:
        """ξ̇ of the law, (B, nc)."""
        gradient = self.step.potential.jet(Z).grad
        N = matrix_enclosure(self._law[self._m :, : len(self._z)], self._z, Z)
        return matmul(N, gradient[..., None])[..., 0]

    def _controller(self, Z: Interval) -> tuple[Interval, Interval]:
        """∇Hc and ∇²Hc."""
        design = self.step.potential.design
        xi = Z[:, self._n :]
        jet = over_pieces(design.form.hc, design.form.split(design.weights)[0], xi)
        return jet.grad, jet.hess

    @cached_property
    def _law(self) -> sp.Matrix:
        """E with (u, ξ̇) = E (∇V, ∇Hc), (m + nc, N + nc)."""
        step, design = self.step, self.step.potential.design
        loop, m = design.loop, self._m
        rows = [[sp.Rational(*float(v).as_integer_ratio()) for v in row] for row in design.damping]
        ports = sp.Matrix(loop.ports)
        upper = sp.Matrix.hstack(-sp.Matrix(rows[:m]) * ports.T, -sp.Matrix(loop.feedback))
        nc = loop.controller.nc
        lower = sp.Matrix.hstack(step.flow[self._n :, :], sp.zeros(nc, nc))
        return sp.Matrix.vstack(upper, lower)

    @cached_property
    def _law_slopes(self) -> dict[int, sp.Matrix]:
        """∂E/∂zⱼ, where it is not 0."""
        slopes = {j: self._law.diff(s) for j, s in enumerate(self._z)}
        return {j: A for j, A in slopes.items() if not A.is_zero_matrix}

    @property
    def _z(self) -> list[sp.Symbol]:
        return list(self.step.potential.design.loop.z)

    @property
    def _n(self) -> int:
        return self.step.potential.design.loop.plant.n

    @property
    def _m(self) -> int:
        return self.step.potential.design.loop.plant.m


def _lengths(
    back: Vector, first: Affine, linear: Vector | None, reached: Vector, weight: float
) -> Vector:
    """How long what is linear in n is at most, beside (Cg, e), (B,)."""
    turned = _fixed(back, first) @ first
    onto = (turned.magnitude @ reached[..., None])[..., 0]
    if linear is None:
        length: Vector = np.sqrt((onto**2).sum(-1)) * _INVERSE
        return length
    size = back.shape[0]
    onto = onto + (np.abs(back) @ linear[:, :size, None])[..., 0]
    own = (linear[:, size:] ** 2).sum(-1) / weight
    both: Vector = np.sqrt((onto**2).sum(-1) + own) * _INVERSE
    return both


def _quadratic(A: Vector, v: Vector) -> Vector:
    total: Vector = ((A @ v[..., None])[..., 0] * v).sum(-1)
    return total


def _fixed(matrix: Vector, like: Affine) -> Affine:
    """A matrix that depends on nothing."""
    parts = np.zeros((1, like.parts.shape[1], *matrix.shape))
    return Affine(matrix[None].copy(), parts, np.zeros((1, *matrix.shape)))


def _free(A: Interval, like: Affine) -> Affine:
    """Interval matrices (B, r, c), each entry on its own."""
    parts = np.zeros((len(A.lo), like.parts.shape[1], *A.shape[1:]))
    return Affine(A.mid, parts, A.rad)


def _placed(A: Affine, n: int, size: int) -> Affine:
    """Rows above zeros, (B, size, m)."""
    below = size - n

    def taller(v: Vector) -> Vector:
        gap = np.zeros((*v.shape[:-2], below, v.shape[-1]))
        return np.concatenate([v, gap], -2)

    return Affine(taller(A.center), taller(A.parts), taller(A.error))


def _block(corner: Affine, side: Affine, last: Affine) -> Affine:
    """[[corner, side], [sideᵀ, last]]."""

    def joined(a: Vector, b: Vector, c: Vector) -> Vector:
        above = np.concatenate([a, b], -1)
        below = np.concatenate([np.swapaxes(b, -1, -2), c], -1)
        return np.concatenate([above, below], -2)

    parts = (joined(*(getattr(A, k) for A in (corner, side, last))) for k in _MEMBERS)
    return Affine(*parts)


_MEMBERS = ("center", "parts", "error")


def _cut(A: Vector, size: int) -> tuple[Vector, Vector, Vector]:
    return A[:, :size, :size], A[:, :size, size:], A[:, size:, size:]


def _on_top(a: Interval, b: Interval) -> Interval:
    return Interval(np.concatenate([a.lo, b.lo], 1), np.concatenate([a.hi, b.hi], 1))


_beside = _on_top
