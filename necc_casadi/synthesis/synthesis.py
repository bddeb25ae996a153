"""From a judged target to a finished Design: networks, training, damping."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cached_property

import numpy as np
import sympy as sp

from necc_casadi.arrays import Vector
from necc_casadi.casimirs.casimirs import Casimirs
from necc_casadi.designs.design import Design
from necc_casadi.designs.natural import damping_units, units_for, weight_units
from necc_casadi.designs.outcome import Start
from necc_casadi.lyapunov.damping import uncoupled
from necc_casadi.lyapunov.lyapunov import LyapunovFunction
from necc_casadi.model.closed_loop import ClosedLoop
from necc_casadi.model.family_loop import FamilyLoop
from necc_casadi.performance.initial_xi import with_better_start, with_start
from necc_casadi.synthesis.asked import Answer, answer
from necc_casadi.synthesis.damping import choose_damping
from necc_casadi.synthesis.learned_casimir import casimir_residual
from necc_casadi.synthesis.options import Options
from necc_casadi.synthesis.plan import Plan, make_plan
from necc_casadi.synthesis.polish import polished
from necc_casadi.synthesis.quadratic_cost import Responsive
from necc_casadi.synthesis.responsive import LeastCost
from necc_casadi.synthesis.training import Solution, train
from necc_casadi.verdict.verdict import Verdict

__all__ = ["answered", "design"]


def design(
    loop: ClosedLoop,
    casimirs: Casimirs,
    verdict: Verdict,
    x_star: Mapping[sp.Symbol, sp.Expr],
    options: Options | None = None,
    report: Callable[[Start], None] | None = None,
    family: FamilyLoop | None = None,
) -> Design:
    """Train V at x* and choose the damping.

    The design that is returned was written to text and read back, so that whatever is proved,
    simulated or exported is what is stored.

    Parameters
    ----------
    loop, casimirs, verdict
        Closed loop, its closed-form Casimirs and the verdict at x*.
    x_star
        Target, exact, plant symbols to values.
    options
        Form of the networks and what to ask of them.
    report
        Called with the outcome of each start of the solver.
    family
        The same loop for other plants and set-points, for which the design is to be good, too.

    Returns
    -------
    Design
        Of the best start, with what it reached: where the solver fell short, ε says so.

    Raises
    ------
    OptionError
        ``usage``, where a shape is asked of the form K(Σ βᵢ(cᵢ)).

    References
    ----------
    Xu, Zakwan and Ferrari-Trecate (2022); Wächter and Biegler (2006), IPOPT.

    Examples
    --------
    >>> from necc_casadi import design, find_casimirs, judge, load_model, parse_target
    >>> loop = load_model("pendulum.py").loop
    >>> x_star = parse_target(loop.plant, "pi/4")
    >>> casimirs = find_casimirs(loop)
    >>> made = design(loop, casimirs, judge(loop, casimirs, x_star), x_star)
    >>> float(max(abs(made.z_bar - made.z_star))) < 1e-9
    True
    """
    return answered(loop, casimirs, verdict, x_star, options, report, family).design


def answered(
    loop: ClosedLoop,
    casimirs: Casimirs,
    verdict: Verdict,
    x_star: Mapping[sp.Symbol, sp.Expr],
    options: Options | None = None,
    report: Callable[[Start], None] | None = None,
    family: FamilyLoop | None = None,
) -> Answer:
    """As :func:`design`, with how far the response is what was asked."""
    options = options or Options()
    plan = make_plan(loop, casimirs, verdict, x_star, options, family)
    solution = train(
        plan.terms,
        plan.form,
        plan.x,
        a=plan.asked,
        scales=plan.scales,
        anchor=plan.anchor,
        extra=plan.extra,
        seed=options.seed,
        starts=options.starts,
        report=report,
        verbose=options.verbose,
    )
    finish = _Finish(loop, verdict, x_star, options, plan, solution)
    if options.polish:
        found = Answer(finish(_polished(finish)), None)
    elif options.asks_for_cost:
        program = LeastCost(plan, options, solution, finish.damping)
        found = answer(program, options, finish)
    else:
        found = Answer(finish(None), None)
    return replace(found, design=_started(found, plan, options))


def _polished(finish: _Finish) -> Responsive | None:
    """What is found on responses, from the least cost where that is asked for."""
    options, solution = finish.options, finish.solution
    program = LeastCost(finish.plan, options, solution, finish.damping)
    least = program.at(0.0).found if options.asks_for_cost else None
    return polished(program, least) or least


def _started(found: Answer, plan: Plan, options: Options) -> Design:
    """The design with the better ξ(0), where that keeps the peak that was asked for."""
    made, cost = found.design, options.cost(plan.sizes, plan.terms.n)
    if options.initial_xi is not None:
        return with_start(made, cost, options.initial_xi)
    better = with_better_start(made, cost)
    changed = better.initial_xi != made.initial_xi
    return made if not changed or (found.asked and found.asked.limits is not None) else better


class _Finish:
    """From a trained V, or one of least cost, to a design in the units of the model."""

    def __init__(
        self,
        loop: ClosedLoop,
        verdict: Verdict,
        x_star: Mapping[sp.Symbol, sp.Expr],
        options: Options,
        plan: Plan,
        solution: Solution,
    ) -> None:
        self.loop, self.verdict, self.x_star = loop, verdict, x_star
        self.options, self.plan, self.solution = options, plan, solution

    @cached_property
    def damping(self) -> Vector:
        """𝒟 that the trained V is damped with, in training units."""
        plan, options, m = self.plan, self.options, self.plan.terms.m
        unit = damping_units(self.loop, plan.units)
        V = LyapunovFunction(plan.terms, plan.form, self.solution.weights, np.eye(len(unit)))
        given = (
            None if options.D is None else options.D / unit[:m, :m],
            None if options.Dc is None else options.Dc / unit[m:, m:],
        )
        z_star = np.concatenate([plan.x, self.solution.xi_star])
        return uncoupled(*choose_damping(V, plan.loop, z_star, *given, bends=plan.bends))

    def __call__(self, found: Responsive | None) -> Design:
        """The design as it is stored, with the seconds of its starts."""
        plan, options, solution = self.plan, self.options, self.solution
        weights, xi_star, damping = solution.weights, solution.xi_star, self.damping
        starts = solution.starts
        if found is not None:
            weights, xi_star, damping = found.weights, found.xi_star, found.damping
            starts = (*starts, found.start)
        stored = units_for(plan.sizes, plan.form)
        learned = None
        if options.learn_casimir:
            z_star = np.concatenate([plan.x, xi_star])
            learned = casimir_residual(
                plan.terms, plan.form, weights, plan.natural, z_star, options.seed
            )
        gain = self._gain(found)
        made = Design(
            initial_xi="target" if gain is None else "linear",
            initial_gain=gain,
            loop=self.loop,
            casimirs=plan.in_model,
            x_star=tuple(self.x_star[s] for s in self.loop.plant.x),
            verdict=self.verdict,
            form=plan.form,
            weights=weights * weight_units(plan.form, plan.units),
            xi_star=xi_star * plan.units.state[plan.terms.n :],
            damping=damping * damping_units(self.loop, plan.units),
            a=plan.a,
            a_requested=plan.a_requested,
            sizes=plan.sizes,
            units=stored,
            curvature=plan.curvature
            * (stored.state / plan.units.state) ** 2
            * (plan.units.energy / stored.energy),
            seed=options.seed,
            starts=starts,
            learned=learned,
        )
        return replace(Design.from_text(made.text), starts=starts)

    def _gain(self, found: Responsive | None) -> Vector | None:
        """T of ξ(0) where it was found on responses, in the units of the model, (nc, n)."""
        if found is None or found.gain is None or found.start.mode != "polished":
            return None
        state, n = self.plan.units.state, self.plan.terms.n
        return np.asarray(found.gain * state[n:, None] / state[:n], float)
