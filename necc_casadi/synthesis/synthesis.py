"""From a judged target to a finished Design: networks, training, damping."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
import sympy as sp

from necc_casadi.casimirs.casimirs import Casimirs
from necc_casadi.designs.design import Design
from necc_casadi.designs.natural import damping_units, units_for, weight_units
from necc_casadi.designs.outcome import Start
from necc_casadi.lyapunov.damping import uncoupled
from necc_casadi.lyapunov.lyapunov import LyapunovFunction
from necc_casadi.model.closed_loop import ClosedLoop
from necc_casadi.synthesis.damping import choose_damping
from necc_casadi.synthesis.learned_casimir import casimir_residual
from necc_casadi.synthesis.options import Options
from necc_casadi.synthesis.plan import make_plan
from necc_casadi.synthesis.responsive import responsive
from necc_casadi.synthesis.training import train
from necc_casadi.verdict.verdict import Verdict

__all__ = ["design"]


def design(
    loop: ClosedLoop,
    casimirs: Casimirs,
    verdict: Verdict,
    x_star: Mapping[sp.Symbol, sp.Expr],
    options: Options | None = None,
    report: Callable[[Start], None] | None = None,
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
    options = options or Options()
    plan = make_plan(loop, casimirs, verdict, x_star, options)
    terms, form = plan.terms, plan.form
    solution = train(
        terms,
        form,
        plan.x,
        a=plan.curvature,
        scales=plan.scales,
        anchor=plan.anchor,
        extra=plan.extra,
        seed=options.seed,
        starts=options.starts,
        report=report,
        verbose=options.verbose,
    )
    weights, z_star = solution.weights, np.concatenate([plan.x, solution.xi_star])
    m = terms.m
    V = LyapunovFunction(terms, form, weights, np.eye(2 * m))
    unit = damping_units(plan.units)
    given = (
        None if options.D is None else options.D / unit[:m, :m],
        None if options.Dc is None else options.Dc / unit[m:, m:],
    )
    damping = uncoupled(*choose_damping(V, plan.loop, z_star, *given))
    starts, xi_star = solution.starts, solution.xi_star
    if options.least_cost:
        found = responsive(plan, options, solution, damping)
        if found is not None:
            weights, xi_star, damping = found.weights, found.xi_star, found.damping
            starts = (*starts, found.start)
    stored = units_for(plan.sizes, form)
    learned = None
    if options.learn_casimir:
        learned = casimir_residual(terms, form, weights, plan.natural, z_star, options.seed)
    made = Design(
        loop=loop,
        casimirs=plan.in_model,
        x_star=tuple(x_star[s] for s in loop.plant.x),
        verdict=verdict,
        form=form,
        weights=weights * weight_units(form, plan.units),
        xi_star=xi_star * plan.units.state[terms.n :],
        damping=damping * unit,
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
    return replace(Design.from_text(made.text), starts=starts)  # with their seconds
