"""A trained V and its damping, improved on responses: Gauss and Newton's method on their cost.

    min  (1/N) Σ (Jₛ/Jₛ*)² + shape + proximity,   ∇V(z*) = 0,   ∇²V(z*) ≻ aI

over θ (rollouts.py): Jₛ what the response from start s costs with inputs clipped, Jₛ* the least
that any controller pays there. The square makes the worst starts count most. The shape is the
log-det divergence of ∇²V(z*) − aI from where it began, a barrier at the same time. ∇V(z*) is affine
in θ, and steps are in the kernel of its slope: it stays 0 throughout. Where the fastest mode would
take too many steps to follow the slowest one, quadratic parts, T and the damping move alone.

Steps that raise the objective, or make the loop too fast for the grid of the responses, are tried
again shorter (Levenberg and Marquardt). A certificate says afterwards what is proved.

References
----------
Nocedal and Wright (2006), Numerical Optimization, section 10.3.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import casadi as ca
import numpy as np

from necc_casadi.arrays import Vector
from necc_casadi.designs.outcome import Start
from necc_casadi.lyapunov.limits import scales_damping
from necc_casadi.lyapunov.opened_loop import plant_dynamics
from necc_casadi.model.domain import domain_of
from necc_casadi.model.samples import quasi_random
from necc_casadi.performance.optimum import Optimum
from necc_casadi.performance.plant_model import PlantModel
from necc_casadi.performance.starts import settled_in
from necc_casadi.synthesis.quadratic_cost import (
    Begin,
    Responsive,
    coupled_damping,
    damping_bounds,
)
from necc_casadi.synthesis.responsive import LeastCost, is_plain
from necc_casadi.synthesis.rollouts import Moving, Rollouts

__all__ = ["polished"]


#: Starts, and the seed of where they lie: fewer are learned by heart.
_STARTS, _SEED = 32, 7


#: Power of the ratios.
_POWER = 2


#: Steps, and tries of each.
_STEPS, _TRIES = 12, 6


#: By how much a step is damped at first; factors after one that succeeds, and one that fails.
_TRUST, _BOLDER, _SHORTER = 1e-2, 0.2, 6.0


#: Damping of the steps at least.
_LEAST_TRUST = 1e-6


#: A step that lowers the objective by less than this share is the last.
_GAIN = 1e-3


#: Of the step of a response times the fastest mode: at the start, and at most.
_FINE, _COARSE = 0.5, 1.5


#: Points of a response at most; of more, up to so many, where networks stay as they are.
_MOST_POINTS, _MOST_WITHOUT_NETWORKS = 600, 800


#: Of the time in which the slowest mode settles, after which LQR's cost is taken.
_SHARE = 0.5


#: Weight of the shape, of staying near the networks at the start, and of the damping there.
_SHAPE, _PROXIMITY, _DAMPING = 1e-3, 1e-3, 1e-3


#: Singular values of ∂∇V(z*)/∂θ below this share of the largest are rounding.
_RANK = 1e-10


@dataclass(frozen=True, eq=False)
class _At:
    """The objective at one θ."""

    theta: Vector
    value: float
    ratios: Vector  # Jₛ/Jₛ*


def polished(program: LeastCost, found: Responsive | None) -> Responsive | None:
    """V and 𝒟 of less cost on responses; None where none was found, or none can be followed.

    Parameters
    ----------
    program
        With the plan, the trained V and its damping.
    found
        Where to begin; None: at what training ended with.
    """
    began = time.perf_counter()
    if not is_plain(program.plan, program.options):
        return None
    begin = program.begin(found)
    search = _Search(program, begin)
    if search.is_long:
        search = _Search(program, begin, networks=False)
    if not search.may_follow:
        return None
    first = search.first()
    path, trust = [first], _TRUST
    while len(path) <= _STEPS:
        better, trust = search.step(path[-1], trust)
        if better is None:
            break
        path.append(better)
        if path[-2].value - better.value < _GAIN * better.value:
            break
    if len(path) == 1:
        return None
    return search.made(first, path[-1], len(path) - 1, time.perf_counter() - began)


class _Search:
    """Steps from one V and damping."""

    def __init__(self, program: LeastCost, begin: Begin, networks: bool = True) -> None:
        self.program, plan, self.networks = program, program.plan, networks
        kappa_min = plan.anchor.kappa_min
        self.moving = Moving(
            program.lifting, kappa_min, begin.weights, begin.xi_star, program.damping, networks
        )
        self.z_star = np.concatenate([plan.x, begin.xi_star])
        self.theta = self.moving.first(begin.eta, begin.gain)
        self.stays = self._stays()
        theta = ca.MX.sym("theta", self.moving.size)
        g, N = self.moving.shape(theta)
        gap = N - ca.DM(plan.asked)
        self.gap = ca.Function("gap", [theta], [ca.densify(gap)])
        slopes = [ca.densify(ca.jacobian(v, theta)) for v in (g, ca.vec(gap))]
        self.slopes = ca.Function("slopes", [theta], slopes)
        self.kernel = self._kernel()
        self.gap_at_start = np.asarray(self.gap(self.theta), float)
        self.is_long = False  # too long for networks to move
        self.rollouts, self.may_follow = self._rollouts()
        self.best = self._least_costs() if self.may_follow else np.ones(0)

    def _stays(self) -> Vector:
        """What a change of each variable costs."""
        moving, held = self.moving, self.program.options.hold
        kappas, eta = 2 * len(moving.kappa), moving.eta.numel()
        size = self.program.lifting.form.size
        return np.concatenate(
            [
                np.full(len(moving.affine), _PROXIMITY * held / size),
                np.full(kappas, _PROXIMITY),
                np.full(int(np.prod(moving.gain_shape)), _PROXIMITY),
                np.full(eta, _DAMPING),
            ]
        )

    def _kernel(self) -> Vector:
        """Directions that leave ∇V(z*) as it is, and damping that was given, (p, free)."""
        options, size = self.program.options, self.program.plan.natural
        slope = np.asarray(self.slopes.call([self.theta])[0], float)
        slope *= size.state[:, None] / size.energy
        if options.D is not None or options.Dc is not None:
            slope = np.vstack([slope, np.eye(self.theta.size)[self.moving.eta_at]])
        _, values, rows = np.linalg.svd(slope)
        rank = int((values > _RANK * values[0]).sum()) if values.size else 0
        return np.asarray(rows[rank:].T, float)

    def _plant(self) -> PlantModel:
        program, plan = self.program, self.program.plan
        n, terms = plan.terms.n, plan.terms
        limits = plan.loop.plant.u_limits or ((-np.inf, np.inf),) * terms.m
        low, high = np.array(limits, float).T
        return PlantModel(
            dynamics=plant_dynamics(terms),
            x_star=plan.x,
            u_star=program.holding,
            cost=program.options.cost(plan.sizes, n).measured_in(plan.units),
            size=plan.natural.state[:n],
            u_size=plan.natural.input,
            u_low=low,
            u_high=high,
            A=program.A,
            B=program.B,
        )

    def _rollouts(self) -> tuple[Rollouts, bool]:
        """Responses from even starts, and whether a grid is fine enough for them."""
        plan, plant = self.program.plan, self._plant()
        box, n = domain_of(plan.loop, self.z_star, plan.natural.state), plan.terms.n
        starts = box.lo[:n] + quasi_random(_STARTS, n, _SEED) * (box.hi - box.lo)[:n]
        given = self.program.options.D is not None or self.program.options.Dc is not None
        scales = not given or scales_damping(plan.loop.plant, self.moving.trained)
        rollouts = Rollouts(self.moving, plant, starts, scales)
        spectrum = np.linalg.eigvals(rollouts.slope(self.theta)).astype(complex)
        fastest = float(np.abs(spectrum).max())
        if plant.linear is None or not spectrum.real.max() < 0:
            return rollouts, False
        horizon, most = _SHARE * settled_in(spectrum), _MOST_POINTS
        if horizon * fastest / _FINE > most:
            if self.networks:
                self.is_long = True
                return rollouts, False
            # LQR's cost, taken for the rest, then stands for a slow mode that is left
            of_lqr = np.linalg.eigvals(plant.A - plant.B @ plant.linear.K).astype(complex)
            most = _MOST_WITHOUT_NETWORKS
            followed = max(most * _FINE / fastest, _SHARE * settled_in(of_lqr))
            horizon = min(horizon, followed)
        points = min(int(np.ceil(horizon * fastest / _FINE)), most)
        rollouts = rollouts.over(horizon, points)
        finite = np.isfinite(rollouts.costs(self.theta))
        fine = bool(rollouts.step * fastest <= _COARSE / 2 and finite.any())
        return rollouts.of(starts[finite]) if fine else rollouts, fine

    def _least_costs(self) -> Vector:
        """What the cheapest response found costs from each start, (N,)."""
        rollouts = self.rollouts
        problem = Optimum(rollouts.plant, rollouts.step * rollouts.steps)
        own = rollouts.costs(self.theta)
        optimal = np.array([problem.cost(start) for start in rollouts.starts])
        return np.asarray(np.fmin(own, optimal), float)

    def first(self) -> _At:
        """Where the steps begin, ξ(0) at ξ* or along with x(0), whichever costs less."""
        at_target = self.theta.copy()
        at_target[self.moving.gain_at] = 0.0
        along, plain = self.at(self.theta), self.at(at_target)
        if plain.value <= along.value:
            self.theta = at_target
            return self.at(at_target)
        return along

    def at(self, theta: Vector) -> _At:
        """The objective; ∞ where V has too little curvature, or the loop is too fast."""
        rollouts, gap = self.rollouts, np.asarray(self.gap(theta), float)
        if np.linalg.eigvalsh(gap)[0] <= 0:
            return _At(theta, np.inf, np.zeros(0))
        if rollouts.step * np.abs(np.linalg.eigvals(rollouts.slope(theta))).max() > _COARSE:
            return _At(theta, np.inf, np.zeros(0))
        ratios = rollouts.costs(theta) / self.best
        relative = np.linalg.solve(self.gap_at_start, gap)
        shape = np.trace(relative) - np.linalg.slogdet(relative)[1] - len(gap)
        moved = self.stays @ (theta - self.theta) ** 2 / 2
        value = float(np.mean(ratios**_POWER) + _SHAPE * shape + moved)
        return _At(theta, value if np.isfinite(value) else np.inf, ratios)

    def _model(self, now: _At) -> tuple[Vector, Vector]:
        """Gradient (p,) and curvature (p, p) of the objective."""
        weights = _POWER * now.ratios ** (_POWER - 1) / self.best / len(self.best)
        sums = self.rollouts.sums(now.theta, weights)
        gap = np.asarray(self.gap(now.theta), float)
        rows = np.asarray(self.slopes.call([now.theta])[1], float)
        size, p = len(gap), now.theta.size
        inverse = np.linalg.inv(gap)
        rise = (np.linalg.inv(self.gap_at_start) - inverse).ravel() @ rows
        scaled = (inverse @ rows.reshape(size, size, p).transpose(2, 0, 1)).reshape(p, -1)
        turned = scaled.reshape(p, size, size).transpose(0, 2, 1).reshape(p, -1)
        gradient = sums.gradient + _SHAPE * rise + self.stays * (now.theta - self.theta)
        curvature = sums.curvature + _SHAPE * scaled @ turned.T + np.diag(self.stays)
        return gradient, curvature

    def step(self, now: _At, trust: float) -> tuple[_At | None, float]:
        """The next θ, and how much the next step is damped at first."""
        gradient, curvature = self._model(now)
        Z = self.kernel
        g, H = Z.T @ gradient, Z.T @ curvature @ Z
        for _ in range(_TRIES):
            damped = H + trust * np.diag(np.diag(H))
            theta = self._within(now.theta - Z @ np.linalg.solve(damped, g))
            found = self.at(theta)
            if found.value < now.value:
                return found, max(_BOLDER * trust, _LEAST_TRUST)
            trust *= _SHORTER
        return None, trust

    def _within(self, theta: Vector) -> Vector:
        """Θ with η in its bounds."""
        low, high = damping_bounds(len(self.program.damping))
        theta = theta.copy()
        theta[self.moving.eta_at] = np.clip(theta[self.moving.eta_at], low, high)
        return theta

    def made(self, first: _At, last: _At, steps: int, seconds: float) -> Responsive:
        """What was found, as a solution."""
        moving, plan = self.moving, self.program.plan
        weights = moving.weights_at(last.theta)
        eta = last.theta[moving.eta_at]
        start = Start(
            seed=self.program.solution.starts[-1].seed,
            mode="polished",
            status="Solve_Succeeded" if steps < _STEPS else "Maximum_Iterations_Exceeded",
            iterations=steps,
            seconds=seconds,
            objective=last.value,
            loss=self.program.lifting.loss(weights, moving.xi_star, plan.asked),
        )
        return Responsive(
            weights=weights,
            xi_star=moving.xi_star,
            damping=coupled_damping(self.program.damping, eta),
            eta=eta,
            start=start,
            before=float(first.ratios.mean()),
            after=float(last.ratios.mean()),
            at_the_bound=False,
            gain=moving.gain(last.theta),
        )
