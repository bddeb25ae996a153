"""Verdict at a target, before any training: whether ∇V = 0 and ∇²V ≻ 0 can be assigned there.

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
from dataclasses import replace

import sympy as sp

from necc_casadi.casimirs.casimirs import Casimirs
from necc_casadi.model.closed_loop import ClosedLoop
from necc_casadi.symbolic.derivatives import column
from necc_casadi.symbolic.zero import is_zero, random_point, sign
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
from necc_casadi.verdict.detectability import reachable_stability
from necc_casadi.verdict.explanation import explain
from necc_casadi.verdict.verdict import Verdict

__all__ = ["judge"]


_XI_TRIES = 12


_XI_ROUNDS = 8


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
    balance = is_equilibrium(loop, point)
    data = target_data(loop, casimirs, point)
    if balance is not True:
        reason = "undecided" if balance is None else "not_an_equilibrium"
        local = LocalConditions(
            None, sp.ImmutableMatrix(sp.zeros(loop.plant.n, 0)), column([]), None
        )
        return _verdict(loop, casimirs, point, data, reason, local, None)
    if data.depends_on_xi:
        return _judge_over_xi(loop, casimirs, point, data)
    local = local_conditions(data)
    reason = local.reason
    if reason not in ("ok", "undecided"):
        if not _all_casimirs_visible(data, loop, casimirs):
            reason = "undecided"
        elif reason == "invisible_negative_curvature" and _decreasing_phi_works(data, loop, local):
            reason = "needs_decreasing_phi"
    return _verdict(loop, casimirs, point, data, reason, local, None)


def _verdict(
    loop: ClosedLoop,
    casimirs: Casimirs,
    point: Mapping[sp.Symbol, sp.Expr],
    data: TargetDerivatives,
    reason: str,
    local: LocalConditions,
    xi_star: tuple[sp.Expr, ...] | None,
) -> Verdict:
    accepted = reason == "ok"
    stability, witness = None, None
    if accepted and local.lam is not None:
        xi = xi_star or tuple(sp.Rational(k + 1, 7) for k in range(loop.controller.nc))
        stability, witness = reachable_stability(
            loop, casimirs.functions, point, xi, _all_lambdas(data, local), local.directions
        )
    return Verdict(
        assignable=True if accepted else None if reason == "undecided" else False,
        reason=reason,
        explanation=explain(loop, casimirs, point, data, reason, local, stability, witness),
        lam=_all_lambdas(data, local) if local.lam is not None else None,
        xi_star=xi_star,
        invisible=local.invisible,
        curvature=local.curvature,
        a_max=local.best.ceiling if accepted and local.best is not None else None,
        stability=stability,
        witness=witness,
    )


def _all_lambdas(data: TargetDerivatives, local: LocalConditions) -> tuple[sp.Expr, ...]:
    """λ for all Casimirs in hand: 0 for those that are not finite at the target."""
    full: list[sp.Expr] = [sp.Integer(0)] * data.count
    for index, value in zip(data.used, local.lam or (), strict=False):
        full[index] = value
    return tuple(full)


def _all_casimirs_visible(data: TargetDerivatives, loop: ClosedLoop, casimirs: Casimirs) -> bool:
    """Whether rank ∇c(x*, ξ) is proved to be the number of Casimirs that exist, for every ξ."""
    if not casimirs.count_proved or len(data.used) < casimirs.generic_count:
        return False
    wanted = casimirs.generic_count
    if wanted == 0:
        return True
    return independent_at_every_xi(sp.Matrix(data.grad_c))


def _decreasing_phi_works(
    data: TargetDerivatives, loop: ClosedLoop, local: LocalConditions
) -> bool:
    """Whether Φ₁ < 0 assigns the target: Rcl ≡ 0 and negative definite curvature for some λ."""
    if not loop.R.is_zero_matrix or local.lam is None:
        return False
    opposite = replace(data, grad_H=-data.grad_H, hess_H=-data.hess_H)
    return local_conditions(opposite).reason == "ok"


def _judge_over_xi(
    loop: ClosedLoop,
    casimirs: Casimirs,
    point: Mapping[sp.Symbol, sp.Expr],
    data: TargetDerivatives,
) -> Verdict:
    """The verdict where N or the Casimirs' curvature depends on ξ*: some ξ* has to work."""
    best = _best_xi(data)
    if best is None:
        local = LocalConditions(
            None, sp.ImmutableMatrix(sp.zeros(loop.plant.n, 0)), column([]), None
        )
        return _verdict(loop, casimirs, point, data, "undecided", local, None)
    local, xi = best
    if local.reason == "ok":
        return _verdict(loop, casimirs, point, data.fixed(xi), "ok", local, xi)
    refused = _refused_for_all_xi(data, loop, casimirs)
    if refused is not None:
        return _verdict(loop, casimirs, point, data, refused[0], refused[1], None)
    return _verdict(loop, casimirs, point, data.fixed(xi), "undecided", local, xi)


def _best_xi(data: TargetDerivatives) -> tuple[LocalConditions, tuple[sp.Expr, ...]] | None:
    """The ξ* with the best conditions: simple and random values, then a pattern search.

    The ceiling a_max is a supremum over ξ* as well; what is found is approached from below.
    """
    best: tuple[LocalConditions, tuple[sp.Expr, ...]] | None = None
    for xi_star in _candidates(data):
        local = _conditions_at(data, xi_star)
        if local is None:
            continue
        if best is not None and local.reason == "ok" and _merit(local) == _merit(best[0]):
            return best  # the ceiling does not depend on ξ*
        if best is None or _merit(local) > _merit(best[0]):
            best = (local, xi_star)
    step: sp.Expr = sp.Rational(1, 2)
    for _ in range(_XI_ROUNDS if best is not None and best[0].reason == "ok" else 0):
        better = _neighbour(data, best, step) if best is not None else None
        best, step = (better, step) if better is not None else (best, step / 4)
    return best


def _neighbour(
    data: TargetDerivatives, best: tuple[LocalConditions, tuple[sp.Expr, ...]], step: sp.Expr
) -> tuple[LocalConditions, tuple[sp.Expr, ...]] | None:
    """A ξ* one step along an axis with better conditions, or None."""
    for k in range(len(data.xi)):
        for change in (step, -step):
            moved = (*best[1][:k], best[1][k] + change, *best[1][k + 1 :])
            local = _conditions_at(data, moved)
            if local is not None and _merit(local) > _merit(best[0]):
                return local, moved
    return None


def _conditions_at(data: TargetDerivatives, xi_star: tuple[sp.Expr, ...]) -> LocalConditions | None:
    fixed = data.fixed(xi_star)
    return local_conditions(fixed) if fixed.finite else None


def _merit(local: LocalConditions) -> tuple[int, float]:
    order = {"ok": 3, "undecided": 2, "invisible_flat_curvature": 1}
    ceiling = local.best.ceiling if local.best is not None else -1e300
    return order.get(local.reason, 0), 1e300 if ceiling is None else round(ceiling, 9)


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


def _refused_for_all_xi(
    data: TargetDerivatives, loop: ClosedLoop, casimirs: Casimirs
) -> tuple[str, LocalConditions] | None:
    """A refusal that holds for every ξ: a direction w that no Casimir sees, at any ξ.

    Along such a w the slope of H, or its curvature where no Casimir curves along w either,
    cannot be changed.
    """
    if not _all_casimirs_visible(data, loop, casimirs):
        return None
    n = len(data.x)
    N = sp.Matrix(data.grad_c)[:n, :]
    never = sp.ImmutableMatrix(constant_annihilator(N, data.xi))
    slope = sp.ImmutableMatrix(never.T * data.grad_H)
    if any(is_zero(entry) is False for entry in slope):
        return "invisible_gradient", LocalConditions(False, never, slope, None)
    straight = [
        j
        for j in range(never.cols)
        if all(is_zero((never[:, j].T * Q * never[:, j])[0]) for Q in data.hess_c)
    ]
    for kind, wanted in (("negative", -1), ("flat", 0)):
        for j in straight:
            w = never[:, j]
            value = (w.T * data.hess_H * w)[0] / (w.T * w)[0]
            if sign(value) == wanted:
                unit = column([sp.Integer(i == j) for i in range(never.cols)])
                worst = Curvature(kind, (), None, unit, value)
                local = LocalConditions(True, never, slope, None, best=worst)
                return local.reason, local
    return None
