"""Controller structures that give more Casimirs than one integrator per input.

Constant structures. ∇C = (v, w) with constant Jc, Gc and Rc = 0 needs

    J v = G β,   R v = 0,   β = Gcᵀ w,   Jc w = −Gc α,   α = Gᵀ v.

The pairs (v, β) depend on the plant alone. For a basis vᵢ the choice wᵢ = −eᵢ, rows of Gc equal
to −βᵢᵀ and Jc[:, i] = Gc αᵢ satisfies all of them at once, and Jc is skew because J is:
βⱼᵀαᵢ + βᵢᵀαⱼ = vⱼᵀ(J + Jᵀ)vᵢ = 0. So this one controller makes visible whatever any controller
with constant Jc and Gc can make visible; a resonator appears where an integrator is not enough.

Kinematic copies. Where the configuration moves as q̇ = B(q)y, a controller with ξ̇ = B(ξ)y is
turned by the same rates; on a Lie group q and ξ then stay at a constant distance.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

import sympy as sp

from necc_casadi.casimirs.find import find_casimirs
from necc_casadi.errors import ModelError
from necc_casadi.model.closed_loop import interconnect
from necc_casadi.model.controller import Controller, default_controller, make_controller
from necc_casadi.model.plant import Plant
from necc_casadi.symbolic.linear_algebra import constant_kernel, reduced_rows
from necc_casadi.symbolic.zero import Undecided
from necc_casadi.verdict.judge import judge
from necc_casadi.verdict.verdict import Verdict

__all__ = ["Proposal", "complete_controller", "kinematic_copy", "suggest_controllers"]


class Proposal(NamedTuple):
    """A controller structure, what it is called, and what it reaches."""

    name: str
    controller: Controller
    verdict: Verdict


def suggest_controllers(plant: Plant, x_star: Mapping[sp.Symbol, sp.Expr]) -> list[Proposal]:
    """Structures that reach more at x* than the default integrators, best first.

    A structure is listed if it makes the target assignable where the default does not, or leaves
    fewer invisible directions.
    """
    default = default_controller(plant)
    reference = _judged(plant, default, x_star)
    if reference.reason == "not_an_equilibrium":
        return []
    made = [_proposal(plant, make, x_star) for make in (complete_controller, kinematic_copy)]
    better = [p for p in made if p is not None and p.verdict.merit > reference.merit]
    return sorted(better, key=lambda p: p.verdict.merit, reverse=True)


def _proposal(
    plant: Plant,
    make: Callable[[Plant], Controller | None],
    x_star: Mapping[sp.Symbol, sp.Expr],
) -> Proposal | None:
    """A structure with its name and verdict; None where it is no controller for this plant.

    A proposal that fails a check of the model is dropped: the model is not at fault.
    """
    try:
        controller = make(plant)
        if controller is None:
            return None
        verdict = _judged(plant, controller, x_star)
    except (ModelError, Undecided):
        return None
    return Proposal(f"{_kind(controller)} with {controller.nc} states", controller, verdict)


def _judged(plant: Plant, controller: Controller, x_star: Mapping[sp.Symbol, sp.Expr]) -> Verdict:
    loop = interconnect(plant, controller)
    return judge(loop, find_casimirs(loop, (), x_star), x_star)


def _kind(controller: Controller) -> str:
    if controller.Gc.free_symbols:
        return "copy of the kinematics"
    return "integrators" if controller.Jc.is_zero_matrix else "resonator"


def complete_controller(plant: Plant) -> Controller | None:
    """The constant structure with the most visible directions, or None where there are none."""
    n, m = plant.n, plant.m
    conditions = sp.Matrix.vstack(
        sp.Matrix.hstack(sp.Matrix(plant.J), -sp.Matrix(plant.G), sp.zeros(n, m)),
        sp.Matrix.hstack(sp.Matrix(plant.R), sp.zeros(n, 2 * m)),
        sp.Matrix.hstack(sp.Matrix(plant.G).T, sp.zeros(m, m), -sp.eye(m)),
    )
    pairs = constant_kernel(conditions)
    pairs = _driven(pairs, n)
    if pairs.cols == 0:
        return None
    beta, alpha = pairs[n : n + m, :], pairs[n + m :, :]
    Gc = _completed(-beta.T, m)
    k, nc = pairs.cols, Gc.rows
    Jc = sp.zeros(nc, nc)
    Jc[:, :k] = Gc * alpha
    Jc[:k, k:] = -Jc[k:, :k].T
    return make_controller(plant, _names(plant, nc), Jc, sp.zeros(nc, nc), Gc)


def _driven(pairs: sp.Matrix, n: int) -> sp.Matrix:
    """A basis without the plant's own Casimirs (β = 0 and α = 0): they need no controller."""
    if pairs.cols == 0:
        return pairs
    _, leading = reduced_rows(pairs[n:, :])
    return pairs.extract(list(range(pairs.rows)), leading)


def _completed(rows: sp.Matrix, m: int) -> sp.Matrix:
    """`rows` with unit rows appended until the rank is m."""
    for j in range(m):
        unit = sp.Matrix([[int(i == j) for i in range(m)]])
        if len(reduced_rows(rows)[1]) == m:
            break
        if len(reduced_rows(rows.col_join(unit))[1]) > len(reduced_rows(rows)[1]):
            rows = rows.col_join(unit)
    return rows


def _names(plant: Plant, count: int) -> tuple[sp.Symbol, ...]:
    for stem in ("xi", "zeta", "eta", "xi_c"):
        names = [f"{stem}{i + 1}" for i in range(count)]
        if not set(names) & set(plant.states):
            break
    return tuple(sp.symbols(names, real=True))


def kinematic_copy(plant: Plant) -> Controller | None:
    """ξ̇ = B(ξ)y where the unactuated states move as q̇ = B(q)y with B not constant, else None."""
    actuated = [i for i in range(plant.n) if any(plant.G[i, j] != 0 for j in range(plant.m))]
    carried = [i for i in range(plant.n) if i not in actuated]
    if len(actuated) != plant.m or not carried:
        return None
    G = sp.Matrix(plant.G).extract(actuated, list(range(plant.m)))
    if G.free_symbols or any(plant.R[i, i] != 0 for i in carried):
        return None
    rates = sp.Matrix(plant.J).extract(carried, actuated) * G.T.inv()
    q = [plant.x[i] for i in carried]
    if not rates.free_symbols or not rates.free_symbols <= set(q):
        return None
    xi = _names(plant, len(q))
    Gc = rates.xreplace(dict(zip(q, xi, strict=True)))
    zero = sp.zeros(len(q), len(q))
    return make_controller(plant, xi, zero, zero, Gc)
