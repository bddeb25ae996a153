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

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import sympy as sp

from necc_casadi import exact as ex
from necc_casadi.casimirs import Casimirs
from necc_casadi.curvature import Curvature, best_curvature
from necc_casadi.detectability import reachable_stability
from necc_casadi.loop import ClosedLoop
from necc_casadi.wording import explain

__all__ = ["Verdict", "judge"]

_XI_TRIES = 12


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


@dataclass(frozen=True, eq=False)
class TargetData:
    """Exact derivatives at (x*, ξ) of the energy and of the Casimirs that are finite there."""

    x: tuple[sp.Symbol, ...]  # (n,)
    xi: tuple[sp.Symbol, ...]  # (nc,)
    grad_H: sp.ImmutableMatrix  # n × 1
    hess_H: sp.ImmutableMatrix  # n × n
    grad_c: sp.ImmutableMatrix  # (n + nc) × r; may contain ξ
    hess_c: tuple[sp.ImmutableMatrix, ...]  # r of n × n, with respect to x; may contain ξ
    used: tuple[int, ...]  # which Casimirs are finite at the target
    count: int  # how many Casimirs there are in hand

    @cached_property
    def depends_on_xi(self) -> bool:
        """Whether the conditions at the target involve ξ*."""
        n = len(self.x)
        free = sp.Matrix(self.grad_c)[:n, :].free_symbols.union(
            *[Q.free_symbols for Q in self.hess_c]
        )
        return bool(free & set(self.xi))

    def fixed(self, xi_star: Sequence[sp.Expr]) -> TargetData:
        """The same data at one ξ*."""
        point = dict(zip(self.xi, xi_star, strict=True))
        return replace(
            self,
            grad_c=_at(self.grad_c, point),
            hess_c=tuple(_at(Q, point) for Q in self.hess_c),
        )

    @property
    def finite(self) -> bool:
        """Whether every entry is a finite number or expression."""
        return all(
            not entry.has(sp.zoo, sp.nan, sp.oo, -sp.oo)
            for matrix in (self.grad_c, *self.hess_c)
            for entry in matrix.todok().values()
        )


@dataclass(frozen=True, eq=False)
class Local:
    """The conditions evaluated at one ξ* (or at all, where they do not depend on it)."""

    gradient: bool | None  # ∇H + Nλ = 0 is solvable
    invisible: sp.ImmutableMatrix  # n × k, W
    slope: sp.ImmutableMatrix  # k × 1, Wᵀ∇H
    lam: tuple[sp.Expr, ...] | None
    directions: tuple[sp.Matrix, ...] = ()  # basis of {λ : Nλ = 0}, r × 1 each
    curvature: sp.ImmutableMatrix | None = None  # at `lam`
    best: Curvature | None = None

    @property
    def reason(self) -> str:
        """Contract word for the first condition that fails, before completeness is considered."""
        if self.gradient is not True:
            return "undecided" if self.gradient is None else "invisible_gradient"
        kind = "undecided" if self.best is None else self.best.kind
        return {
            "positive": "ok",
            "negative": "invisible_negative_curvature",
            "flat": "invisible_flat_curvature",
        }.get(kind, "undecided")


def judge(loop: ClosedLoop, casimirs: Casimirs, x_star: Mapping[sp.Symbol, sp.Expr]) -> Verdict:
    """Decide assignability of x* (eq. Loss can reach zero iff this says yes).

    Parameters
    ----------
    x_star
        Exact value of every plant state.
    """
    point = {s: sp.sympify(x_star[s]) for s in loop.plant.x}
    balance = _equilibrium(loop, point)
    data = _target_data(loop, casimirs, point)
    if balance is not True:
        reason = "undecided" if balance is None else "not_an_equilibrium"
        local = Local(None, sp.ImmutableMatrix(sp.zeros(loop.plant.n, 0)), _column([]), None)
        return _verdict(loop, casimirs, point, data, reason, local, None)
    if data.depends_on_xi:
        return _judge_over_xi(loop, casimirs, point, data)
    local = _local(data, loop)
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


def _equilibrium(loop: ClosedLoop, point: Mapping[sp.Symbol, sp.Expr]) -> bool | None:
    """Whether some constant u holds x*: (J − R)∇H(x*) lies in the image of G(x*)."""
    plant = loop.plant
    drift = _at((plant.J - plant.R) * plant.grad_H, point)
    annihilator = ex.kernel(sp.Matrix(_at(plant.G, point)).T).T
    residual = [ex.is_zero(entry) for entry in annihilator * drift]
    return False if False in residual else None if None in residual else True


def _target_data(
    loop: ClosedLoop, casimirs: Casimirs, point: Mapping[sp.Symbol, sp.Expr]
) -> TargetData:
    plant, z = loop.plant, loop.z
    columns, hessians, used = [], [], []
    for index, c in enumerate(casimirs.functions):
        gradient = sparse_gradient(c, z)
        column = _at(gradient, point)
        hessian = _at(sparse_hessian(c, plant.x), point)
        entries = [*column, *hessian.todok().values()]
        if not any(e.has(sp.zoo, sp.nan, sp.oo, -sp.oo) for e in entries):
            columns.append(column)
            hessians.append(hessian)
            used.append(index)
    return TargetData(
        plant.x,
        loop.controller.xi,
        _at(plant.grad_H, point),
        _at(sparse_hessian(plant.H, plant.x), point),
        sp.ImmutableMatrix(sp.Matrix.hstack(*columns) if columns else sp.zeros(len(z), 0)),
        tuple(hessians),
        tuple(used),
        len(casimirs.functions),
    )


def sparse_gradient(f: sp.Expr, variables: Sequence[sp.Symbol]) -> sp.ImmutableMatrix:
    """∇f as a column; variables that do not occur cost nothing."""
    free = f.free_symbols
    return _column([sp.diff(f, v) if v in free else sp.Integer(0) for v in variables])


def sparse_hessian(f: sp.Expr, variables: Sequence[sp.Symbol]) -> sp.ImmutableMatrix:
    """∇²f; variables that do not occur together cost nothing."""
    size = len(variables)
    place = {v: i for i, v in enumerate(variables)}
    entries: dict[tuple[int, int], sp.Expr] = {}
    for i, slope in enumerate(sparse_gradient(f, variables)):
        for j in sorted(place[v] for v in slope.free_symbols if v in place):
            if j <= i:
                entries[i, j] = entries[j, i] = sp.diff(slope, variables[j])
    return sp.ImmutableMatrix(sp.SparseMatrix(size, size, entries))


def _column(entries: Sequence[sp.Expr]) -> sp.ImmutableMatrix:
    return sp.ImmutableMatrix(len(entries), 1, list(entries))


def _at(matrix: sp.MatrixBase, point: Mapping[sp.Symbol, sp.Expr]) -> sp.ImmutableMatrix:
    """`matrix` at exact values of some symbols."""
    entries = {}
    for place, entry in matrix.todok().items():
        known = {s: point[s] for s in entry.free_symbols if s in point}
        entries[place] = entry.subs(known) if known else entry
    return sp.ImmutableMatrix(sp.SparseMatrix(*matrix.shape, entries))


def _local(data: TargetData, loop: ClosedLoop) -> Local:
    """Gradient and curvature conditions at data without ξ."""
    n = len(data.x)
    N = sp.Matrix(data.grad_c)[:n, :]
    invisible = sp.ImmutableMatrix(ex.kernel(N.T) if N.cols else sp.eye(n))
    slope = sp.ImmutableMatrix((invisible.T * data.grad_H).applyfunc(_constant))
    zeros = [ex.is_zero(entry) for entry in slope]
    if not all(z is True for z in zeros):
        return Local(False if False in zeros else None, invisible, slope, None)
    lam, directions = _multipliers(N, sp.Matrix(data.grad_H))
    if lam is None:
        return Local(None, invisible, slope, None)
    forms = [_restricted(Q, invisible) for Q in (data.hess_H, *data.hess_c)]
    Q0 = _combined(forms[0], forms[1:], lam)
    family = [_combined(sp.zeros(*Q0.shape), forms[1:], list(d)) for d in directions]
    best = best_curvature(Q0, family, invisible.T * invisible)
    for tau, d in zip(best.tau, directions, strict=True):
        lam = [value + tau * e for value, e in zip(lam, d, strict=True)]
    final = sp.ImmutableMatrix(_combined(forms[0], forms[1:], lam))
    return Local(True, invisible, slope, tuple(lam), tuple(directions), final, best)


def _constant(entry: sp.Expr) -> sp.Expr:
    return sp.Integer(0) if entry.is_number and ex.sign(entry) == 0 else entry


def _multipliers(N: sp.Matrix, gradient: sp.Matrix) -> tuple[list[sp.Expr] | None, list[sp.Matrix]]:
    """One λ with ∇H + Nλ = 0 (zero where it is free) and a basis of {λ : Nλ = 0}."""
    r = N.cols
    if gradient.is_zero_matrix and ex.has_rank(N, r):
        return [sp.Integer(0)] * r, []
    rows = [i for i in range(N.rows) if any(N[i, j] != 0 for j in range(r))]
    augmented = N.extract(rows, list(range(r))).row_join(-gradient.extract(rows, [0]))
    reduced, pivots = ex.reduced_rows(augmented)
    if r in pivots:
        return None, []
    lam = [sp.Integer(0)] * r
    for i, p in enumerate(pivots):
        lam[p] = reduced[i, r]
    basis = ex.kernel(N.extract(rows, list(range(r)))) if rows else sp.eye(r)
    return lam, [basis[:, j] for j in range(basis.cols)]


def _restricted(Q: sp.MatrixBase, W: sp.MatrixBase) -> sp.Matrix:
    """WᵀQW; skips the products where W is a selection of coordinates or Q is zero."""
    if Q.is_zero_matrix:
        return sp.zeros(W.cols, W.cols)
    left = sp.SparseMatrix(W).T * sp.SparseMatrix(Q)
    return sp.Matrix(left * sp.SparseMatrix(W)).applyfunc(_constant)


def _combined(base: sp.Matrix, forms: Sequence[sp.Matrix], weights: Sequence[sp.Expr]) -> sp.Matrix:
    total = sp.Matrix(base)
    for form, weight in zip(forms, weights, strict=True):
        if weight != 0 and not form.is_zero_matrix:
            total += weight * form
    return total


def _all_casimirs_visible(data: TargetData, loop: ClosedLoop, casimirs: Casimirs) -> bool:
    """Whether rank ∇c(x*, ξ) is proved to be the number of Casimirs that exist, for every ξ."""
    if not casimirs.count_proved or len(data.used) < casimirs.generic_count:
        return False
    wanted = casimirs.generic_count
    if wanted == 0:
        return True
    constant = [i for i in range(data.grad_c.rows) if not data.grad_c.row(i).free_symbols]
    rows = sp.Matrix(data.grad_c).extract(constant, list(range(data.grad_c.cols)))
    return len(ex.reduced_rows(rows)[1]) == wanted


def _decreasing_phi_works(data: TargetData, loop: ClosedLoop, local: Local) -> bool:
    """Whether Φ₁ < 0 assigns the target: Rcl ≡ 0 and negative definite curvature for some λ."""
    if not loop.R.is_zero_matrix or local.lam is None:
        return False
    opposite = replace(
        data,
        grad_H=-data.grad_H,
        hess_H=-data.hess_H,
    )
    return _local(opposite, loop).reason == "ok"


def _judge_over_xi(
    loop: ClosedLoop,
    casimirs: Casimirs,
    point: Mapping[sp.Symbol, sp.Expr],
    data: TargetData,
) -> Verdict:
    """The verdict where N or the Casimirs' curvature depends on ξ*: some ξ* has to work."""
    best: tuple[Local, tuple[sp.Expr, ...]] | None = None
    for xi_star in _candidates(data):
        fixed = data.fixed(xi_star)
        if not fixed.finite:
            continue
        local = _local(fixed, loop)
        if best is not None and local.reason == "ok" and _merit(local) == _merit(best[0]):
            break
        if best is None or _merit(local) > _merit(best[0]):
            best = (local, xi_star)
    if best is None:
        local = Local(None, sp.ImmutableMatrix(sp.zeros(loop.plant.n, 0)), _column([]), None)
        return _verdict(loop, casimirs, point, data, "undecided", local, None)
    local, xi = best
    if local.reason == "ok":
        return _verdict(loop, casimirs, point, data.fixed(xi), "ok", local, xi)
    refused = _refused_for_all_xi(data, loop, casimirs)
    if refused is not None:
        return _verdict(loop, casimirs, point, data, refused[0], refused[1], None)
    return _verdict(loop, casimirs, point, data.fixed(xi), "undecided", local, xi)


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
    never = sp.ImmutableMatrix(_constant_annihilator(N, data.xi))
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
                local = Local(
                    True,
                    never,
                    slope,
                    None,
                    (),
                    None,
                    Curvature(
                        kind, (), None, _column([int(i == j) for i in range(never.cols)]), value
                    ),
                )
                return local.reason, local
    return None


def _constant_annihilator(N: sp.Matrix, xi: Sequence[sp.Symbol]) -> sp.Matrix:
    """Constant w with wᵀN(ξ) = 0 at every ξ tried, then kept only if that is proved."""
    samples = [
        _at(N, ex.random_point(xi, seed)).T for seed in range(2 * N.rows // max(1, N.cols) + 3)
    ]
    basis = ex.kernel(sp.Matrix.vstack(*[sp.Matrix(s) for s in samples]))
    kept = [
        basis[:, j]
        for j in range(basis.cols)
        if all(ex.is_zero(entry) is True for entry in N.T * basis[:, j])
    ]
    return sp.Matrix.hstack(*kept) if kept else sp.zeros(N.rows, 0)
