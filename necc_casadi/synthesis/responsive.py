"""From a trained V to one of least quadratic cost, at a rate, where the form of V allows it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from necc_casadi.arrays import Vector
from necc_casadi.lyapunov.networks import Network
from necc_casadi.lyapunov.opened_loop import plant_linearisation
from necc_casadi.model.cost import QuadraticCost
from necc_casadi.model.domain import domain_of
from necc_casadi.model.lqr import lqr
from necc_casadi.synthesis.descent import descended
from necc_casadi.synthesis.lifting import Lifting
from necc_casadi.synthesis.options import Options
from necc_casadi.synthesis.plan import Plan
from necc_casadi.synthesis.programs import Program, hard_program
from necc_casadi.synthesis.quadratic_cost import (
    Begin,
    LinearQuadratic,
    Responsive,
    coupled_damping,
    least_cost,
)
from necc_casadi.synthesis.training import SOLVED, Solution

__all__ = ["LeastCost", "Reached", "is_plain"]


#: Solves on the way to a rate at most, and what counts as a step of it.
_MOST_SOLVES, _FASTER = 25, 1.02


#: Times that quadratic parts are made stiffer at most.
_MOST_STEPS = 4


#: Factors of the stiffness of each quadratic part, and of the damping of each port, that are tried.
_STIFFER, _DAMPED = 2.0 ** np.arange(9), 2.0 ** np.arange(-4, 5)


#: Shares of the rate by which the last solve is shifted, in order.
_LESS = (1.0, 0.6, 0.0)


#: A loop is to exceed a rate by this factor before its cost is lowered.
_ROOM = 1.15


#: On the way to a rate the loop may be as fast as LQR is at this multiple of the present one.
_AHEAD = 2.0


#: Shares of the rate of the slowest mode by which the next solve is shifted, in order.
_SHARES = (0.9, 0.7, 0.97)


#: Share of the rate of a mode that no input moves which the others are asked for.
_AS_FAST = 0.98


#: A matrix whose least singular value is below this share of the plant has lost rank.
_RANK = 1e-9


def is_plain(plan: Plan, options: Options) -> bool:
    """Whether V has the form Φ = H + Hc + C, C = K(c) of the least-cost program."""
    return plan.form.phi is None and not plan.form.betas and not options.learn_casimir


@dataclass(frozen=True, eq=False)
class Reached:
    """The fastest loop on the way to a rate; rates in training units."""

    found: Responsive | None  # None: the trained V and damping are kept
    at_the_bound: bool = False  # of ‖A‖, where the way ended
    unmoved: complex | None = None  # a mode of the plant that no input moves and that is too slow


class LeastCost:
    """Solutions of the least-cost program from one trained V, for any rate and price of inputs."""

    def __init__(self, plan: Plan, options: Options, solution: Solution, damping: Vector) -> None:
        self.plan, self.options, self.solution, self.damping = plan, options, solution, damping
        terms = plan.terms
        self.lifting = Lifting(terms, plan.form, plan.x, plan.scales, plan.anchor.xi)
        self.program: Program | None = None
        if is_plain(plan, options) and solution.solved:
            self.program = hard_program(self.lifting, plan.asked, plan.anchor.stiffness)
        drift = np.asarray(terms.drift(plan.x), float).ravel()
        port = np.asarray(terms.directions(plan.x), float)
        self.holding = np.linalg.lstsq(port, -drift, rcond=None)[0]  # (m,) u at the target
        self.A, self.B = plant_linearisation(terms, plan.x, self.holding)

    def at(self, rate: float, price: float = 1.0) -> Reached:
        """The loop of least cost whose modes exceed a rate, or the fastest on the way to it.

        Parameters
        ----------
        rate
            In training units; 0: none is asked for.
        price
            Factor of the inputs' weight.
        """
        unmoved = self._unmoved(rate) if rate > 0 else None
        if unmoved is not None:
            reachable = max(0.0, -unmoved.real)
            return replace(self.at(_AS_FAST * reachable, price), unmoved=unmoved)
        first = self._descended(price)
        now = self.begin(first)
        if rate == 0 or self._rate(now) >= rate:
            return Reached(first)
        return self._faster(rate, price, now)

    def begin(self, found: Responsive | None) -> Begin:
        """A solution, or what training ended with, as a place to begin at."""
        if found is not None:
            return Begin(found.weights, found.xi_star, found.eta, found.gain)
        size = len(self.damping)
        eta = np.zeros(size + size * (size - 1))
        return Begin(self.solution.weights, self.solution.xi_star, eta)

    def _faster(self, rate: float, price: float, now: Begin) -> Reached:
        """From a loop that is stiff enough for the rate, or the fastest such one, to less cost.

        A solve is shifted by less than the rate of where it begins, so that P exists there; it
        makes the next one faster.
        """
        begin = now
        for _ in range(_MOST_STEPS):
            slow, begin = self._rate(begin), self._stiffened(begin, rate)
            if not _FASTER * slow <= self._rate(begin) < rate:
                break
        found, bound, shares = None, False, list(_SHARES)
        for _ in range(_MOST_SOLVES):
            reached = self._rate(begin)
            if reached >= rate or not shares or reached <= 0:
                break
            solved = self._solved(shares[0] * reached, price, begin, min(rate, _AHEAD * reached))
            if solved is None or self._rate(self.begin(solved)) < _FASTER * reached:
                shares.pop(0)
                continue
            found, bound, shares = solved, solved.at_the_bound, list(_SHARES)
            begin = self.begin(solved)
        if self._rate(begin) >= rate:
            found, bound = self._cheaper(rate, price, begin) or found, False
        return Reached(self._as_it_is(begin) if found is None else found, bound)

    def _cheaper(self, rate: float, price: float, begin: Begin) -> Responsive | None:
        """Less cost at the rate; where that shift is too much for IPOPT, at less of it."""
        for share in _LESS:
            solved = self._solved(share * rate, price, begin, rate)
            if solved is not None and self._rate(self.begin(solved)) >= rate:
                return solved
        return None

    def _as_it_is(self, begin: Begin) -> Responsive:
        """Where a solve began, for want of a better loop."""
        weights, xi_star = begin.weights, begin.xi_star
        start = replace(
            self.solution.starts[-1],
            mode="cost",
            loss=self.lifting.loss(weights, xi_star, self.plan.asked),
        )
        damping = coupled_damping(self.damping, begin.eta)
        return Responsive(weights, xi_star, damping, begin.eta, start, np.inf, np.inf, False)

    def _stiffened(self, now: Begin, rate: float) -> Begin:
        """Stiffer quadratic parts and another damping: the least that exceeds the rate.

        The centres move so that the slopes at z*, and so ∇V(z*), stay as they are.
        """
        pairs = [(hc, k) for hc in _STIFFER for k in _STIFFER]
        factors = [(d, dc) for d in _DAMPED for dc in _DAMPED]
        best, most = now, (self._rate(now), 0.0)
        for hc, k in pairs:
            stiff = self._with_stiffness(now, hc, k)
            for (d, dc), reached in zip(factors, self._rates(stiff, factors), strict=True):
                effort = float(np.abs(np.log([hc, k, d, dc])).sum())
                worth = (min(reached, _ROOM * rate), -effort)
                if worth > most:
                    best, most = replace(stiff, eta=self._scaled_eta(now.eta, d, dc)), worth
        return best

    def _with_stiffness(self, now: Begin, hc: float, k: float) -> Begin:
        lifting, weights = self.lifting, now.weights.copy()
        bases = lifting.bases.call([lifting.jets_at(weights, now.xi_star)])
        parts = lifting.form.split(weights)
        for network, part, base, factor in zip(
            lifting.form.networks, parts, bases, (hc, k), strict=True
        ):
            if isinstance(network, Network) and network.quadratic:
                d, v = network.inputs, np.asarray(base, float).ravel()
                part[-d:] = v - (v - part[-d:]) / factor
                part[-2 * d : -d] *= factor
        return replace(now, weights=np.concatenate(parts))

    def _scaled_eta(self, eta: Vector, d: float, dc: float) -> Vector:
        """η of 𝒟 with its ports scaled: entries by √(d d), √(d dc) or √(dc dc)."""
        port = np.repeat([d, dc], self._ports)
        below = [(i, j) for i in range(len(port)) for j in range(i)]
        rows = np.sqrt([port[i] for i, _ in below])
        both = np.sqrt([port[i] * port[j] for i, j in below])
        return np.asarray(
            eta * np.concatenate([np.ones(len(port)), rows, both])
            + np.concatenate([np.log(port), np.zeros(2 * len(below))])
        )

    def _descended(self, price: float) -> Responsive | None:
        """Quadratic parts and damping of least cost beside the trained networks."""
        aim = self._aim(0.0, price, 0.0)
        if aim is None or self.program is None:
            return None
        found = descended(
            self.lifting,
            aim,
            self.plan.asked,
            self.plan.anchor.kappa_min,
            self.solution.weights,
            self.solution.xi_star,
            self.damping,
            self.solution.starts[-1].seed,
            moves_V=not self.options.damping_alone,
            bends=self.plan.bends,
        )
        return None if found is None or found.start.loss > SOLVED else found

    def _solved(self, rate: float, price: float, begin: Begin, wanted: float) -> Responsive | None:
        """One solve on the way to a rate; None: it fell short."""
        aim = self._aim(rate, price, wanted)
        if aim is None or self.program is None:
            return None
        found = least_cost(
            self.lifting,
            self.program,
            aim,
            self.plan.asked,
            self.plan.anchor.kappa_min,
            self.solution.weights,
            self.solution.xi_star,
            self.damping,
            self.solution.starts[-1].seed,
            begin,
            self.options.verbose,
        )
        return None if found is None or found.start.loss > SOLVED else found

    @property
    def _ports(self) -> tuple[int, int]:
        """Entries of v and of v_c."""
        return self.plan.terms.m, self.plan.terms.channels

    def _rate(self, at: Begin) -> float:
        """Of the slowest mode at z*, in training units."""
        return self._rates(at, [(1.0, 1.0)])[0]

    def _rates(self, at: Begin, factors: Sequence[tuple[float, float]]) -> list[float]:
        """The same for many dampings, whose ports are scaled by (d, dc)."""
        _, N = self.lifting.at(self.lifting.jets_at(at.weights, at.xi_star))
        terms, z = self.plan.terms, np.concatenate([self.plan.x, at.xi_star])
        ports = np.asarray(terms.ports(z), float)
        damping = coupled_damping(self.damping, at.eta)
        root = np.sqrt(np.repeat(np.array(factors), self._ports, axis=1))
        many = ports @ (damping * root[:, :, None] * root[:, None, :]) @ ports.T
        slowest = np.linalg.eigvals((np.asarray(terms.M(z), float) - many) @ N).real.max(axis=-1)
        return [float(-s) for s in slowest]

    def _unmoved(self, rate: float) -> complex | None:
        """The slowest mode of the plant that no input moves, where it is slower than the rate.

        Popov, Belevitch and Hautus: (A − sI, B) loses rank at such a mode s.
        """
        size = self.plan.natural.state[: self.plan.terms.n]
        A, B = self.A * size / size[:, None], self.B / size[:, None]
        scale = max(float(np.linalg.norm(A)), np.finfo(float).tiny)
        columns = np.linalg.norm(B, axis=0)
        B = B * scale / np.where(columns > 0, columns, 1.0)
        slow = [s for s in np.linalg.eigvals(A) if s.real >= -rate]
        lost = [
            complex(s)
            for s in slow
            if np.linalg.svd(np.hstack([A - s * np.eye(len(A)), B]), compute_uv=False)[-1]
            < _RANK * scale
        ]
        return max(lost, key=lambda s: s.real, default=None)

    def _aim(self, rate: float, price: float, wanted: float) -> LinearQuadratic | None:
        """The cost at a rate, and what LQR makes of it, in training units.

        The loop may be as fast as LQR's is at the rate that is wanted in the end.
        """
        plan, n = self.plan, self.plan.terms.n
        asked = self.options.cost(plan.sizes, n)
        cost = QuadraticCost(asked.Q, price * asked.R).measured_in(plan.units)
        linear = lqr(self.A + rate * np.eye(n), self.B, cost)
        final = lqr(self.A + wanted * np.eye(n), self.B, cost) or linear
        if linear is None or final is None:
            return None
        z = np.concatenate([plan.x, self.solution.xi_star])
        box = domain_of(plan.loop, z, plan.natural.state)
        starts = np.diag((box.hi - box.lo)[:n] ** 2 / 12)  # uniform in the domain
        return LinearQuadratic(
            Q=cost.Q,
            R=cost.R,
            starts=starts,
            lqr_cost=float(np.trace(linear.P @ starts)),
            fastest=float(np.abs(final.spectrum - wanted).max()),
            rate=rate,
        )
