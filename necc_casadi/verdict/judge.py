"""Verdict at a target, before any training: whether eq. LocalMinimumCondition can be assigned.

With N = ∇ₓc(x*, ξ*) for the Casimirs c and W a basis of ker Nᵀ, the target is assignable iff for
some (ξ*, λ)

    gradient     ∇H(x*) + Nλ = 0
    curvature    Wᵀ ∇²ₓ(H + Σ λᵢcᵢ)(x*, ξ*) W ≻ 0

(Finsler's lemma: K supplies curvature along N, Hc along ξ.) A failure is a refusal only where
∇c(z*) has as many independent columns as Casimirs exist, for then every Casimir is, near z*, a
function of those in hand; otherwise it is undecided.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import inf

import sympy as sp

from necc_casadi.casimirs.casimirs import Casimirs
from necc_casadi.model.closed_loop import ClosedLoop
from necc_casadi.model.piece import loop_piece
from necc_casadi.symbolic.definiteness import UNDECIDED, Definiteness
from necc_casadi.symbolic.derivatives import column
from necc_casadi.symbolic.zero import Undecided, is_zero, random_point, sign
from necc_casadi.verdict.conditions import (
    LocalConditions,
    TargetDerivatives,
    constant_annihilator,
    independent_at_every_xi,
    is_equilibrium,
    local_conditions,
    target_data,
)
from necc_casadi.verdict.curvature import Curvature
from necc_casadi.verdict.detectability import Assignment, Reach, reachable_stability
from necc_casadi.verdict.explanation import explain
from necc_casadi.verdict.verdict import Merit, Reason, Verdict, assignable

__all__ = ["judge"]


_XI_TRIES = 12


_XI_ROUNDS = 8


_CEILING_DIGITS = 9  # beside the largest entry of ∇²H: what is closer is one ceiling


@dataclass(frozen=True, eq=False)
class _Question:
    """A target of a loop, and what is known there."""

    loop: ClosedLoop
    casimirs: Casimirs
    point: Mapping[sp.Symbol, sp.Expr]  # x*
    data: TargetDerivatives


@dataclass(frozen=True, eq=False)
class _Tried:
    """The conditions at one ξ*."""

    xi: tuple[sp.Expr, ...]
    local: LocalConditions
    merit: Merit


def judge(loop: ClosedLoop, casimirs: Casimirs, x_star: Mapping[sp.Symbol, sp.Expr]) -> Verdict:
    """Decide assignability of x* (eq. Loss can reach zero iff this says yes).

    Parameters
    ----------
    loop, casimirs
        Closed loop and its closed-form Casimirs.
    x_star
        Exact value of every plant state.

    Returns
    -------
    Verdict
        True and False are proved, None is undecided; a refusal is a value, not an exception.

    References
    ----------
    Finsler (1937). docs/theory.md#verdict has statement and proof.

    Examples
    --------
    >>> from necc_casadi import find_casimirs, judge, load_model, parse_target
    >>> loop = load_model("pendulum.py").loop
    >>> verdict = judge(loop, find_casimirs(loop), parse_target(loop.plant, "pi/4"))
    >>> verdict.assignable, verdict.reason, round(verdict.a_max, 6)
    (True, 'ok', 1.0)
    >>> judge(loop, find_casimirs(loop), parse_target(loop.plant, "0,1")).reason
    'not_an_equilibrium'
    """
    point = {s: sp.sympify(x_star[s]) for s in loop.plant.x}
    loop = loop_piece(loop, point).loop
    question = _Question(loop, casimirs, point, target_data(loop, casimirs, point))
    try:
        return _judged(question)
    except Undecided as unknown:
        nothing = LocalConditions.unknown(loop.plant.n)
        return _verdict(question, UNDECIDED, replace(nothing, undecided=str(unknown)))


def _judged(question: _Question) -> Verdict:
    balance = is_equilibrium(question.loop, question.point)
    if balance is not True:
        return _verdict(question, UNDECIDED if balance is None else "not_an_equilibrium")
    if question.data.depends_on_xi:
        return _judge_over_xi(question)
    local = local_conditions(question.data)
    reason = local.reason
    if assignable(reason) is False:
        if not _all_casimirs_visible(question):
            reason = UNDECIDED
        elif reason == "invisible_negative_curvature" and _decreasing_phi_works(question, local):
            reason = "needs_decreasing_phi"
    return _verdict(question, reason, local)


def _verdict(
    question: _Question,
    reason: Reason,
    local: LocalConditions | None = None,
    xi_star: tuple[sp.Expr, ...] | None = None,
) -> Verdict:
    local = local or LocalConditions.unknown(question.loop.plant.n)
    accepted = reason == "ok"
    reach = _reach(question, local, xi_star) if accepted else Reach()
    return Verdict(
        assignable=assignable(reason),
        reason=reason,
        explanation=explain(
            question.loop, question.casimirs, question.point, question.data, reason, local, reach
        ),
        lam=_all_lambdas(question.data, local) if local.lam is not None else None,
        xi_star=xi_star,
        invisible=local.invisible,
        curvature=local.curvature,
        a_max=local.best.ceiling if accepted and local.best is not None else None,
        stability=reach.stability,
        witness=reach.witness,
    )


def _reach(
    question: _Question, local: LocalConditions, xi_star: tuple[sp.Expr, ...] | None
) -> Reach:
    if local.lam is None:
        return Reach()
    loop = question.loop
    assignment = Assignment(
        loop=loop,
        functions=question.casimirs.functions,
        x_star=question.point,
        xi_star=xi_star or tuple(sp.Rational(k + 1, 7) for k in range(loop.controller.nc)),
        lam=_all_lambdas(question.data, local),
        directions=local.directions,
    )
    try:
        return reachable_stability(assignment)
    except Undecided as unknown:
        return Reach(witness=f"no proof was found whether {unknown} is zero")


def _all_lambdas(data: TargetDerivatives, local: LocalConditions) -> tuple[sp.Expr, ...]:
    """λ for all Casimirs in hand: 0 for those that are not finite at the target."""
    full: list[sp.Expr] = [sp.Integer(0)] * data.count
    for index, value in zip(data.used, local.lam or (), strict=False):
        full[index] = value
    return tuple(full)


def _all_casimirs_visible(question: _Question) -> bool:
    """Whether rank ∇c(x*, ξ) is proved to be the number of Casimirs that exist, for every ξ."""
    data, casimirs = question.data, question.casimirs
    if not casimirs.count_proved or len(data.used) < casimirs.generic_count:
        return False
    return casimirs.generic_count == 0 or independent_at_every_xi(sp.Matrix(data.grad_c))


def _decreasing_phi_works(question: _Question, local: LocalConditions) -> bool:
    """Whether Φ₁ < 0 assigns the target: Rcl ≡ 0 and negative definite curvature for some λ."""
    if not question.loop.R.is_zero_matrix or local.lam is None:
        return False
    data = question.data
    opposite = replace(data, grad_H=-data.grad_H, hess_H=-data.hess_H)
    return local_conditions(opposite).reason == "ok"


def _judge_over_xi(question: _Question) -> Verdict:
    """The verdict where N or the Casimirs' curvature depends on ξ*: some ξ* has to work."""
    best = _best_xi(question.data)
    if best is None:
        return _verdict(question, UNDECIDED)
    there = replace(question, data=question.data.fixed(best.xi))
    if best.local.reason == "ok":
        return _verdict(there, "ok", best.local, best.xi)
    refused = _refused_for_all_xi(question)
    if refused is not None:
        return _verdict(question, refused.reason, refused)
    return _verdict(there, UNDECIDED, best.local, best.xi)


def _best_xi(data: TargetDerivatives) -> _Tried | None:
    """The ξ* with the best conditions: simple and random values, then a pattern search.

    The ceiling a_max is a supremum over ξ* as well; what is found is approached from below.
    """
    best: _Tried | None = None
    for xi_star in _candidates(data):
        tried = _tried(data, xi_star)
        if tried is None:
            continue
        if best is not None and tried.local.reason == "ok" and tried.merit == best.merit:
            return best  # the ceiling does not depend on ξ*
        if best is None or tried.merit > best.merit:
            best = tried
    if best is None or best.local.reason != "ok":
        return best
    step: sp.Expr = sp.Rational(1, 2)
    for _ in range(_XI_ROUNDS):
        better = _neighbour(data, best, step)
        best, step = (best, step / 4) if better is None else (better, step)
    return best


def _neighbour(data: TargetDerivatives, best: _Tried, step: sp.Expr) -> _Tried | None:
    """A ξ* one step along an axis with better conditions, or None."""
    for k in range(len(data.xi)):
        for change in (step, -step):
            tried = _tried(data, (*best.xi[:k], best.xi[k] + change, *best.xi[k + 1 :]))
            if tried is not None and tried.merit > best.merit:
                return tried
    return None


def _tried(data: TargetDerivatives, xi_star: tuple[sp.Expr, ...]) -> _Tried | None:
    """None where the conditions are not finite."""
    fixed = data.fixed(xi_star)
    if not fixed.finite:
        return None
    local = local_conditions(fixed)
    if local.best is None:
        ceiling = -inf
    elif local.best.ceiling is None:
        ceiling = inf
    else:
        ceiling = round(local.best.ceiling / data.stiffness, _CEILING_DIGITS)
    return _Tried(xi_star, local, Merit.of(local.reason, ceiling))


def _candidates(data: TargetDerivatives) -> list[tuple[sp.Expr, ...]]:
    """Simple values of ξ first, then random rationals."""
    nc = len(data.xi)
    simple: list[tuple[sp.Expr, ...]] = [
        (sp.Integer(0),) * nc,
        (sp.Integer(1),) * nc,
        (sp.Rational(1, 2),) * nc,
    ]
    spread = [tuple(random_point(data.xi, seed)[s] for s in data.xi) for seed in range(_XI_TRIES)]
    short = [tuple(sp.Rational(round(float(v) * 8), 8) for v in values) for values in spread]
    return [*simple, *short]


def _refused_for_all_xi(question: _Question) -> LocalConditions | None:
    """A refusal that holds for every ξ: a direction w that no Casimir sees, at any ξ.

    Along such a w the slope of H, or its curvature where no Casimir curves along w either,
    cannot be changed.
    """
    if not _all_casimirs_visible(question):
        return None
    data = question.data
    N = sp.Matrix(data.grad_c)[: len(data.x), :]
    never = sp.ImmutableMatrix(constant_annihilator(N, data.xi))
    slope = sp.ImmutableMatrix(never.T * data.grad_H)
    if any(is_zero(entry) is False for entry in slope):
        return LocalConditions(False, never, slope, None)
    straight = [
        j
        for j in range(never.cols)
        if all(is_zero((never[:, j].T * Q * never[:, j])[0]) for Q in data.hess_c)
    ]
    kinds: dict[Definiteness, int] = {"negative": -1, "flat": 0}
    for kind, wanted in kinds.items():
        for j in straight:
            w = never[:, j]
            value = (w.T * data.hess_H * w)[0] / (w.T * w)[0]
            if sign(value) == wanted:
                unit = column([sp.Integer(i == j) for i in range(never.cols)])
                worst = Curvature(kind, (), None, unit, value)
                return LocalConditions(True, never, slope, None, best=worst)
    return None
