"""A disturbed sample over a box in Arb balls: how far it is from the law, and what falls.

The equations are those of docs/theory.md#rounding-noise-and-delay.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise, product

import sympy as sp
from flint import arb, arb_mat

from necc_casadi.certificate.checker.arithmetic.balls import Box, ball, ends
from necc_casadi.certificate.checker.arithmetic.tapes import Tape
from necc_casadi.certificate.checker.sampled.linear import Linear, falls
from necc_casadi.certificate.checker.sampled.measured import MeasuredProof, TakenBox
from necc_casadi.certificate.checker.sampled.rounding import units
from necc_casadi.certificate.checker.sampled.step import SampleProof, StepProof
from necc_casadi.certificate.claims.disturbed import DisturbedRegion

__all__ = ["Computed", "DisturbedStep", "Falls", "cut"]


_UNIT = ball(-1.0, 1.0)


@dataclass(frozen=True)
class Computed:
    """How far the computed law is off on a box."""

    box: Box
    inputs: list[arb]
    rates: list[arb]  # of ξ̇
    earlier: list[arb]  # of a u that was computed a sample before, noise and all; none: no delay


@dataclass(frozen=True)
class Falls:
    """W, or S, falls over a sample wherever |(C∇V, e)| > least, and rises by no more elsewhere."""

    least: arb
    rise: arb
    inputs: list[arb]  # u of the law and what the computed one may be off


class DisturbedStep:
    """The sampled loop of a stored design under the errors of a claim."""

    def __init__(self, step: StepProof, Q: arb_mat, found: DisturbedRegion) -> None:
        self.step, self.Q, self.found = step, Q, found
        self.model = model = step.model
        self.unit, self.measured = units(found.precision)[0], MeasuredProof(model)
        self.frame = arb_mat([list(row) for row in found.frame])
        self.back = self.frame.inv()
        z, n, m = model.z, model.n, model.m
        damping = sp.Matrix(
            [[sp.Rational(*v.as_integer_ratio()) for v in r] for r in model.damping]
        )
        upper = sp.Matrix.hstack(-damping[:m, :] * model.ports.T, -sp.Matrix(model.feedback))
        lower = sp.Matrix.hstack(step.flow[n:, :], sp.zeros(model.nc, model.nc))
        law = sp.Matrix.vstack(upper, lower)  # (u, ξ̇) = law (∇V, ∇Hc)
        self._law = Tape(list(law), z)
        slopes = {j: law.diff(s) for j, s in enumerate(z)}
        self._law_slopes = {j: Tape(list(A), z) for j, A in slopes.items() if not A.is_zero_matrix}
        self._G = Tape(list(model.G), z)
        self.reach = arb(0)  # |e| at most, in every entry
        if found.delay is not None:
            most = arb(found.height) * arb("1.000002") / (arb(found.delay) * arb(found.period))
            self.reach = most.sqrt().upper()

    def seen(self, box: Box) -> Box:
        """A box that holds all arguments of the law in samples from a box, which is checked."""
        return tuple(
            ends(ball(*side) + _UNIT * ((arb(hi) - arb(lo)) / 4))
            for side, (lo, hi) in zip(self._taken(box).states, box, strict=True)
        )

    def _taken(self, box: Box) -> TakenBox:
        """What the code takes for (x, ξ) of a box."""
        return self.measured.taken(box, self.found.noise, self.unit)

    def earlier(self, box: Box, inputs: Sequence[arb], pieces: int) -> list[arb]:
        """How far a u that is computed anywhere in a box is off, given its rounding."""
        worst = [arb(0)] * self.model.m
        for piece in cut(box, pieces):
            taken = self._taken(piece)
            off = taken.moved(self.slopes(taken.states), taken.errors)
            worst = [w.max(v) for w, v in zip(worst, off, strict=False)]
        return [(w + e).upper() for w, e in zip(worst, inputs, strict=True)]

    def over(
        self,
        box: Box,
        period: tuple[float, float],
        gradient: list[arb],
        rate: arb,
        rounding: Computed,
    ) -> Falls | None:
        """Samples over a box and periods, with Π ⪯ −rate CᵀC; None: it is not proved."""
        model, n = self.model, self.model.n
        pushed = self._pushed(box, period[1], rounding)
        if pushed is None:
            return None
        own, rates_off = pushed
        u = self.step.inputs(box, gradient)
        applied = rounding.earlier or own
        off = [a + arb(e) for a, e in zip(applied, self.found.input_error, strict=True)]
        given = [v + _UNIT * (e + self.reach) for v, e in zip(u, off, strict=True)]
        sample = self.step.sample(box, gradient, given, period, rates_off)
        if sample is None:
            return None
        metric = Linear(self.Q, {})
        bend = sample.weighted + sample.mean @ metric @ sample.mean  # M
        first = Linear(_identity(len(box)), {}) + metric @ sample.mean
        first = first + (sample.step.T @ bend).scaled(sample.period)  # B
        G = _table(self._G([ball(*side) for side in box]), model.m)
        through = sample.factor @ Linear(
            arb_mat([*G, *[[arb(0)] * model.m] * model.nc]), {}
        )  # errors of u move z by s times this
        moved = (through.magnitude() * _column(off)).tolist()[:n]
        reached = _column([*(v for (v,) in moved), *rates_off])  # |n|
        own_form = Linear(self.frame.transpose() * self.frame * rate, {})
        form, square = sample.form(self.Q) + own_form, arb(0)
        onto = _upper(Linear(self.back.transpose(), {}) @ first, reached)
        lengths = _square(onto)
        if self.found.delay is not None:
            form, onto, lengths, square = self._with_delay(
                sample, form, first, bend, through, reached, onto, rate
            )
        if not falls(form):
            return None
        bent = (reached.transpose() * bend.magnitude() * reached)[0, 0]
        square = square + arb(period[1]) * bent / 2
        least = (lengths.sqrt() + (lengths + 4 * rate * square).sqrt()) / (2 * rate)
        rise = arb(self.found.period) * (lengths / (4 * rate) + square)
        if not (least.is_finite() and rise.is_finite()):
            return None
        inputs = [v + _UNIT * e for v, e in zip(u, own, strict=True)]
        return Falls(least.upper(), rise.upper(), inputs)

    def weight(self, rate: arb) -> arb:
        """Of |e|² beside |C∇V|²."""
        return arb(1) if self.found.delay is None else arb(self.found.delay) / (2 * rate)

    def _with_delay(
        self,
        sample: SampleProof,
        form: Linear,
        first: Linear,
        bend: Linear,
        through: Linear,
        reached: arb_mat,
        onto: arb_mat,
        rate: arb,
    ) -> tuple[Linear, arb_mat, arb, arb]:
        """The form of (∇V, e), what is linear in n with its square, and what is of n alone."""
        size, m = len(reached.tolist()), self.model.m
        alpha = arb(self.found.delay or 0.0)
        share = alpha * arb(self.found.period) ** 2  # αT²
        J = Linear(arb_mat(self.slopes(sample.reached)[:m]), {})
        F, E = J @ sample.step, J @ through
        corner = form + (F.T @ F).times(share)
        side = (first @ through).times(arb(1) / 2) + (F.T @ E).times(share)
        pushed = through.T @ bend
        last = (pushed @ through).scaled(sample.period).times(arb(1) / 2)
        last = last + (E.T @ E).times(share)
        last = last + Linear(_identity(m) * (rate * self.weight(rate) - alpha), {})
        moved = J.magnitude() * reached  # |J n|
        more = (F.magnitude().transpose() * moved) * (2 * share)
        onto_g = onto + _absolute(self.back.transpose()) * more
        onto_e = (E.magnitude().transpose() * moved) * (2 * share)
        onto_e = onto_e + pushed.scaled(sample.period).magnitude() * reached
        lengths = _square(onto_g) + _square(onto_e) / self.weight(rate)
        above, below = _rows_of(size, m, 0), _rows_of(m, size, size)
        whole = above @ corner @ above.T + below @ last @ below.T
        whole = whole + (above @ side @ below.T).times(arb(2))
        return whole, onto_g, lengths, share * _square(moved)

    # --- errors of the law ------------------------------------------------------------------------

    def _pushed(
        self, box: Box, last: float, rounding: Computed
    ) -> tuple[list[arb], list[arb]] | None:
        """Errors of the computed u and of ξ⁺ − ξ for each unit of time; None: not known."""
        m, n, u = self.model.m, self.model.n, self.unit
        taken = self._taken(box)
        seen, blur = taken.states, taken.errors
        first = taken.moved(self.slopes(seen), blur)
        own = [(v + e).upper() for v, e in zip(first[:m], rounding.inputs, strict=True)]
        rate_off = [v + e for v, e in zip(first[m:], rounding.rates, strict=True)]
        rates, xi = self._rates(seen), [ball(*side).abs_upper() for side in box[n:]]
        sizes, off, held, upto = [v.abs_upper() for v in rates], rate_off, seen, ball(0.0, last)
        if self.step.heun:
            away = [
                e + last * r + 4 * u * (v + e + last * size)
                for e, r, v, size in zip(blur[n:], rate_off, xi, sizes, strict=True)
            ]
            there = [
                ends((ball(*side) + upto * r + _UNIT * a).union(ball(*was)))
                for side, r, a, was in zip(box[n:], rates, away, seen[n:], strict=True)
            ]
            held = (*seen[:n], *there)
            second = taken.moved(self.slopes(held), [*blur[:n], *away])[m:]
            off = [
                (a + v + e) / 2 for a, v, e in zip(rate_off, second, rounding.rates, strict=True)
            ]
            sizes = [a.max(v.abs_upper()) for a, v in zip(sizes, self._rates(held), strict=True)]
        found = [
            (e + 8 * u * (size + e) + 2 * u * u * (v + last * size) / arb(self.found.shortest))
            for e, size, v in zip(off, sizes, xi, strict=True)
        ]
        inside = all(
            a <= lo and hi <= b for (a, b), (lo, hi) in zip(rounding.box, held, strict=True)
        )
        if not inside or not all(v.is_finite() for v in (*own, *found)):
            return None
        return own, [(v * arb("1.000001")).upper() for v in found]

    def slopes(self, box: Box) -> list[list[arb]]:
        """Derivatives of (u, ξ̇) in (x, ξ) over a box."""
        model, energy, size = self.model, self.step.energy, len(box)
        values, (_, slope, curved) = [ball(*side) for side in box], energy.hc(box[model.n :])
        E = arb_mat(_table(self._law(values), size + model.nc))
        inner = [
            [arb(0)] * model.n + [curved[min(i, j), max(i, j)] for j in range(model.nc)]
            for i in range(model.nc)
        ]
        total = E * arb_mat([*energy.entries(box).tolist(), *inner])
        both = _column([*energy.gradient(box), *slope])
        for j, tape in self._law_slopes.items():
            moved = arb_mat(_table(tape(values), size + model.nc)) * both
            for i in range(total.nrows()):
                total[i, j] = total[i, j] + moved[i, 0]
        rows: list[list[arb]] = total.tolist()
        return rows

    def _rates(self, box: Box) -> list[arb]:
        """ξ̇ of the law over a box."""
        return self.step.rates(box, self.step.energy.gradient(box))[self.model.n :]


def cut(box: Box, pieces: int) -> Iterator[Box]:
    """At most so many pieces that together are a box, each side in as many parts."""
    parts = max(1, int(pieces ** (1 / len(box))))
    sides = [
        list(pairwise([lo + (hi - lo) * (k / parts) for k in range(parts)] + [hi]))
        for lo, hi in box
    ]
    return product(*sides)


def _upper(A: Linear, v: arb_mat) -> arb_mat:
    return A.magnitude() * v


def _absolute(A: arb_mat) -> arb_mat:
    return arb_mat([[v.abs_upper() for v in row] for row in A.tolist()])


def _column(values: Sequence[arb]) -> arb_mat:
    return arb_mat([[v] for v in values])


def _square(column: arb_mat) -> arb:
    return sum((v * v for (v,) in column.tolist()), arb(0)).upper()


def _identity(size: int) -> arb_mat:
    return arb_mat([[int(i == j) for j in range(size)] for i in range(size)])


def _rows_of(size: int, more: int, at: int) -> Linear:
    """What puts a vector of a size into one with more entries, from a place on."""
    rows = [[int(i == j + at) for j in range(size)] for i in range(size + more)]
    return Linear(arb_mat(rows), {})


def _table(values: Sequence[arb], columns: int) -> list[list[arb]]:
    return [list(values[k : k + columns]) for k in range(0, len(values), columns)]
