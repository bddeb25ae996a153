"""Integral action on a plant with fewer inputs than coordinates: what holds near the target.

Where G⊥∇U(q*; θ) = 0 the loop with ζ rests at q*, ξ̄, ζ* for every θ and every constant d, and its
linearisation in (e, q̇, ξ̃, ζ̃) there, which d does not enter, is

    ė = q̇,                Mq̈ = −∇²U e − (R + BDBᵀ)q̇ − BGcᵀh ξ̃ − Bζ̃,
    ξ̃' = Gc(Bᵀq̇ − Dc Gcᵀω),   ζ̃' = Kᵢ(Bᵀe + τBᵀq̇),   ω = hξ̃ − k(GcBᵀe − ξ̃),

with h = ∇²Hc(ξ̄) and k = N_ξ∇²K N_ξᵀ. A matrix inequality AᵀP + PA ≺ 0 on cells that cover the
ranges of θ makes it exponentially stable (Lyapunov's indirect method). No region follows.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import sympy as sp

from necc_casadi.arrays import Truth
from necc_casadi.certificate.claims import statements
from necc_casadi.certificate.claims.claim import Claim
from necc_casadi.certificate.prover.arithmetic.boxes import matrix_enclosure
from necc_casadi.certificate.prover.arithmetic.intervals import Interval, matmul, point
from necc_casadi.certificate.prover.attraction import is_hurwitz, lyapunov_candidate
from necc_casadi.certificate.prover.box import beside, halved
from necc_casadi.certificate.prover.integral import IntegralTerms, is_uncoupled, told_outwards
from necc_casadi.certificate.prover.remainders import transposed
from necc_casadi.designs.design import Design
from necc_casadi.model.lagrangian import Plants, lagrangian, local_integral_obstacle
from necc_casadi.model.ranges import Range
from necc_casadi.symbolic.derivatives import sparse_hessian
from necc_casadi.symbolic.expressions import to_text
from necc_casadi.symbolic.zero import is_zero

__all__ = ["linearised", "prove_local_integral"]


#: Cells of θ at most, and rounds of halving.
_MOST, _ROUNDS = 4096, 16


#: The target is within so many spacings of its doubles.
_ULPS = 4.0


def prove_local_integral(
    design: Design, plants: Plants | None = None, disturbance: Sequence[Range] = ()
) -> Claim | None:
    """That the target is held near it without offset; None without integral action, or as a box.

    With `plants` for every value of their parameters; with `disturbance`, one range per input, for
    every constant one of these, in place of all whose ζ* is within the limits.
    """
    if design.integral is None or 2 * design.loop.plant.m == design.loop.plant.n:
        return None
    loop, functions = design.loop, design.casimirs.functions
    obstacle = local_integral_obstacle(loop, functions, design.form.phi is None)
    plant = None if obstacle is not None else lagrangian(loop, design.units, plants)
    if plant is None or design.form.betas or not is_uncoupled(design):
        return Claim("local_integral", False, statements.INTEGRAL_IS_NOT_COVERED)
    terms = IntegralTerms(design, plant)
    star = terms.design.x_star[: len(plant.q)]
    enclosed = terms.springs_at_rest(np.spacing(np.abs(terms.q_star)) * _ULPS) is not None
    if not enclosed or any(is_zero(v) is not True for v in plant.unheld(star)):
        return Claim("local_integral", False, statements.INTEGRAL_IS_NOT_COVERED)
    resting = terms.resting(disturbance) if disturbance else None
    if resting is not None and not (
        np.all(resting.magnitude < terms.limit) and _is_held(terms, disturbance)
    ):
        return Claim("local_integral", False, statements.INTEGRAL_IS_TOO_SMALL)
    with np.errstate(all="ignore"):
        if not _is_stable(terms):
            return Claim("local_integral", False, statements.NO_LOCAL_INTEGRAL)
    ranges = {str(s): tuple(map(to_text, side)) for s, side in plant.ranges.items()}
    data: dict[str, Any] = {"uncertain": {k: list(side) for k, side in ranges.items()}}
    pushes = [tuple(map(to_text, side)) for side in disturbance]
    if resting is not None:
        data["disturbance"] = [list(side) for side in pushes]
        data["resting"] = [list(side) for side in zip(*told_outwards(resting), strict=True)]
    limits = [float(v) for v in design.integral.limit]
    text = statements.local_integral(limits, ranges, pushes, loop.plant.u_limits or ())
    return Claim("local_integral", True, text, data)


def _is_held(terms: IntegralTerms, disturbance: Sequence[Range]) -> bool:
    """Whether the u that holds the target is strictly within its limits, if it has any."""
    limits = terms.design.loop.plant.u_limits
    if limits is None:
        return True
    (low, high), u = np.array(limits, float).T, terms.inputs_at_rest(disturbance)
    return bool(np.all((low < u.lo) & (u.hi < high)))


def _is_stable(terms: IntegralTerms) -> bool:
    """Whether the linearisation is Hurwitz for every θ, on cells, halved where it is not."""
    cells = terms.theta[None]
    size = np.maximum(terms.theta.rad, np.finfo(float).tiny)
    for _ in range(_ROUNDS):
        left = ~_are_hurwitz(linearised(terms, cells))
        if not left.any():
            return True
        remaining = cells[np.flatnonzero(left)]
        at_middle = _are_hurwitz(linearised(terms, point(remaining.mid)))
        if not len(size) or 2 * remaining.shape[0] > _MOST or not at_middle.all():
            return False
        cells = halved(remaining, size)
    return False


def _are_hurwitz(A: Interval) -> Truth:
    found = np.zeros(A.shape[0], bool)
    for i in range(A.shape[0]):
        P = lyapunov_candidate(A[i].mid)
        found[i] = P is not None and is_hurwitz(A[i], P)
    return found


def linearised(terms: IntegralTerms, theta: Interval) -> Interval:
    """A of the loop at rest over boxes of θ (B, parameters), (B, 2(k + m), 2(k + m)).

    Raises
    ------
    ValueError
        Without integral action, or where ξ̄ is not enclosed.
    """
    plant, integral = terms.plant, terms.design.integral
    off = np.spacing(np.abs(terms.q_star)) * _ULPS
    springs = terms.springs_at_rest(off)
    if integral is None or springs is None:
        raise ValueError("no integral action, or ξ̄ is not enclosed")
    k, m, count = terms.k, terms.m, theta.shape[0]
    ends = terms.q_star - off, terms.q_star + off
    at = Interval(*(np.broadcast_to(v, (count, k)) for v in ends))
    symbols = (*plant.q, *plant.ranges)
    where = beside(at, theta)
    there = dict(zip(plant.q, terms.design.x_star[:k], strict=True))
    mobility = sp.Matrix(plant.M).subs(there).inv().applyfunc(sp.factor)
    inverse = matrix_enclosure(mobility, tuple(plant.ranges), theta)
    stiffness = matrix_enclosure(sparse_hessian(plant.U, plant.q), symbols, where)
    R = matrix_enclosure(sp.Matrix(plant.R), tuple(plant.ranges), theta)
    h, bends = springs
    B, Gc = terms.B, terms.Gc
    Y = matmul(B, transposed(Gc))  # BGcᵀ
    damped = matmul(matmul(B, terms.D), transposed(B)) + R
    leak = matmul(matmul(Gc, terms.Dc), transposed(Gc))
    gain = point(np.diag(integral.gain))
    pulled = matmul(gain, transposed(B))
    blocks: dict[tuple[int, int], Interval] = {
        (0, 1): point(np.eye(k)),
        (1, 0): -matmul(inverse, stiffness),
        (1, 1): -matmul(inverse, damped),
        (1, 2): -matmul(inverse, matmul(Y, h)),
        (1, 3): -matmul(inverse, B),
        (2, 0): matmul(leak, matmul(bends, transposed(Y))),
        (2, 1): transposed(Y),
        (2, 2): -matmul(leak, h + bends),
        (3, 0): pulled,
        (3, 1): pulled * terms.tau,
    }
    edges = np.cumsum([0, k, k, m, m])
    lo = np.zeros((count, edges[-1], edges[-1]))
    hi = lo.copy()
    for (i, j), block in blocks.items():
        rows, columns = slice(edges[i], edges[i + 1]), slice(edges[j], edges[j + 1])
        lo[:, rows, columns], hi[:, rows, columns] = block.lo, block.hi
    return Interval(lo, hi)
