"""What will be trained, decided from the request and the verdict before any training."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import sympy as sp

from necc_casadi.arrays import Vector
from necc_casadi.casimirs.casimirs import Casimirs
from necc_casadi.casimirs.momenta import find_momenta
from necc_casadi.errors import OptionError
from necc_casadi.lyapunov.lyapunov import Terms, make_terms
from necc_casadi.lyapunov.networks import KAPPA_MIN
from necc_casadi.lyapunov.parameterization import Form
from necc_casadi.model.closed_loop import ClosedLoop
from necc_casadi.symbolic.expressions import is_finite
from necc_casadi.synthesis.convexity import least_kappa
from necc_casadi.synthesis.learned_casimir import casimir_penalty, state_inputs
from necc_casadi.synthesis.options import Options, check_options, default_a, form_of
from necc_casadi.synthesis.potential_free import (
    HELD_XI,
    POTENTIAL_FREE_STIFFNESS,
    best_coordinates,
    is_potential_free,
)
from necc_casadi.synthesis.sample_box import sample_box
from necc_casadi.synthesis.shaping import Shaping, make_shaping
from necc_casadi.synthesis.training import STIFFER, Anchor, Penalty
from necc_casadi.synthesis.units import Scales, natural_scales
from necc_casadi.verdict.verdict import Verdict

__all__ = ["Plan", "make_plan"]

#: Hidden layer of a learned Casimir: small enough for exact second derivatives.
_LEARNED_HIDDEN = (32,)
#: Share of the ceiling a_max that is asked for when the request lies beyond it.
_BELOW_CEILING = 0.9


@dataclass(frozen=True, eq=False)
class Plan:
    """The networks, the point they are trained at and what is asked of them."""

    loop: ClosedLoop
    casimirs: Casimirs  # those that V is made of: smooth at x*, or what stands in for them
    terms: Terms
    form: Form
    x: Vector  # (n,) x*
    natural: Scales
    scales: Scales  # of the training program
    a: float  # curvature asked of ∇²V(z*)
    a_requested: float
    anchor: Anchor
    extra: Penalty | Shaping | None

    @property
    def z(self) -> Vector:
        """(x*, ξ*) where training starts, (n + nc,)."""
        return np.concatenate([self.x, self.anchor.xi])


def make_plan(
    loop: ClosedLoop,
    found: Casimirs,
    verdict: Verdict,
    x_star: Mapping[sp.Symbol, sp.Expr],
    options: Options,
) -> Plan:
    """Decide form, scales, curvature and start of the training.

    Raises
    ------
    OptionError
        For options that do not go together, or a form that cannot be shaped.
    """
    check_options(options)
    casimirs, options = _inputs(loop, found, x_star, options)
    terms = make_terms(loop, casimirs)
    form = form_of(options, terms.nc, terms.r)
    x = np.array([float(sp.N(x_star[s], 20)) for s in loop.plant.x])
    guess = np.zeros(terms.nc)
    if verdict.xi_star is not None:
        guess = np.array([float(sp.N(v, 20)) for v in verdict.xi_star])
    plain = options.quadratic and form.phi is None and not form.betas
    potential_free = plain and is_potential_free(loop, casimirs)
    if potential_free:
        guess = best_coordinates(terms, x, guess, natural_scales(loop, casimirs, x, guess))
    natural = natural_scales(loop, casimirs, x, guess)
    scales = natural if options.natural_units else Scales(np.ones(len(loop.z)), 1.0)
    requested = options.a if options.a is not None else default_a(natural, verdict)
    a = requested
    if verdict.a_max is not None and requested >= verdict.a_max and not options.keep_a:
        a = _BELOW_CEILING * verdict.a_max
    anchor = Anchor(guess)
    if potential_free:
        anchor = replace(anchor, pull=HELD_XI, stiffness=POTENTIAL_FREE_STIFFNESS)
    if options.convex:
        kappa = least_kappa(terms, scales, verdict, x, guess, a)
        stiff = (STIFFER * kappa,) * len(form.networks) if kappa > KAPPA_MIN else anchor.stiffness
        anchor = replace(anchor, kappa_min=kappa, stiffness=stiff)
    plan = Plan(loop, casimirs, terms, form, x, natural, scales, a, requested, anchor, None)
    if options.learn_casimir:
        penalty = casimir_penalty(terms, form, natural, plan.z, options.seed)
        return replace(plan, extra=penalty)
    if options.shape == "none":
        return plan
    return replace(plan, extra=_shaping(plan, [x_star[s] for s in loop.plant.x], options))


def _shaping(plan: Plan, x_star: Sequence[sp.Expr], options: Options) -> Shaping:
    """What is asked of V over samples of the domain."""
    if plan.form.betas:
        raise OptionError(
            "usage",
            f"--shape {options.shape} needs C = K(c₁, …, c_r), but the form is K(Σ βᵢ(cᵢ))",
            "Add --casimir-form joint.",
        )
    momenta = find_momenta(plan.loop, plan.casimirs, x_star)
    box = sample_box(plan.loop, plan.casimirs, plan.terms, plan.z, momenta)
    size, energy = plan.natural.state, plan.natural.energy
    gamma = 1.0 if options.gamma is None else options.gamma
    return make_shaping(options.shape, box, size, energy, plan.a, gamma, options.seed)


def _inputs(
    loop: ClosedLoop, found: Casimirs, x_star: Mapping[sp.Symbol, sp.Expr], options: Options
) -> tuple[Casimirs, Options]:
    """The functions that K takes, and the options that fit them."""
    casimirs = _smooth_at(found, x_star)
    if options.learn_casimir:
        learning = replace(options, casimir_form="joint", hidden_k=_LEARNED_HIDDEN)
        return state_inputs(loop, casimirs), learning
    if not casimirs.functions:  # constants are Casimirs of every loop: C = K(0) keeps one form
        return replace(casimirs, functions=(sp.Integer(0),)), replace(options, hidden_k=(1,))
    return casimirs, options


def _smooth_at(casimirs: Casimirs, x_star: Mapping[sp.Symbol, sp.Expr]) -> Casimirs:
    """The Casimirs without poles at the target: V must be smooth there."""
    smooth = [i for i, c in enumerate(casimirs.functions) if is_finite(c.subs(x_star))]
    return replace(
        casimirs,
        functions=tuple(casimirs.functions[i] for i in smooth),
        origins=tuple(casimirs.origins[i] for i in smooth) if casimirs.origins else (),
    )
