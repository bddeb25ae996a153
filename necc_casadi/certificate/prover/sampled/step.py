"""One sample of the loop over boxes: z⁺ − z = s Ñ ∇V for every s up to a period.

ẋ = f(x, u) with u held, and ξ advanced over the same s with x held as it was measured:

    x(s) − x = s (I + (s/2) A₁ + (s²/6) A₂A₃ + …) f,     Aᵢ in the hull of ∂f/∂x along the motion
    ξ⁺ − ξ   = s (I + (s/2) (N S′)_ξξ) k₁                 of Heun's method, s k₁ of Euler's

where (f, k₁) = N∇V, N = M − 𝒢𝒟𝒢ᵀ, and S′ is in the hull of ∇²V between ξ and its predictor.

Limits of u leave of −y_c + v, y_c = A∇Hc, an input −y_c + Σv, Σ diagonal in [0, I], wherever −y_c
is within them: Σ multiplies the rows of 𝒟 in N that are about u. Where they scale damping, it is
one number that multiplies all of 𝒟 that has to do with u.

References
----------
docs/theory.md#sampled-loop.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, reduce

import numpy as np
import sympy as sp

from necc_casadi.arrays import Truth, Vector
from necc_casadi.cases import Integrator
from necc_casadi.certificate.prover.arithmetic.affine import Affine, affine_matrices
from necc_casadi.certificate.prover.arithmetic.boxes import matrix_enclosure
from necc_casadi.certificate.prover.arithmetic.intervals import Interval, matmul, point
from necc_casadi.certificate.prover.arithmetic.jets import expression_values
from necc_casadi.certificate.prover.arithmetic.linearised import linearised
from necc_casadi.certificate.prover.arithmetic.networks import network_jet
from necc_casadi.certificate.prover.arithmetic.potential import Potential
from necc_casadi.lyapunov.damping import without_inputs

__all__ = ["Push", "Sample", "Step"]


#: Rounds in which a box that holds the motion of a sample is sought, and the room that is added.
_ROUNDS, _ROOM = 6, 1.02


@dataclass(frozen=True, eq=False)
class Sample:
    """One sample from boxes of states, for s in [s_lo, s_hi]; natural units."""

    period: Affine  # s, (B, 1, 1)
    step: Affine  # Ñ, (B, N, N)
    mean: Affine  # S̄ = ∫∇²V(z + θΔz)dθ
    weighted: Affine  # S̃ = 2∫(1 − θ)∇²V(z + θΔz)dθ
    gradient: Interval  # ∇V at the start, (B, N)
    inputs: Interval  # u of the law, (B, m)
    #: what limits leave of the damping of each channel, (B, channels); NaN: −y_c may be beyond them
    shares: Interval
    factor: Affine  # Ñ = factor N, (B, N, N)
    reached: Interval  # where z is on the way, (B, N)

    def form(self, Q: Vector) -> Affine:
        """Π with W(z⁺) − W(z) = s ∇VᵀΠ∇V, W = V + ½∇VᵀQ∇V, (B, N, N)."""
        metric = Affine(Q[None], np.zeros((1, 1, *Q.shape)), np.zeros((1, *Q.shape)))
        turned = self.mean @ self.step  # ∇V(z⁺) − ∇V(z) = s S̄Ñ∇V
        first = (self.step + metric @ turned).symmetric()
        second = self.step.T @ (self.weighted @ self.step) + turned.T @ (metric @ turned)
        return (first + second.scaled(self.period).times(0.5)).symmetric()


@dataclass(frozen=True, eq=False)
class Push:
    """What moves a sample away from the law, at most; natural units."""

    inputs: Vector  # |error of u|, (B, m)
    rates: Vector  # |error of ξ⁺ − ξ| for each unit of time, (B, nc)


@dataclass(frozen=True, eq=False)
class Step:
    """The sampled loop of a design in natural units, Φ the sum, nothing ahead of the loop."""

    potential: Potential
    integrator: Integrator

    def over(self, Z: Interval, s: Interval, push: Push | None = None) -> Sample:
        """Samples from boxes (B, N) that last between the ends of s (B,).

        With a push ∂f/∂x and ∇²V are enclosed along the motions that it may cause.
        """
        with np.errstate(all="ignore"):
            return self._over(Z, s, push)

    def _over(self, Z: Interval, s: Interval, push: Push | None) -> Sample:
        gradient = self.potential.jet(Z).grad
        N = matrix_enclosure(self.flow, self._symbols, Z)
        resting, damping = self._law(Z, gradient)
        u, shares = self._limited(resting, damping)
        scaled = self._left(N, self.channels(Z), shares)
        rates = matmul(scaled, gradient[..., None])[..., 0]
        n, upto = self._n, Interval(np.zeros_like(s.hi), s.hi)[:, None]
        bent, moved = self._advanced(Z, scaled, rates[:, n:], upto)
        given = u
        if push is not None:
            given = u + Interval(-push.inputs, push.inputs)
            moved = moved + upto * Interval(-push.rates, push.rates)
        drift = self._motion(Z[:, :n], given, upto)
        curved = self.potential.curvatures(_side_by_side(Z[:, :n] + drift, moved))
        energy, rest = linearised(self._bends, self._symbols[:n], Z[:, :n], drift, 0.5)
        blocks = [Interval(-rest, rest), *(A for A, _ in curved)]
        frames = [np.eye(self._size)[:n], *(L for _, L in curved)]
        slopes, left = self._slopes_over(Z[:, :n], given, drift)
        free = [N, Interval(-left, left)] + ([] if bent is None else [bent])
        free += self.channels(Z)
        made, count = affine_matrices(
            [*blocks, *blocks, *free], [True] * (2 * len(blocks)) + [False] * len(free)
        )
        # numbers of x, of u, of all that varies by itself, of Σ, and of s
        first = n + len(self._given)
        every = first + count + 1 + len(self._channels)
        made = [_among(A, first, every) for A in made]
        period = _constant(s.mid[:, None, None], made[0])
        period.parts[:, -1] = s.rad[:, None, None]
        known = _placed(_among(energy, 0, every), 0, self._size)
        mean, weighted = (
            known + _summed(made[k : k + len(blocks)], frames) for k in (0, len(blocks))
        )
        flow, apart, *more = made[2 * len(blocks) :]
        curved_flow = None if bent is None else more.pop(0)
        for i, channel in enumerate(more):
            share = shares[:, i] - 1.0
            lost = _constant(share.mid[:, None, None], flow)
            lost.parts[:, first + count + i] = share.rad[:, None, None]
            flow = flow + channel.scaled(lost)
        A = _among(slopes, 0, every) + apart
        factor = self._factor(period, A, curved_flow, s.hi)
        reached = _side_by_side(Z[:, :n] + drift, moved)
        asked = resting + damping
        return Sample(
            period, factor @ flow, mean, weighted, gradient, asked, shares, factor, reached
        )

    def _slopes_over(self, X: Interval, u: Interval, drift: Interval) -> tuple[Affine, Vector]:
        """Means of ∂f/∂x, (B, n, n)."""
        still = np.zeros_like(u.hi)
        Y, moved = _side_by_side(X, u), _side_by_side(drift, Interval(still, still))
        return linearised(self._slopes, [*self._symbols[: self._n], *self._given], Y, moved)

    def _factor(self, period: Affine, A: Affine, curved: Affine | None, most: Vector) -> Affine:
        """Diag(I + (s/2)A₁ + (s²/6)A₂A₃ + …, I + (s/2)(N S′)_ξξ), (B, N, N)."""
        boxes, size, n = len(most), self._size, self._n
        half = period.times(0.5)
        identity = _constant(np.broadcast_to(np.eye(size), (boxes, size, size)), period)
        result = identity + _placed(A, 0, size).scaled(half)
        if curved is not None:
            result = result + _placed(curved, n, size).scaled(half)
        second = (A @ A).scaled(period.scaled(period)).times(1 / 6)
        size_A = A.magnitude.sum(-1).max(-1)
        tail = (most * size_A) ** 3 / 24 * np.exp(most * size_A) * (1 + 1e-9)
        rest = np.zeros((boxes, size, size))
        rest[:, :n, :n] = tail[:, None, None]
        return (result + _placed(second, 0, size)).widened(rest)

    def channels(self, Z: Interval) -> list[Interval]:
        """What damping that limits leave shares of adds to N, (B, N, N) each; none without them."""
        return [matrix_enclosure(A, self._symbols, Z) for A in self._channels]

    def is_covered(self, Z: Interval, gradient: Interval) -> Truth:
        """Whether u is within its limits on boxes, or −y_c is, (B,)."""
        shares = self._limited(*self._law(Z, gradient))[1]
        return np.asarray(~np.isnan(shares.lo).any(-1))

    def inputs(self, Z: Interval, gradient: Interval) -> Interval:
        """U = −A∇Hc − [D B]𝒢ᵀ∇V, (B, m), before its limits."""
        resting, damping = self._law(Z, gradient)
        return resting + damping

    def _law(self, Z: Interval, gradient: Interval) -> tuple[Interval, Interval]:
        """−y_c = −A∇Hc, and v = −[D B]𝒢ᵀ∇V, (B, m)."""
        design, loop = self.potential.design, self.potential.design.loop
        weights = design.form.split(design.weights)[0]
        xi = Z[:, self._n :]
        ends, back = np.unique(np.concatenate([xi.lo, xi.hi], 1), axis=0, return_inverse=True)
        nc = xi.shape[1]
        slope = network_jet(design.form.hc, weights, Interval(ends[:, :nc], ends[:, nc:])).grad
        slope = slope[back.ravel()]
        A = matrix_enclosure(sp.Matrix(loop.feedback), self._symbols, Z)
        ports = matrix_enclosure(sp.Matrix(loop.ports.T), self._symbols, Z)
        damped = matmul(design.damping[: loop.plant.m], ports)
        resting = matmul(A, slope[..., None])[..., 0]
        return -resting, -matmul(damped, gradient[..., None])[..., 0]

    def _limited(self, resting: Interval, damping: Interval) -> tuple[Interval, Interval]:
        """What is held of −y_c + v, (B, m), and the shares Σ of v in it, (B, channels)."""
        u, limits = resting + damping, self._limits
        if limits is None:
            return u, point(np.ones_like(u.lo))
        kept: Truth = np.asarray((u.lo >= limits.lo) & (u.hi <= limits.hi))
        above, below = limits.hi - resting, resting - limits.lo
        inside = (above.lo >= 0) & (below.lo >= 0) & np.isfinite(damping.lo + damping.hi)
        up, down = _share(above, damping), _share(below, -damping)
        least, most = np.minimum(up.lo, down.lo), np.minimum(up.hi, down.hi)
        if not self.potential.design.scales_damping:
            shares = _known(Interval(least, most), kept, inside)
        else:
            every = Interval(least.min(-1, keepdims=True), most.min(-1, keepdims=True))
            # a limit that −y_c touches has no say in the share
            strictly = inside & (above.lo > 0) & (below.lo > 0)
            whole, within = (np.asarray(v.all(-1))[:, None] for v in (kept, strictly))
            shares = _known(every, whole, within)
            part = resting + shares * damping
            u = Interval(np.where(whole, u.lo, part.lo), np.where(whole, u.hi, part.hi))
        ends = (np.clip(v, limits.lo, limits.hi) for v in (u.lo, u.hi))
        return Interval(*ends), shares

    def _left(self, N: Interval, channels: list[Interval], shares: Interval) -> Interval:
        """N where limits scale damping that moves ξ, too, (B, N, N); else as it is."""
        if not (channels and self.potential.design.scales_damping):
            return N
        unknown = np.isnan(shares.lo)
        lost = Interval(np.where(unknown, 0.0, shares.lo), np.where(unknown, 1.0, shares.hi)) - 1.0
        return N + channels[0] * lost[..., None]

    def _motion(self, X: Interval, u: Interval, upto: Interval) -> Interval:
        """How far no motion from X goes beyond before s (Picard, Lindelöf); NaN: unknown."""
        held = X
        for _ in range(_ROUNDS):
            tried = X + upto * self._field_over(held, u)
            inside = (tried.lo >= held.lo) & (tried.hi <= held.hi)
            if inside.all():
                break
            known = inside.all(-1, keepdims=True)
            middle, radius = tried.mid, tried.rad
            room = radius * _ROOM
            lo = np.minimum(np.minimum(tried.lo, X.lo), middle - room)
            hi = np.maximum(np.maximum(tried.hi, X.hi), middle + room)
            held = Interval(np.where(known, held.lo, lo), np.where(known, held.hi, hi))
        moved = upto * self._field_over(held, u)
        tried = X + moved
        proved = ((tried.lo >= held.lo) & (tried.hi <= held.hi)).all(-1, keepdims=True)
        return Interval(np.where(proved, moved.lo, np.nan), np.where(proved, moved.hi, np.nan))

    def _advanced(
        self, Z: Interval, N: Interval, rate: Interval, upto: Interval
    ) -> tuple[Interval | None, Interval]:
        """((N S′)_ξξ, where ξ is on the way); None of Euler's method."""
        n = self._n
        X, xi = Z[:, :n], Z[:, n:]
        predicted = xi + upto * rate
        if self.integrator == "euler":
            return None, predicted
        S = self.potential.jet(_side_by_side(X, predicted)).hess
        bent = matmul(N[:, n:], S[:, :, n:])
        curved = matmul(bent, rate[..., None])[..., 0]
        return bent, xi + upto * (rate + upto * curved * 0.5)

    def _field_over(self, X: Interval, u: Interval) -> Interval:
        """F(x, u), (B, n)."""
        return self._values(self._field, X, u)

    def _values(self, entries: tuple[sp.Expr, ...], X: Interval, u: Interval) -> Interval:
        known = {s: X[:, i] for i, s in enumerate(self._symbols[: self._n])}
        known |= {s: u[:, i] for i, s in enumerate(self._given)}
        values = [v + np.zeros(len(X.lo)) for v in expression_values(list(entries), known)]
        lo, hi = ([getattr(v, end) for v in values] for end in ("lo", "hi"))
        return Interval(np.stack(lo, -1), np.stack(hi, -1))

    @property
    def _size(self) -> int:
        return self.potential.design.loop.n

    @property
    def _n(self) -> int:
        return self.potential.design.loop.plant.n

    @cached_property
    def _limits(self) -> Interval | None:
        """Of u, (m,)."""
        limits = self.potential.design.loop.plant.u_limits
        return None if limits is None else Interval(*np.array(limits, float).T)

    @cached_property
    def _channels(self) -> list[sp.Matrix]:
        if self._limits is None:
            return []
        design = self.potential.design
        ports, rows = sp.Matrix(design.loop.ports), self._damping
        if not design.scales_damping:
            return [-ports[:, i] * rows[i, :] * ports.T for i in range(len(self._given))]
        left = without_inputs(design.damping, design.loop.plant.m) != 0
        scaled = sp.Matrix(*rows.shape, lambda i, j: 0 if left[i, j] else rows[i, j])
        return [-ports * scaled * ports.T]

    @cached_property
    def _symbols(self) -> list[sp.Symbol]:
        return list(self.potential.design.loop.z)

    @cached_property
    def _given(self) -> list[sp.Dummy]:
        return [sp.Dummy("u", real=True) for _ in range(self.potential.design.loop.plant.m)]

    @cached_property
    def _field(self) -> tuple[sp.Expr, ...]:
        plant = self.potential.design.loop.plant
        return tuple(sp.Matrix(plant.flow) + sp.Matrix(plant.G) * sp.Matrix(self._given))

    @cached_property
    def _slopes(self) -> sp.Matrix:
        """∂f/∂x."""
        return sp.Matrix(self._field).jacobian(self._symbols[: self._n])

    @cached_property
    def _bends(self) -> sp.Matrix:
        """∇²H."""
        return sp.hessian(self.potential.energy, self._symbols[: self._n])

    @cached_property
    def flow(self) -> sp.Matrix:
        """N = M − 𝒢𝒟𝒢ᵀ, exactly."""
        loop = self.potential.design.loop
        ports = sp.Matrix(loop.ports)
        return sp.Matrix(loop.M) - ports * self._damping * ports.T

    @cached_property
    def _damping(self) -> sp.Matrix:
        """𝒟, exactly."""
        rows = self.potential.design.damping
        return sp.Matrix([[sp.Rational(*float(v).as_integer_ratio()) for v in row] for row in rows])


def _share(room: Interval, v: Interval) -> Interval:
    """How much of v is within room ≥ 0 above 0: min (1, room/v) where v > 0, else 1."""
    with np.errstate(all="ignore"):
        least = point(room.lo) / point(np.where(v.hi > 0, v.hi, np.nan))
        most = point(room.hi) / point(np.where(v.lo > 0, v.lo, np.nan))
    return Interval(np.fmin(np.maximum(least.lo, 0.0), 1.0), np.fmin(most.hi, 1.0))


def _known(shares: Interval, whole: Truth, inside: Truth) -> Interval:
    """1 where all is kept, the share where −y_c is within the limits, else NaN."""
    lo, hi = (np.where(whole, 1.0, np.where(inside, v, np.nan)) for v in (shares.lo, shares.hi))
    return Interval(lo, hi)


def _side_by_side(a: Interval, b: Interval) -> Interval:
    return Interval(np.concatenate([a.lo, b.lo], 1), np.concatenate([a.hi, b.hi], 1))


def _among(A: Affine, at: int, count: int) -> Affine:
    """The same with its numbers from `at` on among `count`."""
    boxes, own, rows, columns = A.parts.shape
    parts = np.zeros((boxes, count, rows, columns))
    parts[:, at : at + own] = A.parts
    return Affine(A.center, parts, A.error)


def _summed(blocks: Sequence[Affine], frames: Sequence[Vector]) -> Affine:
    """Σ LᵀAL."""
    terms = []
    for A, L in zip(blocks, frames, strict=True):
        frame = _constant(L[None], A)
        terms.append(frame.T @ A @ frame)
    return reduce(lambda a, b: a + b, terms)


def _constant(matrix: Vector, like: Affine) -> Affine:
    parts = np.zeros((len(matrix), like.parts.shape[1], *matrix.shape[1:]))
    return Affine(np.array(matrix), parts, np.zeros(matrix.shape))


def _placed(A: Affine, at: int, size: int) -> Affine:
    """A block on the diagonal of matrices (B, size, size) that are 0 elsewhere."""
    boxes, count, rows, _ = A.parts.shape
    center, error = np.zeros((boxes, size, size)), np.zeros((boxes, size, size))
    parts, block = np.zeros((boxes, count, size, size)), slice(at, at + rows)
    center[:, block, block], error[:, block, block] = A.center, A.error
    parts[:, :, block, block] = A.parts
    return Affine(center, parts, error)
