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
from dataclasses import dataclass, replace

import sympy as sp

from necc_casadi import exact as ex
from necc_casadi.casimirs import Casimirs
from necc_casadi.conditions import (
    Local,
    TargetData,
    column,
    constant_annihilator,
    independent_at_every_xi,
    is_equilibrium,
    local_conditions,
    target_data,
)
from necc_casadi.curvature import Curvature
from necc_casadi.detectability import reachable_stability
from necc_casadi.loop import ClosedLoop
from necc_casadi.wording import explain

__all__ = ["Verdict", "judge"]

_XI_TRIES = 12
_XI_ROUNDS = 8


@dataclass(frozen=True, eq=False)
class Verdict:
    """Whether a target is assignable, why, and what the structure can reach there."""

    assignable: bool | None  # None: undecided
    reason: str  # contract word: ok, not_an_equilibrium, invisible_gradient, …
    explanation: str  # plain words that tell an engineer what to do
    lam: tuple[sp.Expr, ...] | None  # (r,) λ with ∇H + Nλ = 0
    xi_star: tuple[sp.Expr, ...] | None  # (nc,) an admissible ξ*; None: any works
    invisible: sp.ImmutableMatrix  # n × k, columns span W = ker Nᵀ in the plant's coordinates
    curvature: sp.ImmutableMatrix | None  # k × k, Wᵀ∇²(H + Σλc)W with W = `invisible`
    a_max: float | None  # sup of λ_min at Φ₁(z*) = 1, W orthonormal; None: no ceiling
    stability: str | None  # asymptotic | stable | None (refused, or not decided)
    witness: str | None  # for "stable": what does not decay


def judge(loop: ClosedLoop, casimirs: Casimirs, x_star: Mapping[sp.Symbol, sp.Expr]) -> Verdict:
    """Decide assignability of x* (eq. Loss can reach zero iff this says yes).

    Parameters
    ----------
    x_star
        Exact value of every plant state.
    """
    point = {s: sp.sympify(x_star[s]) for s in loop.plant.x}
    balance = is_equilibrium(loop, point)
    data = target_data(loop, casimirs, point)
    if balance is not True:
        reason = "undecided" if balance is None else "not_an_equilibrium"
        local = Local(None, sp.ImmutableMatrix(sp.zeros(loop.plant.n, 0)), column([]), None)
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
    data: TargetData,
    reason: str,
    local: Local,
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


def _all_lambdas(data: TargetData, local: Local) -> tuple[sp.Expr, ...]:
    """λ for all Casimirs in hand: 0 for those that are not finite at the target."""
    full = [sp.Integer(0)] * data.count
    for index, value in zip(data.used, local.lam or (), strict=False):
        full[index] = value
    return tuple(full)


def _all_casimirs_visible(data: TargetData, loop: ClosedLoop, casimirs: Casimirs) -> bool:
    """Whether rank ∇c(x*, ξ) is proved to be the number of Casimirs that exist, for every ξ."""
    if not casimirs.count_proved or len(data.used) < casimirs.generic_count:
        return False
    wanted = casimirs.generic_count
    if wanted == 0:
        return True
    return independent_at_every_xi(sp.Matrix(data.grad_c))


def _decreasing_phi_works(data: TargetData, loop: ClosedLoop, local: Local) -> bool:
    """Whether Φ₁ < 0 assigns the target: Rcl ≡ 0 and negative definite curvature for some λ."""
    if not loop.R.is_zero_matrix or local.lam is None:
        return False
    opposite = replace(data, grad_H=-data.grad_H, hess_H=-data.hess_H)
    return local_conditions(opposite).reason == "ok"


def _judge_over_xi(
    loop: ClosedLoop,
    casimirs: Casimirs,
    point: Mapping[sp.Symbol, sp.Expr],
    data: TargetData,
) -> Verdict:
    """The verdict where N or the Casimirs' curvature depends on ξ*: some ξ* has to work."""
    best = _best_xi(data)
    if best is None:
        local = Local(None, sp.ImmutableMatrix(sp.zeros(loop.plant.n, 0)), column([]), None)
        return _verdict(loop, casimirs, point, data, "undecided", local, None)
    local, xi = best
    if local.reason == "ok":
        return _verdict(loop, casimirs, point, data.fixed(xi), "ok", local, xi)
    refused = _refused_for_all_xi(data, loop, casimirs)
    if refused is not None:
        return _verdict(loop, casimirs, point, data, refused[0], refused[1], None)
    return _verdict(loop, casimirs, point, data.fixed(xi), "undecided", local, xi)


def _best_xi(data: TargetData) -> tuple[Local, tuple[sp.Expr, ...]] | None:
    """The ξ* with the best conditions: simple and random values, then a pattern search.

    The ceiling a_max is a supremum over ξ* as well; what is found is approached from below.
    """
    best: tuple[Local, tuple[sp.Expr, ...]] | None = None
    for xi_star in _candidates(data):
        local = _conditions_at(data, xi_star)
        if local is None:
            continue
        if best is not None and local.reason == "ok" and _merit(local) == _merit(best[0]):
            return best  # the ceiling does not depend on ξ*
        if best is None or _merit(local) > _merit(best[0]):
            best = (local, xi_star)
    step = sp.Rational(1, 2)
    for _ in range(_XI_ROUNDS if best is not None and best[0].reason == "ok" else 0):
        better = _neighbour(data, best, step) if best is not None else None
        best, step = (better, step) if better is not None else (best, step / 4)
    return best


def _neighbour(
    data: TargetData, best: tuple[Local, tuple[sp.Expr, ...]], step: sp.Expr
) -> tuple[Local, tuple[sp.Expr, ...]] | None:
    """A ξ* one step along an axis with better conditions, or None."""
    for k in range(len(data.xi)):
        for change in (step, -step):
            moved = (*best[1][:k], best[1][k] + change, *best[1][k + 1 :])
            local = _conditions_at(data, moved)
            if local is not None and _merit(local) > _merit(best[0]):
                return local, moved
    return None


def _conditions_at(data: TargetData, xi_star: tuple[sp.Expr, ...]) -> Local | None:
    fixed = data.fixed(xi_star)
    return local_conditions(fixed) if fixed.finite else None


def _merit(local: Local) -> tuple[int, float]:
    order = {"ok": 3, "undecided": 2, "invisible_flat_curvature": 1}
    ceiling = local.best.ceiling if local.best is not None else -1e300
    return order.get(local.reason, 0), 1e300 if ceiling is None else round(ceiling, 9)


def _candidates(data: TargetData) -> list[tuple[sp.Expr, ...]]:
    """Simple values of ξ first, then random rationals."""
    nc = len(data.xi)
    simple = [(sp.Integer(0),) * nc, (sp.Integer(1),) * nc, (sp.Rational(1, 2),) * nc]
    spread = [
        tuple(ex.random_point(data.xi, seed)[s] for s in data.xi) for seed in range(_XI_TRIES)
    ]
    short = [tuple(sp.Rational(round(float(v) * 8), 8) for v in values) for values in spread]
    return simple + short


def _refused_for_all_xi(
    data: TargetData, loop: ClosedLoop, casimirs: Casimirs
) -> tuple[str, Local] | None:
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
    if any(ex.is_zero(entry) is False for entry in slope):
        return "invisible_gradient", Local(False, never, slope, None)
    straight = [
        j
        for j in range(never.cols)
        if all(ex.is_zero((never[:, j].T * Q * never[:, j])[0]) for Q in data.hess_c)
    ]
    for kind, wanted in (("negative", -1), ("flat", 0)):
        for j in straight:
            w = never[:, j]
            value = (w.T * data.hess_H * w)[0] / (w.T * w)[0]
            if ex.sign(value) == wanted:
                unit = column([int(i == j) for i in range(never.cols)])
                worst = Curvature(kind, (), None, unit, value)
                local = Local(True, never, slope, None, best=worst)
                return local.reason, local
    return None
