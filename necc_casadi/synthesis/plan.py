"""What will be trained, decided from the request and the verdict before any training."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import sympy as sp

from necc_casadi.arrays import Vector
from necc_casadi.casimirs.casimirs import Casimirs
from necc_casadi.casimirs.momenta import find_momenta
from necc_casadi.certificate.claims.regions import MOST_KEPT
from necc_casadi.designs.natural import (
    natural_ceiling,
    natural_verdict,
    rescaled_casimirs,
    units_for,
)
from necc_casadi.errors import ModelError, OptionError
from necc_casadi.lyapunov.lyapunov import Terms, make_terms
from necc_casadi.lyapunov.networks import KAPPA_MIN
from necc_casadi.lyapunov.parameterization import Form
from necc_casadi.model.closed_loop import ClosedLoop
from necc_casadi.model.family_loop import FamilyLoop
from necc_casadi.model.rescale import exactly, rescaled_loop
from necc_casadi.model.sizes import Sizes, natural_sizes, with_casimirs
from necc_casadi.symbolic.expressions import is_finite
from necc_casadi.symbolic.floats import to_floats
from necc_casadi.synthesis.convexity import least_kappa
from necc_casadi.synthesis.learned_casimir import casimir_penalty, state_inputs
from necc_casadi.synthesis.lifting import Lifting
from necc_casadi.synthesis.members import Members, members_of
from necc_casadi.synthesis.options import Level, Options, Regulariser, check_options, form_of
from necc_casadi.synthesis.potential_free import (
    HELD_XI,
    POTENTIAL_FREE_STIFFNESS,
    best_coordinates,
    is_potential_free,
)
from necc_casadi.synthesis.programs import is_in_reach
from necc_casadi.synthesis.sample_box import sample_box
from necc_casadi.synthesis.shaping import Shaping, average_over, height_over
from necc_casadi.synthesis.training import STIFFER, Anchor, Penalty
from necc_casadi.synthesis.uniqueness import bent_states, kappa_of_one_minimum
from necc_casadi.verdict.verdict import Verdict

if TYPE_CHECKING:
    import casadi as ca

__all__ = ["Plan", "make_plan", "whole_space_stiffness"]

#: Hidden layer of a learned Casimir: small enough for exact second derivatives.
_LEARNED_HIDDEN = (32,)
#: Curvature asked for by default in natural units, and at most as a share of the ceiling there.
_DEFAULT_A, _OF_CEILING = 0.5, 0.5
#: Quadratic parts of a V with one critical point start this much above their lower bound, so that
#: the damping and they may both be moved by the cost.
_WHOLE_STIFFER = 1.5
#: Share of the ceiling a_max that is asked for when the request lies beyond it.
_BELOW_CEILING = 0.9


@dataclass(frozen=True, eq=False)
class Plan:
    """The networks, the point they are trained at and what is asked of them, in training units."""

    loop: ClosedLoop
    casimirs: Casimirs  # those that V is made of: smooth at x*, or what stands in for them
    in_model: Casimirs  # the same in the units of the model
    verdict: Verdict
    terms: Terms
    form: Form
    x_star: tuple[sp.Expr, ...]  # (n,)
    sizes: Sizes  # in the units of the model
    units: Sizes  # of training, powers of two
    natural: Sizes  # the sizes in training units
    scales: Sizes  # the sizes that the networks are scaled to
    curvature: Vector  # (n + nc,) diagonal asked of ∇²V(z*)
    asked: Vector  # the same as a matrix; of a family, of ∇²V(z*) of each member
    a: float  # the same in the model's units: ∇²V(z*) ⪰ aI
    a_requested: float
    anchor: Anchor
    extra: Penalty | Shaping | None
    members: Members | None = None  # of a family, beside the nominal plant

    @property
    def bends(self) -> list[Vector]:
        """∇²V(z*) of each member of a family less that of V."""
        return [] if self.members is None else self.members.bends(self.x, len(self.curvature))

    @property
    def x(self) -> Vector:
        """x*, (n,)."""
        return to_floats(self.x_star)

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
    family: FamilyLoop | None = None,
) -> Plan:
    """Decide form, units, curvature and start of the training.

    With a family, what is asked of V is asked for all of its members, where that is in reach.

    Raises
    ------
    OptionError
        For options that do not go together, or a form that cannot be shaped.
    """
    check_options(options)
    in_model, options = _inputs(loop, found, x_star, options)
    form = form_of(options, loop.controller.nc, len(in_model.functions))
    guess = np.zeros(loop.controller.nc)
    if verdict.xi_star is not None:
        guess = to_floats(verdict.xi_star)
    sizes = natural_sizes(loop, found.functions, x_star, guess)
    sizes = with_casimirs(sizes, loop, in_model.functions, x_star, guess)
    ones = Sizes.ones(len(loop.z), loop.plant.m, len(in_model.functions))
    units = units_for(sizes, form) if options.natural_units else ones
    a, requested, curvature = _curvature(verdict, sizes, units, options)
    natural = sizes.measured_in(units)
    scaled = rescaled_loop(loop, units)
    casimirs = rescaled_casimirs(in_model, loop, units)
    verdict = natural_verdict(verdict, units, loop.plant.n)
    terms = make_terms(scaled, casimirs)
    state = exactly(units.state)
    plan = Plan(
        loop=scaled,
        casimirs=casimirs,
        in_model=in_model,
        verdict=verdict,
        terms=terms,
        form=form,
        x_star=tuple(x_star[s] / size for s, size in zip(loop.plant.x, state, strict=False)),
        sizes=sizes,
        units=units,
        natural=natural,
        scales=natural if options.natural_units else ones,
        curvature=curvature,
        asked=np.diag(curvature),
        a=a,
        a_requested=requested,
        anchor=Anchor(guess / units.state[terms.n :]),
        extra=None,
    )
    _check_numbers(plan)
    plan = replace(plan, anchor=_anchor(plan, options))
    if options.learn_casimir:
        penalty = casimir_penalty(terms, form, natural, plan.z, options.seed)
        return replace(plan, extra=penalty)
    if family is not None:
        plan = _for_all(plan, members_of(family, units, options.seed))
    kappa = _least_stiffness(plan, options)
    plan = replace(plan, anchor=_stiffened(plan, options, kappa))
    # one critical point: no obstacle is left to raise
    one = isinstance(options.shaping, Level) and kappa is not None
    return plan if one else replace(plan, extra=_shaping(plan, options))


def _check_numbers(plan: Plan) -> None:
    """Refuse a target at which H cannot be evaluated in floating point."""
    plant = plan.loop.plant
    slopes = [(f"∂H/∂{s}", g) for s, g in zip(plant.states, plant.grad_H, strict=True)]
    for label, part in (("H", plant.H), *slopes):
        with np.errstate(all="ignore"):
            value = sp.lambdify(plant.x, part, "numpy")(*map(np.float64, plan.x_star))
        if not np.isfinite(value):
            raise ModelError(
                "singular",
                f"{label} has no value in floating-point numbers at the target",
                "Write H without large terms that cancel, or choose a target nearer to rest.",
            )


def _curvature(
    verdict: Verdict, sizes: Sizes, units: Sizes, options: Options
) -> tuple[float, float, Vector]:
    """(a, a that was requested, both in the model's units; the diagonal in training units)."""
    in_training = units.state**2 / units.energy
    if options.a is not None:
        a = options.a
        if verdict.a_max is not None and a >= verdict.a_max and not options.keep_a:
            a = _BELOW_CEILING * verdict.a_max
        return a, options.a, a * in_training
    share = _DEFAULT_A
    ceiling = natural_ceiling(verdict, sizes)
    if ceiling is not None:
        share = min(share, _OF_CEILING * ceiling)
    a = share * float(sizes.stiffness.min())
    if not options.natural_units:
        return a, a, a * in_training
    return a, a, share * sizes.measured_in(units).stiffness


def _anchor(plan: Plan, options: Options) -> Anchor:
    """Where training starts, and how stiff the quadratic parts are there."""
    anchor, form = plan.anchor, plan.form
    plain = options.quadratic and form.phi is None and not form.betas
    if plain and is_potential_free(plan.loop, plan.casimirs):
        guess = best_coordinates(plan.terms, plan.x, anchor.xi, plan.natural)
        anchor = Anchor(guess, pull=HELD_XI, stiffness=POTENTIAL_FREE_STIFFNESS)
    return anchor


def _stiffened(plan: Plan, options: Options, kappa: float | None) -> Anchor:
    """The start of training where quadratic parts are no softer than κ."""
    anchor, networks = plan.anchor, len(plan.form.networks)
    if kappa is None:
        return anchor
    start = STIFFER if options.convex else _WHOLE_STIFFER
    stiff = (start * kappa,) * networks if kappa > KAPPA_MIN else anchor.stiffness
    return replace(anchor, kappa_min=kappa, stiffness=stiff)


def _for_all(plan: Plan, members: Members) -> Plan:
    """The plan with the curvature of all members asked for, where some V has it."""
    least = members.least_bend(plan.x, plan.natural.state)
    asked = np.diag(plan.curvature) - least
    lifting = Lifting(plan.terms, plan.form, plan.x, plan.scales, plan.anchor.xi)
    return replace(
        plan, members=members, asked=asked if is_in_reach(lifting, asked) else plan.asked
    )


def _least_stiffness(plan: Plan, options: Options) -> float | None:
    """The least κ for a V that is convex everywhere, or has one critical point."""
    if options.convex:
        momenta = find_momenta(plan.loop, plan.casimirs, plan.x_star)
        at = (plan.terms, plan.scales, plan.verdict, plan.x, plan.anchor.xi)
        return least_kappa(*at, plan.curvature, momenta, _energies(plan))
    level = isinstance(options.shaping, Level) and options.quadratic and not plan.form.betas
    return whole_space_stiffness(plan) if options.whole or level else None


def whole_space_stiffness(plan: Plan) -> float | None:
    """The least κ for a V with one critical point, natural units; None where none is enough."""
    if not _may_hold_everywhere(plan.loop, plan.casimirs):
        return None
    momenta = find_momenta(plan.loop, plan.casimirs, plan.x_star)
    radian = 1 / plan.units.state
    at = (plan.terms, plan.scales, plan.verdict, plan.x, plan.anchor.xi, radian, momenta)
    found = kappa_of_one_minimum(*at, _energies(plan))
    if found is None and plan.members is not None:  # one critical point for the nominal plant
        return kappa_of_one_minimum(*at)
    return found


def _energies(plan: Plan) -> tuple[ca.Function, ...]:
    """Of the members of a family."""
    return () if plan.members is None else plan.members.energies


def _may_hold_everywhere(loop: ClosedLoop, casimirs: Casimirs) -> bool:
    """Whether the structure of a loop is one of which a certificate can cover the whole space.

    J, R and G are constant, the Casimirs linear, and H depends on states otherwise than
    quadratically through sines and cosines only.
    """
    constant = not (loop.M.free_symbols or loop.ports.free_symbols)
    linear = all(not sp.diff(c, s).free_symbols for c in casimirs.functions for s in loop.z)
    turning = all(isinstance(f, (sp.sin, sp.cos)) for f in loop.plant.H.atoms(sp.Function))
    return constant and linear and turning


def _shaping(plan: Plan, options: Options) -> Shaping | None:
    """What is asked of V over samples of the domain."""
    asked = options.shaping
    if asked is None:
        return None
    if plan.form.betas:
        raise OptionError(
            "usage",
            f"--shape {options.shape} needs C = K(c₁, …, c_r), but the form is K(Σ βᵢ(cᵢ))",
            "Add --casimir-form joint.",
        )
    momenta = find_momenta(plan.loop, plan.casimirs, plan.x_star)
    size, energy = plan.natural.state, plan.natural.energy
    box = sample_box(plan.loop, plan.casimirs, plan.terms, plan.z, size, momenta)
    if isinstance(asked, Regulariser):
        return average_over(asked.gamma, box, size, energy, options.seed)
    kept: Sequence[int] = box.active
    if options.quadratic:  # the rest of V is quadratic, apart from the networks
        kept = bent_states(plan.terms, plan.scales, plan.verdict, plan.z, momenta)
    kept = [i for i in kept if i in box.shaped]
    if not 0 < len(kept) <= MOST_KEPT:
        return None
    a = float((plan.curvature * size**2).min())
    return height_over(kept, box, size, energy, a, options.seed, plan.members)


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
