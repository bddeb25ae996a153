"""From a trained V to one of least quadratic cost, at a rate, where the form of V allows it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from necc_casadi.arrays import Vector
from necc_casadi.lyapunov.opened_loop import plant_linearisation
from necc_casadi.model.cost import QuadraticCost, bryson
from necc_casadi.model.domain import domain_of
from necc_casadi.performance.lqr import lqr
from necc_casadi.synthesis.lifting import Lifting
from necc_casadi.synthesis.options import Options
from necc_casadi.synthesis.plan import Plan
from necc_casadi.synthesis.programs import Program, hard_program
from necc_casadi.synthesis.quadratic_cost import LinearQuadratic, Responsive, least_cost
from necc_casadi.synthesis.training import SOLVED, Solution

__all__ = ["LeastCost", "Reached", "asked_cost", "is_plain"]


#: Solves on the way to a rate; factor to the next rate at first; below it the way has ended.
_MOST_SOLVES, _PACE, _NO_PACE = 12, 2.0, 1.03


#: The Lyapunov equation of where a solve begins is shifted by this share of its slowest mode.
_WITHIN = 0.9


#: Share of the rate of a mode that no input moves which the others are asked for.
_AS_FAST = 0.98


#: A matrix whose least singular value is below this share of the plant has lost rank.
_RANK = 1e-9


def is_plain(plan: Plan, options: Options) -> bool:
    """Whether V has the form Φ = H + Hc + C, C = K(c) of the least-cost program."""
    return plan.form.phi is None and not plan.form.betas and not options.learn_casimir


def asked_cost(plan: Plan, options: Options) -> QuadraticCost:
    """The weights of the model file, else Bryson's, in the units of the model."""
    default = bryson(plan.sizes, plan.terms.n)
    return QuadraticCost(
        default.Q if options.state_cost is None else options.state_cost,
        default.R if options.input_cost is None else options.input_cost,
    )


@dataclass(frozen=True, eq=False)
class Reached:
    """The fastest loop on the way to a rate; rates in training units."""

    found: Responsive | None  # None: the trained V and damping are kept
    at_the_bound: bool = False  # of ‖A‖, where the way ended
    unmoved: complex | None = None  # a mode of the plant that no input moves and that is too slow


class LeastCost:
    """Solutions of the least-cost program from one trained V, for any rate and price of inputs."""

    def __init__(
        self, plan: Plan, options: Options, solution: Solution, damping: Vector
    ) -> None:
        self.plan, self.options, self.solution, self.damping = plan, options, solution, damping
        terms = plan.terms
        self.lifting = Lifting(terms, plan.form, plan.x, plan.scales, plan.anchor.xi)
        self.program: Program | None = None
        if is_plain(plan, options) and solution.solved:
            self.program = hard_program(self.lifting, plan.curvature, plan.anchor.stiffness)
        drift = np.asarray(terms.F(plan.x) @ terms.grad_H(plan.x), float).ravel()
        port = np.asarray(terms.G(plan.x), float)
        holding = np.linalg.lstsq(port, -drift, rcond=None)[0]
        self.A, self.B = plant_linearisation(terms, plan.x, holding)

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
        first = self._solved(0.0, price, None)
        if first is not None and first.after >= first.before and rate == 0:
            first = None
        if rate == 0 or self._rate(first) >= rate:
            return Reached(first)
        return self._on_the_way(rate, price, first)

    def _on_the_way(self, rate: float, price: float, best: Responsive | None) -> Reached:
        """Continuation in the rate: as far at once as the last solution allows."""
        pace, bound = _PACE, False
        for _ in range(_MOST_SOLVES):
            reached = self._rate(best)
            if reached >= rate or pace < _NO_PACE or reached <= 0:
                break
            found = self._solved(min(rate, pace * reached), price, best)
            if found is None or self._rate(found) <= reached:
                pace = 1 + (pace - 1) / 2
                continue
            best, bound = found, found.at_the_bound
        return Reached(best, bound)

    def _solved(self, rate: float, price: float, start: Responsive | None) -> Responsive | None:
        """One solve, from the trained V or an earlier solution; None where it falls short."""
        aim = self._aim(rate, price)
        if aim is None or self.program is None:
            return None
        found = least_cost(
            self.lifting,
            self.program,
            aim,
            self.plan.curvature,
            self.plan.anchor.kappa_min,
            self.solution.weights,
            self.solution.xi_star,
            self.damping,
            self.solution.starts[-1].seed,
            self.options.verbose,
            begin=start,
            reached=min(rate, _WITHIN * max(0.0, self._rate(start))),
        )
        return None if found is None or found.start.loss > SOLVED else found

    def _state(self, found: Responsive | None) -> tuple[Vector, Vector, Vector]:
        if found is None:
            return self.solution.weights, self.solution.xi_star, self.damping
        return found.weights, found.xi_star, found.damping

    def _rate(self, found: Responsive | None) -> float:
        """Of the slowest mode at z*, in training units."""
        weights, xi_star, damping = self._state(found)
        small = self.lifting.jets_at(weights, xi_star)
        _, N = self.lifting.at(small)
        terms, z = self.plan.terms, np.concatenate([self.plan.x, xi_star])
        n, m = terms.n, terms.m
        ports = np.zeros((len(z), 2 * m))
        ports[:n, :m], ports[n:, m:] = terms.G(z[:n]), terms.Gc(z[n:])
        M = np.asarray(terms.M(z), float)
        return float(-np.linalg.eigvals((M - ports @ damping @ ports.T) @ N).real.max())

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

    def _aim(self, rate: float, price: float) -> LinearQuadratic | None:
        """The cost and what LQR makes of it, in training units."""
        plan, n = self.plan, self.plan.terms.n
        asked = asked_cost(plan, self.options)
        cost = QuadraticCost(asked.Q, price * asked.R).measured_in(plan.units)
        linear = lqr(self.A + rate * np.eye(n), self.B, cost)
        if linear is None:
            return None
        z = np.concatenate([plan.x, self.solution.xi_star])
        box = domain_of(plan.loop, z, plan.natural.state)
        starts = np.diag((box.hi - box.lo)[:n] ** 2 / 12)  # uniform in the domain
        return LinearQuadratic(
            Q=cost.Q,
            R=cost.R,
            starts=starts,
            lqr_cost=float(np.trace(linear.P @ starts)),
            fastest=float(np.abs(linear.spectrum - rate).max()),
            rate=rate,
        )
