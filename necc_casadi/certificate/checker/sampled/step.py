"""One sample of the loop over a box in Arb balls: z⁺ − z = s Ñ ∇V (docs/theory.md#sampled-loop)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from itertools import count

import sympy as sp
from flint import arb, arb_mat

from necc_casadi.certificate.checker.arithmetic.balls import Box, ball, ends
from necc_casadi.certificate.checker.arithmetic.potential import Energy
from necc_casadi.certificate.checker.arithmetic.tapes import Tape
from necc_casadi.certificate.checker.model import StoredDesign
from necc_casadi.certificate.checker.sampled.linear import Linear
from necc_casadi.certificate.checker.sampled.linearised import Linearised

__all__ = ["SampleProof", "StepProof"]


#: Tries to enclose the motion of a sample; boxes are widened to multiples of this, so that many
#: are alike.
_TRIES, _GRID = 6, 2.0**-8


@dataclass(frozen=True)
class SampleProof:
    """A sample over a box and periods: z⁺ − z = s Ñ∇V, Ñ = factor N."""

    period: tuple[int, arb, arb]  # s, a number of its own, its middle and its radius
    factor: Linear
    step: Linear  # Ñ
    mean: Linear  # S̄
    weighted: Linear  # S̃
    reached: Box  # where z is on the way

    def form(self, Q: arb_mat) -> Linear:
        """A matrix with symmetric part Π, W(z⁺) − W(z) = s ∇VᵀΠ∇V."""
        metric, step = Linear(Q, {}), self.step
        turned = self.mean @ step
        second = step.T @ (self.weighted @ step) + turned.T @ (metric @ turned)
        return step + metric @ turned + second.scaled(self.period).times(arb(1) / 2)


class StepProof:
    """The sampled loop of a stored design, as the exported method advances it."""

    def __init__(self, model: StoredDesign, energy: Energy, integrator: str) -> None:
        self.model, self.energy, self.heun = model, energy, integrator == "heun"
        n, z = model.n, model.z
        damping = sp.Matrix(
            [[sp.Rational(*v.as_integer_ratio()) for v in r] for r in model.damping]
        )
        flow = model.Jcl - model.Rcl - model.ports * damping * model.ports.T
        self.flow = flow
        given = [sp.Dummy("u", real=True) for _ in range(model.m)]
        gradient = sp.Matrix([sp.diff(model.H, v) for v in z[:n]])
        field = (model.J - model.R) * gradient + model.G * sp.Matrix(given)
        self._flow = Tape(list(flow), z)
        self._field = Tape(list(field), [*z[:n], *given])
        self._slopes = Linearised(field.jacobian(z[:n]), [*z[:n], *given], False)
        self._bends = Linearised(sp.hessian(model.H, z[:n]), z[:n], True)
        self._feedback = Tape(list(model.feedback), z)
        self._ports = Tape(list(damping[: model.m, :] * model.ports.T), z)
        self.limits = model.u_limits or []
        parts = [-model.ports * D * model.ports.T for D in _limited_parts(model, damping)]
        self._channels = [Tape(list(A), z) for A in parts]

    @property
    def covered(self) -> bool:
        """Whether ξ̇ is (N∇V)_ξ with an N that ξ does not enter, nor u where it has limits."""
        model = self.model
        apart = not self.limits or model.ports[model.n :, : model.m].is_zero_matrix
        return bool(apart) and not self.flow.has(*model.z[model.n :])

    def inputs(self, box: Box, gradient: Sequence[arb]) -> list[arb]:
        """U over a box, before its limits."""
        return [a + b for a, b in zip(*self._law(box, gradient), strict=True)]

    def held(self, box: Box, gradient: Sequence[arb]) -> tuple[list[arb], list[arb]] | None:
        """What limits leave of u = −y_c + v, and the shares of v in it, or of all damping.

        None where −y_c may be beyond them and u too.
        """
        if self.model.scales_damping:
            return self._scaled(*self._law(box, gradient))
        resting, damping = self._law(box, gradient)
        u = [a + b for a, b in zip(resting, damping, strict=True)]
        held: list[arb] = []
        shares: list[arb] = []
        for value, rest, v, limits in zip(u, resting, damping, self.limits, strict=True):
            lo, hi = map(arb, limits)
            if bool(value >= lo) and bool(value <= hi):
                held, shares = [*held, value], [*shares, arb(1)]
                continue
            if not (v.is_finite() and bool(rest >= lo) and bool(rest <= hi)):
                return None
            held.append(value.max(lo).min(hi))
            shares.append(_share(v, hi - rest, rest - lo))
        return held, shares

    def _scaled(self, resting: list[arb], damping: list[arb]) -> tuple[list[arb], list[arb]] | None:
        """The same where all damping has one share, the largest that every input allows."""
        limits = [(arb(lo), arb(hi)) for lo, hi in self.limits]
        u = [a + b for a, b in zip(resting, damping, strict=True)]
        if all(bool(v >= lo) and bool(v <= hi) for v, (lo, hi) in zip(u, limits, strict=True)):
            return u, [arb(1)]
        least, most = arb(1), arb(1)
        for rest, v, (lo, hi) in zip(resting, damping, limits, strict=True):
            if not (v.is_finite() and bool(rest > lo) and bool(rest < hi)):
                return None  # a limit that −y_c touches has no say in the share
            share = _share(v, hi - rest, rest - lo)
            least, most = least.min(share.lower()), most.min(share.upper())
        tau = least.union(most)
        held = [
            (rest + tau * v).max(lo).min(hi)
            for rest, v, (lo, hi) in zip(resting, damping, limits, strict=True)
        ]
        return held, [tau]

    def _law(self, box: Box, gradient: Sequence[arb]) -> tuple[list[arb], list[arb]]:
        """−y_c and v."""
        model, values = self.model, [ball(*side) for side in box]
        slopes = self.energy.hc(box[-model.nc :])[1]
        A = _table(self._feedback(values), model.nc)
        B = _table(self._ports(values), len(box))
        return [-_dot(a, slopes) for a in A], [-_dot(b, gradient) for b in B]

    def rates(self, box: Box, gradient: Sequence[arb]) -> list[arb]:
        """N∇V over a box, of which the last are ξ̇."""
        N = _table(self._flow([ball(*side) for side in box]), len(box))
        return [_dot(row, gradient) for row in N]

    def form(
        self,
        box: Box,
        gradient: list[arb],
        u: list[arb],
        period: tuple[float, float],
        Q: arb_mat,
        shares: Sequence[arb] = (),
    ) -> Linear | None:
        """A matrix with symmetric part Π, W(z⁺) − W(z) = s ∇VᵀΠ∇V; None: the motion is not held."""
        sample = self.sample(box, gradient, u, period, shares=shares)
        return None if sample is None else sample.form(Q)

    def sample(
        self, box: Box, gradient: list[arb], u: list[arb], period: tuple[float, float],
        push: Sequence[arb] = (), shares: Sequence[arb] = (),
    ) -> SampleProof | None:  # fmt: skip
        """A sample over a box, u in balls; None: the motion is not held.

        `push` bounds the error of ξ⁺ − ξ for each unit of time. u is what is held, of which the
        damping has these shares; all where none are given.
        """
        model, names = self.model, count()
        n, size, last = model.n, len(box), period[1]
        values = [ball(*side) for side in box]
        full = _table(self._flow(values), size)
        N = self._left(values, full, shares)  # of ξ̇; u is what is held
        rate = [_dot(row, gradient) for row in N]
        X = self._motion(box[:n], u, last)
        if X is None:
            return None
        upto = ball(0.0, last)
        there = [v + upto * r for v, r in zip(values[n:], rate[n:], strict=True)]
        bent: list[list[arb]] | None = None
        if self.heun:
            parts = self.energy.curvatures(_outwards([*values[:n], *there]))
            # without ∇²H, which is about x alone
            S = reduce(lambda a, b: a + b, (L.transpose() * A * L for A, L in parts))
            bent = (arb_mat(N[n:]) * arb_mat([row[n:] for row in S.tolist()])).tolist()
            more = [_dot(row, rate[n:]) for row in bent]
            there = [
                v + upto * (r + upto * a / 2)
                for v, r, a in zip(values[n:], rate[n:], more, strict=True)
            ]
        for i, off in enumerate(push):
            there[i] = there[i] + upto * off * ball(-1.0, 1.0)
        reached = _outwards([*(ball(*side) for side in X), *there])
        blocks = self.energy.curvatures(reached)
        varying = [next(names) for _ in range(n + model.m)]
        bends = [self._bends(box[:n], X, varying[:n], names, arb(1) / 2) for _ in range(2)]
        mean, weighted = (_whole(H, blocks, size, names) for H in bends)
        given = tuple(ends(v) for v in u)
        slopes = self._slopes((*box[:n], *given), (*X, *given), varying, names)
        s = (next(names), arb(period[0] / 2 + period[1] / 2), arb(0))
        s = (s[0], s[1], _spread(period, s[1]))
        factor = self._factor(slopes, bent, s, last, names, size)
        step = factor @ self._clipped(values, full, shares, names)
        return SampleProof(s, factor, step, mean, weighted, reached)

    def _left(
        self, values: list[arb], N: list[list[arb]], shares: Sequence[arb]
    ) -> list[list[arb]]:
        """N where limits scale damping that moves ξ, too; else as it is."""
        if not (shares and self.model.scales_damping):
            return N
        (share,), (channel,) = shares, self._channels
        lost = _table(channel(values), len(values))
        return [
            [a + (share - 1) * b for a, b in zip(row, part, strict=True)]
            for row, part in zip(N, lost, strict=True)
        ]

    def _clipped(
        self,
        values: list[arb],
        N: list[list[arb]],
        shares: Sequence[arb],
        names: count[int],
    ) -> Linear:
        """N with these shares of the damping in the inputs."""
        flow, size = Linear.of(N, names, False), len(values)
        for share, channel in zip(shares, self._channels, strict=bool(shares)):
            if bool(share == arb(1)):
                continue
            part = Linear.of(_table(channel(values), size), names, False)
            middle = share.mid()
            radius = (share - middle).abs_upper()
            flow = flow + part.scaled((next(names), middle - 1, radius))
        return flow

    def _factor(
        self,
        A: Linear,
        bent: list[list[arb]] | None,
        s: tuple[int, arb, arb],
        last: float,
        names: count[int],
        size: int,
    ) -> Linear:
        """Diag(I + (s/2)A₁ + (s²/6)A₂A₃ + …, I + (s/2)(N S′)_ξξ)."""
        n = self.model.n
        half = A.placed(size).scaled(s).times(arb(1) / 2)
        if bent is not None:
            block = [[arb(0)] * size for _ in range(size)]
            for i, row in enumerate(bent):
                block[n + i][n:] = row
            half = half + Linear.of(block, names, False).scaled(s).times(arb(1) / 2)
        second = (A @ A).placed(size).scaled(s).scaled(s).times(arb(1) / 6)
        norm = reduce(arb.max, (sum(row, arb(0)).upper() for row in A.magnitude().tolist()))
        tail = (norm * last) ** 3 / 24 * (norm * last).exp() * ball(-1.0, 1.0)
        rest = [[tail if i < n and j < n else arb(0) for j in range(size)] for i in range(size)]
        identity = arb_mat([[int(i == j) for j in range(size)] for i in range(size)])
        return half + second + Linear(identity + arb_mat(rest), {})

    def _motion(self, X: Box, u: list[arb], last: float) -> Box | None:
        """A box that no motion from X leaves up to the last time; None: none was found."""
        upto, held = ball(0.0, last), X
        for _ in range(_TRIES):
            rates = self._field([*(ball(*side) for side in held), *u])
            if not all(r.is_finite() for r in rates):
                return None
            tried = _outwards([ball(*side) + upto * r for side, r in zip(X, rates, strict=True)])
            if all(a <= lo and hi <= b for (a, b), (lo, hi) in zip(held, tried, strict=True)):
                return tried
            held = tuple(
                (min(a[0], b[0]) - _GRID, max(a[1], b[1]) + _GRID)
                for a, b in zip(held, tried, strict=True)
            )
        return None


def _limited_parts(model: StoredDesign, damping: sp.Matrix) -> list[sp.Matrix]:
    """What of 𝒟 each share is of: a row for each input, or all that has to do with u."""
    size = range(damping.rows)
    if not model.u_limits:
        return []
    if model.scales_damping:
        shared = [[i for i in size if i < model.m or model.is_coupled]]
    else:
        shared = [[k] for k in range(model.m)]
    return [
        sp.Matrix([[damping[i, j] if i in rows else 0 for j in size] for i in size])
        for rows in shared
    ]


def _share(v: arb, above: arb, below: arb) -> arb:
    """Of v, what room above and below 0, neither negative, leaves: where it varies, its hull."""
    one, least, most = arb(1), arb(1), arb(1)
    lowest, highest = v.lower(), v.upper()
    if bool(highest > 0):
        least = least.min((above.lower() / highest).lower())
    if bool(lowest < 0):
        least = least.min((below.lower() / -lowest).lower())
    if bool(lowest > 0):
        most = most.min((above.upper() / lowest).upper())
    if bool(highest < 0):
        most = most.min((below.upper() / -highest).upper())
    return least.max(arb(0)).min(one).union(most.max(arb(0)).min(one))


def _whole(
    H: Linear, blocks: Sequence[tuple[arb_mat, arb_mat]], size: int, names: count[int]
) -> Linear:
    """∇²V from ∇²H and what is Σ LᵀAL."""
    total = H.placed(size)
    for A, frame in blocks:
        own, L = Linear.of(A.tolist(), names, True), Linear(frame, {})
        total = total + L.T @ own @ L
    return total


def _spread(period: tuple[float, float], middle: arb) -> arb:
    """A radius about the middle."""
    return (arb(period[1]) - middle).max(middle - arb(period[0])).upper()


def _outwards(values: Sequence[arb]) -> Box:
    """A box around balls, its ends multiples of the grid."""
    sides = []
    for v in values:
        if not v.is_finite():
            return ((math.nan, math.nan),) * len(values)
        lo, hi = ends(v)
        sides.append((math.floor(lo / _GRID) * _GRID, math.ceil(hi / _GRID) * _GRID))
    return tuple(sides)


def _table(values: Sequence[arb], columns: int) -> list[list[arb]]:
    return [list(values[k : k + columns]) for k in range(0, len(values), columns)]


def _dot(a: Sequence[arb], b: Sequence[arb]) -> arb:
    return sum((x * y for x, y in zip(a, b, strict=True)), arb(0))
