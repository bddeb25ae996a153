"""From a trained V to one of least quadratic cost, where the form of V allows it."""

from __future__ import annotations

import numpy as np

from necc_casadi.arrays import Vector
from necc_casadi.lyapunov.opened_loop import plant_linearisation
from necc_casadi.model.cost import QuadraticCost, bryson
from necc_casadi.model.domain import domain_of
from necc_casadi.performance.lqr import Lqr, lqr
from necc_casadi.synthesis.lifting import Lifting
from necc_casadi.synthesis.options import Options
from necc_casadi.synthesis.plan import Plan
from necc_casadi.synthesis.programs import hard_program
from necc_casadi.synthesis.quadratic_cost import LinearQuadratic, Responsive, least_cost
from necc_casadi.synthesis.training import SOLVED, Solution

__all__ = ["responsive"]


def responsive(
    plan: Plan, options: Options, solution: Solution, damping: Vector
) -> Responsive | None:
    """V and 𝒟 of least cost, in training units; None where the trained ones are kept.

    They are kept where V has another form than Φ = H + Hc + C, C = K(c), where LQR does not
    stabilise the plant, where training or the program fell short, and where nothing was gained.
    """
    plain = plan.form.phi is None and not plan.form.betas and not options.learn_casimir
    if not plain or not solution.solved:
        return None
    lifting = Lifting(plan.terms, plan.form, plan.x, plan.scales, plan.anchor.xi)
    program = hard_program(lifting, plan.curvature, plan.anchor.stiffness)
    aim = _aim(plan, options, solution.xi_star)
    if program is None or aim is None:
        return None
    found = least_cost(
        lifting,
        program,
        aim,
        plan.curvature,
        plan.anchor.kappa_min,
        solution.weights,
        solution.xi_star,
        damping,
        solution.starts[-1].seed,
        options.verbose,
    )
    if found is None or found.start.loss > SOLVED or found.after >= found.before:
        return None
    return found


def _aim(plan: Plan, options: Options, xi_star: Vector) -> LinearQuadratic | None:
    """The cost and what LQR makes of it, in training units."""
    n = plan.terms.n
    default = bryson(plan.sizes, n)
    cost = QuadraticCost(
        default.Q if options.state_cost is None else options.state_cost,
        default.R if options.input_cost is None else options.input_cost,
    ).measured_in(plan.units)
    linear = _lqr(plan, cost)
    if linear is None:
        return None
    z = np.concatenate([plan.x, xi_star])
    box = domain_of(plan.loop, z, plan.natural.state)
    starts = np.diag((box.hi - box.lo)[:n] ** 2 / 12)  # uniform in the domain
    return LinearQuadratic(
        Q=cost.Q,
        R=cost.R,
        starts=starts,
        lqr_cost=float(np.trace(linear.P @ starts)),
        fastest=float(np.abs(linear.spectrum).max()),
    )


def _lqr(plan: Plan, cost: QuadraticCost) -> Lqr | None:
    terms, x = plan.terms, plan.x
    drift = np.asarray(terms.F(x) @ terms.grad_H(x), float).ravel()
    holding = np.linalg.lstsq(np.asarray(terms.G(x), float), -drift, rcond=None)[0]
    A, B = plant_linearisation(terms, x, holding)
    return lqr(A, B, cost)
