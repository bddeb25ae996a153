"""The verdict in plain words: what fails, which coordinate, what would help.

References
----------
Ortega, van der Schaft, Mareels and Maschke (2001), the dissipation obstacle.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import sympy as sp

from necc_casadi.casimirs.casimirs import Casimirs
from necc_casadi.model.closed_loop import ClosedLoop
from necc_casadi.symbolic.definiteness import UNDECIDED
from necc_casadi.symbolic.derivatives import at, value_at
from necc_casadi.symbolic.expressions import is_finite
from necc_casadi.symbolic.floats import to_float
from necc_casadi.symbolic.linear_algebra import generic_rank, kernel
from necc_casadi.symbolic.zero import is_zero
from necc_casadi.verdict.conditions import LocalConditions, TargetDerivatives
from necc_casadi.verdict.detectability import Reach
from necc_casadi.verdict.verdict import ASYMPTOTIC, STABLE, Reason, assignable

__all__ = ["direction_name", "explain"]


_MOST_NAMES = 5


def explain(
    loop: ClosedLoop,
    casimirs: Casimirs,
    x_star: Mapping[sp.Symbol, sp.Expr],
    data: TargetDerivatives,
    reason: Reason,
    local: LocalConditions,
    reach: Reach,
) -> str:
    """One or two sentences for an engineer."""
    if reason == "not_an_equilibrium":
        return _off_equilibrium(loop, x_star)
    if reason == "ok":
        return _accepted(casimirs, local, reach)
    if reason == UNDECIDED:
        return _undecided(loop, casimirs, x_star, data, local)
    fault, w = _failure(loop, casimirs, local, x_star)
    if reason == "needs_decreasing_phi":
        return (
            f"{fault}: no Φ with Φ₁ > 0 assigns this target. The loop is lossless, so Φ₁ < 0 "
            "(a maximum of H + Hc + C) would; it gives up the decrease of V under dissipation."
        )
    return f"{fault}: {_consequence(reason)} {_remedy(loop, x_star, w)}"


def _consequence(reason: Reason) -> str:
    if reason == "invisible_flat_curvature":
        return "no choice of K and Hc makes ∇²V positive definite here."
    return "no choice of K and Hc with Φ₁ > 0 asymptotically stabilises this target."


def _off_equilibrium(loop: ClosedLoop, x_star: Mapping[sp.Symbol, sp.Expr]) -> str:
    values = []
    for equation in loop.plant.equilibrium_equations:
        value = value_at(equation, x_star)
        if is_zero(value) is not True:
            values.append(f"{short(equation)} = {number(value)}, which must be 0")
    detail = "; ".join(values[:2]) or "G⊥(J − R)∇H ≠ 0"
    return (
        f"no constant input holds this target: {detail}. "
        "Choose a target where the unactuated rates vanish."
    )


def _accepted(casimirs: Casimirs, local: LocalConditions, reach: Reach) -> str:
    through = f" through {_casimir_list(casimirs)}" if casimirs.functions else " without a Casimir"
    text = f"assignable{through}"
    ceiling = local.best.ceiling if local.best is not None else None
    if ceiling is not None and local.invisible.cols:
        text += f"; with Φ₁ = 1 the Hessian's least eigenvalue stays below {ceiling:.4g}"
    text += "."
    if reach.stability == STABLE:
        text += f" Only stable, not asymptotically: {reach.witness}."
    elif reach.stability == ASYMPTOTIC and reach.witness:
        text += f" Asymptotically stable; {reach.witness}."
    elif reach.stability is None and reach.witness:
        text += f" Asymptotic stability is not decided: {reach.witness}."
    return text


def _undecided(
    loop: ClosedLoop,
    casimirs: Casimirs,
    x_star: Mapping[sp.Symbol, sp.Expr],
    data: TargetDerivatives,
    local: LocalConditions,
) -> str:
    if not all(is_finite(e) for e in (*data.grad_H, *data.hess_H)):
        return "not decided: H is not smooth at the target. Choose a target where it is."
    unknown = local.undecided or casimirs.undecided
    if unknown is not None:
        return (
            f"not decided: no proof was found whether {unknown} is zero. Write it in a "
            "simpler form, or leave it out where it is zero."
        )
    missing = casimirs.generic_count - len(casimirs.functions)
    if missing > 0:
        cause = (
            f"{casimirs.generic_count} Casimirs exist and {len(casimirs.functions)} are known in "
            "closed form; the missing one may cure the failing condition. Supply it in the model "
            "file: casimirs = [...]."
        )
    elif len(data.used) < data.count:
        cause = (
            "a Casimir is singular at the target, so a refusal would not be proved. Supply a form "
            "that is finite there: casimirs = [...], or move the target slightly."
        )
    else:
        cause = (
            "the Casimirs' gradients are dependent at the target or depend on ξ*, so a refusal "
            "would not be proved. Supply other forms (casimirs = [...]) or move the target."
        )
    if assignable(local.reason) is False:
        fault, _ = _failure(loop, casimirs, local, x_star)
        return f"{fault}, but {cause}"
    return f"not decided: {cause}"


def _failure(
    loop: ClosedLoop,
    casimirs: Casimirs,
    local: LocalConditions,
    x_star: Mapping[sp.Symbol, sp.Expr],
) -> tuple[str, sp.MatrixBase | None]:
    """What fails along which direction, and the direction in the plant's coordinates."""
    x, W = loop.plant.x, local.invisible
    if local.gradient is False:
        sloping = (j for j in range(W.cols) if is_zero(local.slope[j]) is False)
        dissipating = _dissipating_direction(loop, x_star)
        w = W[:, next(sloping)] if dissipating is None else sp.ImmutableMatrix(dissipating)
        w = w / max(w, key=lambda e: abs(float(sp.N(e))))
        slope = (w.T * at(loop.plant.grad_H, x_star))[0]
        return (
            f"{direction_name(x, w)} is invisible to {_casimir_list(casimirs)} and H slopes along "
            f"it ({number(slope)})",
            w,
        )
    best = local.best
    if best is None or best.direction is None:
        return (
            f"the invisible directions of {_casimir_list(casimirs)} leave H curved downwards for "
            "every λ",
            None,
        )
    w = W * best.direction
    shape = "curves downwards" if best.kind == "negative" else "is exactly flat"
    return (
        f"{direction_name(x, w)} is invisible to {_casimir_list(casimirs)} and H {shape} along it "
        f"({number(best.value)})",
        w,
    )


def _remedy(loop: ClosedLoop, x_star: Mapping[sp.Symbol, sp.Expr], w: sp.MatrixBase | None) -> str:
    if w is None:
        return "Add actuation, or choose another target."
    obstacle = _dissipation_obstacle(loop, x_star, w) or _controller_obstacle(loop, x_star, w)
    if obstacle:
        return obstacle
    name = direction_name(loop.plant.x, w)
    G = sp.Matrix(at(loop.plant.G, x_star))
    if any(is_zero(push) is not True for push in G.T * w):
        return (
            f"An input acts on {name}, but no Casimir ties it to the controller: try another "
            "controller structure (Jc, Gc), or another target."
        )
    it = name if name in loop.plant.states else "along it"
    return f"Actuate {it}, or choose a target at which H is at rest and curves upwards along it."


def _dissipation_obstacle(
    loop: ClosedLoop, x_star: Mapping[sp.Symbol, sp.Expr], w: sp.MatrixBase
) -> str | None:
    """The entry of R that hides w from every controller structure; None where R does not.

    ∇ₓC lies in ker R for every Casimir of every controller, so that all of the image of R is
    invisible.
    """
    R = _dissipation_at(loop, x_star)
    if R.is_zero_matrix or generic_rank(R.row_join(sp.Matrix(w))) > generic_rank(R):
        return None
    place = _dissipating_entry(R, sp.Matrix(w))
    if place is None:
        return None
    i, j = place
    return (
        f"Dissipation obstacle: R[{i},{j}] = {short(loop.plant.R[i, j])} dissipates in "
        f"{loop.plant.x[j]}, which would have to be shaped, and hides it from every controller "
        "structure. Remove that dissipation from the shaped coordinate, or choose a target at "
        "which it is at rest."
    )


def _controller_obstacle(
    loop: ClosedLoop, x_star: Mapping[sp.Symbol, sp.Expr], w: sp.MatrixBase
) -> str | None:
    """The entry of Rc that hides w, if the lossless controller would see it."""
    Rc, n = sp.Matrix(loop.controller.Rc), loop.plant.n
    if Rc.is_zero_matrix:
        return None
    point = {**x_star, **{s: sp.Rational(3, 7) for s in loop.controller.xi}}
    lossless = loop.J - sp.diag(sp.Matrix(loop.plant.R), sp.zeros(*Rc.shape))
    seen = kernel(sp.Matrix(at(lossless.T, point)))
    for k in range(seen.cols):
        place = _dissipating_entry(sp.Matrix(at(Rc, point)), seen[n:, k])
        if place is not None and is_zero((seen[:n, k].T * w)[0]) is False:
            i, j = place
            return (
                f"Rc[{i},{j}] = {short(Rc[i, j])} dissipates in {loop.controller.xi[j]}: no "
                "Casimir that involves it is left. Set Rc = 0."
            )
    return None


def _dissipation_at(loop: ClosedLoop, x_star: Mapping[sp.Symbol, sp.Expr]) -> sp.Matrix:
    R = loop.plant.R
    return sp.Matrix(R.subs({s: x_star[s] for s in R.free_symbols}))


def _dissipating_entry(R: sp.Matrix, v: sp.Matrix) -> tuple[int, int] | None:
    """An entry of R through which Rv ≠ 0, on the diagonal where there is one."""
    lost = [i for i in range(R.rows) if is_zero((R[i, :] * v)[0]) is False]
    entries = [(i, j) for i in lost for j in range(R.cols) if is_zero(R[i, j] * v[j]) is False]
    return min(entries, key=lambda place: place[0] != place[1], default=None)


def _dissipating_direction(
    loop: ClosedLoop, x_star: Mapping[sp.Symbol, sp.Expr]
) -> sp.Matrix | None:
    """The coordinate that dissipates at rest: a column of R along which H slopes, if R∇H ≠ 0."""
    R = _dissipation_at(loop, x_star)
    slope = sp.Matrix(at(loop.plant.grad_H, x_star))
    place = _dissipating_entry(R, slope)
    return None if place is None else R[:, place[0]]


def direction_name(x: Sequence[sp.Symbol], w: sp.MatrixBase) -> str:
    """A direction in the user's coordinates: ``θ``, or ``the direction q1 − 2·q2``."""
    parts = [(x[i], w[i]) for i in range(len(x)) if w[i] != 0]
    if len(parts) == 1:
        return str(parts[0][0])
    lead = max(abs(to_float(value)) for _, value in parts)
    terms = [(s, to_float(value) / lead) for s, value in parts]
    shown = [_term(s, value) for s, value in terms if abs(value) > 1e-3][:_MOST_NAMES]
    more = " + …" if len(parts) > _MOST_NAMES else ""
    return "the direction " + " + ".join(shown).replace("+ -", "- ") + more


def _term(s: sp.Symbol, value: float) -> str:
    text = f"{abs(value):.4g}"
    return ("-" if value < 0 else "") + (str(s) if text == "1" else f"{text}·{s}")


def number(value: sp.Expr | None) -> str:
    """A constant to four digits."""
    return "?" if value is None else f"{to_float(value):.4g}"


def short(expr: sp.Expr) -> str:
    """The expression, or its beginning."""
    text = str(expr)
    return text if len(text) <= 80 else text[:79] + "…"


def _casimir_list(casimirs: Casimirs) -> str:
    names = [short(c) for c in casimirs.functions]
    if not names:
        return "the controller (the loop has no Casimir)"
    if len(names) == 1:
        return f"the only Casimir {names[0]}"
    return f"the Casimirs {', '.join(names[:_MOST_NAMES])}" + (
        ", …" if len(names) > _MOST_NAMES else ""
    )
