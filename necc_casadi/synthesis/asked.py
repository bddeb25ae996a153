"""What is asked of a response, and how far a design meets it: its slowest mode and its peak input.

The rate is a constraint of the least-cost program (quadratic_cost.py). A peak is not: it is
measured on simulated responses, and the weight of the inputs raised until they keep it. Where no
weight does, the rate is lowered. What is not met is told with what stopped it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from necc_casadi.arrays import Vector
from necc_casadi.cases import Stop
from necc_casadi.designs.design import Design
from necc_casadi.simulation.responses import random_states, response_from
from necc_casadi.synthesis.options import Options
from necc_casadi.synthesis.quadratic_cost import Responsive
from necc_casadi.synthesis.responsive import LeastCost, Reached

__all__ = ["Answer", "Asked", "answer", "limits_of"]


#: Factors of the inputs' weight that are tried for a peak, all of them and on the way to a rate.
_PRICES, _FEW_PRICES = (2.0, 4.0, 8.0, 16.0, 64.0, 256.0), (1.0,)


#: Rates that are tried where a peak does not allow the one that was asked for.
_RATES = 4


#: Responses that a peak is measured on, as a run shows them, and points of each.
_STARTS, _POINTS = 10, 301


#: Digits that are lost where a rate is computed again.
_ROUNDING = 1e-6


@dataclass(frozen=True, eq=False)
class Asked:
    """What was asked, what was reached, and what stopped it; in the units of the model."""

    rate: float | None  # 1/s
    rate_reached: float  # of the slowest mode at z̄
    limits: Vector | None  # (m, 2) of the inputs
    peaks: Vector | None  # (m, 2) least and greatest that the law asks for, from random starts
    stopped_by: Stop | None  # None: everything is met
    held: Vector  # (m,) what holds the target
    mode: complex | None = None  # 1/s, of the plant, that stops it
    unlimited: float | None = None  # 1/s, rate that was reached without the peak

    @property
    def held_outside(self) -> bool:
        """Whether no controller keeps the limits: holding the target takes more."""
        return self.limits is not None and not _inside(self.held, self.limits)

    @property
    def met(self) -> bool:
        """Whether the design does what was asked."""
        return self.stopped_by is None


@dataclass(frozen=True, eq=False)
class Answer:
    """A design, and how far it does what was asked; None: nothing was."""

    design: Design
    asked: Asked | None


@dataclass(frozen=True, eq=False)
class _Try:
    """One design with what it does."""

    design: Design
    reached: Reached
    rate: float  # 1/s
    peaks: Vector | None
    overuse: float  # of the room for the inputs; at most 1 where the peaks are kept


def limits_of(options: Options, design: Design) -> Vector | None:
    """The peak that was asked for, else the limits of the model where a rate was, (m, 2)."""
    if options.peak_u is not None:
        return np.column_stack([-options.peak_u, options.peak_u])
    limits = design.loop.plant.u_limits
    return None if options.rate is None or limits is None else np.array(limits, float)


def answer(
    program: LeastCost, options: Options, finish: Callable[[Responsive | None], Design]
) -> Answer:
    """The design of least cost that does what was asked, or the nearest to it that was found.

    Parameters
    ----------
    program
        The least-cost program at the trained V.
    options
        With the rate and the peak.
    finish
        From a solution to a design; None: from the trained V.
    """
    if options.rate is None and options.peak_u is None:
        return Answer(finish(program.at(0.0).found), None)
    search = _Search(program, options, finish)
    best = search.first
    if search.unlimited.overuse > 1:
        best = search.within_the_peak()
    return Answer(best.design, search.told(best))


class _Search:
    """Tries of one request."""

    def __init__(
        self, program: LeastCost, options: Options, finish: Callable[[Responsive | None], Design]
    ) -> None:
        self.program, self.options, self.finish = program, options, finish
        self.time = program.plan.units.time
        self.rate = options.rate or 0.0
        self.first = self.unlimited = self.tried(self.rate, 1.0)

    def tried(self, rate: float, price: float) -> _Try:
        """The design at a rate, 1/s, and a factor of the inputs' weight."""
        reached = self.program.at(rate * self.time, price)
        design = self.finish(reached.found)
        limits = limits_of(self.options, design)
        peaks = None if limits is None else demanded(design)
        return _Try(
            design=design,
            reached=reached,
            rate=0.0 - design.abscissa,
            peaks=peaks,
            overuse=0.0 if limits is None or peaks is None else _overuse(design, peaks, limits),
        )

    def does(self, tried: _Try, rate: float) -> bool:
        """Whether it keeps the peak at a rate."""
        return tried.overuse <= 1 and tried.rate >= rate * (1 - _ROUNDING)

    def within_the_peak(self) -> _Try:
        """The least price that keeps the peak; else the fastest rate at which one does."""
        if np.isinf(self.first.overuse):  # holding the target takes more
            return self.first
        wanted = min(self.rate, self.first.rate)
        tries: list[_Try] = []
        best = self._cheapest(wanted, _PRICES, tries)
        if best is not None or not self.rate:
            return best or min([self.first, *tries], key=lambda t: t.overuse)
        slow, fast = 0.0, wanted
        best = self._cheapest(0.0, _FEW_PRICES, tries)
        if best is None:
            return min([self.first, *tries], key=lambda t: t.overuse)
        for _ in range(_RATES):
            middle = (slow + fast) / 2
            if middle <= best.rate:
                slow = middle
                continue
            found = self._cheapest(middle, _FEW_PRICES, tries)
            slow, fast = (slow, middle) if found is None else (middle, fast)
            best = found or best
        return best

    def _cheapest(self, rate: float, prices: Iterable[float], tries: list[_Try]) -> _Try | None:
        for price in prices:
            tried = self.tried(rate, price)
            tries.append(tried)
            if self.does(tried, rate):
                return tried
        return None

    def told(self, best: _Try) -> Asked:
        """What was reached and why no more."""
        rate = self.options.rate
        mode = best.reached.unmoved
        return Asked(
            rate=rate,
            rate_reached=best.rate,
            limits=limits_of(self.options, best.design),
            peaks=best.peaks,
            stopped_by=self._stop(best),
            held=_holding(best.design),
            mode=None if mode is None else mode / self.time,
            unlimited=self.unlimited.rate if self.unlimited.overuse > 1 and rate else None,
        )

    def _stop(self, best: _Try) -> Stop | None:
        if self.does(best, self.rate):
            return None
        if best.reached.unmoved is not None:
            return "unmoved_mode"
        if best.overuse > 1 or self.unlimited.rate >= self.rate * (1 - _ROUNDING):
            return "input_peak"
        return "norm_bound" if best.reached.at_the_bound else "structure"


def demanded(design: Design) -> Vector:
    """Least and greatest u that the law asks for from random starts, (m, 2)."""
    found = [
        response_from(design, x0, points=_POINTS)
        for x0 in random_states(design, _STARTS, design.seed)
    ]
    demands = [r.u if r.demand is None else r.demand for r in found]
    low, high = (
        np.array([pick(d, axis=0) for d in demands]) for pick in (np.fmin.reduce, np.fmax.reduce)
    )
    return np.column_stack([low.min(axis=0), high.max(axis=0)])


def _holding(design: Design) -> Vector:
    n = design.loop.plant.n
    return design.lyapunov.control_law(design.z_bar[:n], design.z_bar[n:])[0]


def _inside(u: Vector, limits: Vector) -> bool:
    return bool(np.all(limits[:, 0] <= u) and np.all(u <= limits[:, 1]))


def _overuse(design: Design, peaks: Vector, limits: Vector) -> float:
    """Largest share of the room between what holds the target and a limit; ∞ without room."""
    held = _holding(design)
    room, taken = np.abs(limits - held[:, None]), np.abs(peaks - held[:, None])
    if not _inside(held, limits):
        return np.inf
    with np.errstate(divide="ignore", invalid="ignore"):
        shares = np.where(taken > 0, taken / room, 0.0)
    return float(np.max(shares, initial=0.0))
