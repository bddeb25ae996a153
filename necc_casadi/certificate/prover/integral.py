"""Integral action: W of docs/theory.md#integral-action falls in a box, and stays in it.

With e = q − q*, ξ̃ = ξ − ξ̄, where ξ̄ is the minimum of Hc(ξ) + K(c(q*, ξ)), and the remainders
Ũ, H₀, K₀ of U, Hc, K beyond their first order,

    W = ½(q̇ + e/τ)ᵀM(q̇ + e/τ) + E_W(e, ξ̃) + ½(ζ − ζ*)ᵀKᵢ⁻¹(ζ − ζ*)/τ,
    E_W = Ũ + K₀ + H₀ + ½eᵀ(BDBᵀ + R − M/τ)e/τ,     −Ẇ ≥ (q̇, e, ω)ᵀ S (q̇, e, ω).

On each cell of the box either E_W > c or S ≻ 0, and E_W > c on the sides of the box: a solution
that starts with W ≤ c and (e, ξ̃) in the box stays there, and e → 0 for every ζ* within the limits.
For disturbances within bounds ζ* = d − B⁻¹∇U(q*) − Gcᵀ∇Hc(ξ̄) is enclosed.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
import sympy as sp

from necc_casadi.arrays import Truth, Vector
from necc_casadi.certificate.claims import statements
from necc_casadi.certificate.claims.claim import Claim
from necc_casadi.certificate.prover.arithmetic.boxes import matrix_enclosure, subdivide
from necc_casadi.certificate.prover.arithmetic.definite import positive_definite, solve
from necc_casadi.certificate.prover.arithmetic.intervals import Interval, matmul, point
from necc_casadi.certificate.prover.arithmetic.jets import constant, coordinates
from necc_casadi.certificate.prover.box import beside, searched
from necc_casadi.certificate.prover.remainders import Remainders, exact, transposed
from necc_casadi.designs.design import Design
from necc_casadi.model.lagrangian import Lagrangian, Plants, integral_obstacle, lagrangian
from necc_casadi.model.ranges import Range
from necc_casadi.symbolic.derivatives import gradient
from necc_casadi.symbolic.expressions import to_text

__all__ = ["IntegralTerms", "is_uncoupled", "prove_integral", "told_outwards"]


#: Of ζ* in natural units and 1: what is told of it is so much wider, as balls are coarse.
_ROOM = 2.0**-24


#: Parts of the range of a parameter, and parameters that are cut, where ζ* is enclosed.
_PARTS, _MOST_CUT = 8, 3


def prove_integral(
    design: Design, plants: Plants | None = None, disturbance: Sequence[Range] = ()
) -> Claim | None:
    """That the target is held without offset; None without integral action, or where it is local.

    With `plants` for every value of their parameters; with `disturbance`, one range per input, for
    every constant one of these, in place of all whose ζ* is within the limits.
    """
    if design.integral is None or 2 * design.loop.plant.m < design.loop.plant.n:
        return None
    loop, functions = design.loop, design.casimirs.functions
    obstacle = integral_obstacle(loop, functions, design.form.phi is None)
    if obstacle is not None or design.form.betas or not is_uncoupled(design):
        return Claim("integral", False, statements.INTEGRAL_IS_NOT_COVERED)
    plant = lagrangian(loop, design.units, plants)
    if plant is None:
        return Claim("integral", False, statements.INTEGRAL_IS_NOT_COVERED)
    terms = IntegralTerms(design, plant)
    if terms.xi_bar is None:
        return Claim("integral", False, statements.NO_INTEGRAL)
    resting = terms.resting(disturbance) if disturbance else None
    if resting is not None and not np.all(resting.magnitude < terms.limit):
        return Claim("integral", False, statements.INTEGRAL_IS_TOO_SMALL)
    found = searched(terms)
    if found is None:
        return Claim("integral", False, statements.NO_INTEGRAL)
    level = found.level * design.units.energy
    ranges = {str(s): tuple(map(to_text, side)) for s, side in plant.ranges.items()}
    data: dict[str, Any] = {
        "level": found.level,
        "half_widths": [float(v) for v in found.half_widths],
        **({"uncertain": {name: list(side) for name, side in ranges.items()}} if ranges else {}),
    }
    pushes = [tuple(map(to_text, side)) for side in disturbance]
    if resting is not None:
        data["disturbance"] = [list(side) for side in pushes]
        data["resting"] = [list(side) for side in zip(*told_outwards(resting), strict=True)]
    kept = [*range(terms.k), *range(loop.plant.n, loop.n)]
    box = {
        loop.states[i]: float(width * design.units.state[i])
        for i, width in zip(kept, found.half_widths, strict=True)
    }
    limits = [float(v) for v in design.integral.limit]
    text = statements.integral(level, box, limits, ranges, pushes)
    return Claim("integral", True, text, data)


def told_outwards(resting: Interval) -> tuple[list[float], list[float]]:
    """Ends a little farther out, so that other arithmetic can confirm them."""
    room = _ROOM * (1 + resting.magnitude)
    return (resting.lo - room).tolist(), (resting.hi + room).tolist()


def is_uncoupled(design: Design) -> bool:
    """Whether 𝒟 = diag(D, Dc), both symmetric."""
    m, damping = design.loop.plant.m, design.damping
    coupled = np.any(damping[:m, m:]) or np.any(damping[m:, :m])
    return not coupled and bool(np.array_equal(damping, damping.T))


class IntegralTerms(Remainders):
    """E_W and S over boxes."""

    def __init__(self, design: Design, plant: Lagrangian) -> None:
        super().__init__(design, plant)
        self.input_units = design.units.input

    @property
    def tau(self) -> float:
        """τ in natural units."""
        if self.design.integral is None:
            raise ValueError("no integral action")
        return float(self.design.integral.tau)

    @property
    def leads(self) -> Interval:
        """1/τ."""
        return 1.0 / point(self.tau)

    @property
    def limit(self) -> Vector:
        """|ζ| is at most this, (m,), in natural units."""
        if self.design.integral is None:
            raise ValueError("no integral action")
        return self.design.integral.limit

    def resting(self, disturbance: Sequence[Range]) -> Interval:
        """ζ* for every disturbance, in the units of the model, and every θ; (m,), natural units."""
        xi = self.xi_bar
        if xi is None:
            raise ValueError("ξ̄ is not enclosed")
        slope = self._hc(coordinates(xi[None])).grad[0]
        return -self.inputs_at_rest(disturbance) - matmul(transposed(self.Gc), slope[:, None])[:, 0]

    def inputs_at_rest(self, disturbance: Sequence[Range]) -> Interval:
        """(BᵀB)⁻¹Bᵀ∇U(q*; θ) − d, the u that holds q*, for the same; (m,), natural units."""
        units, m = self.input_units, self.m
        B = sp.Matrix(self.plant.B)
        force = (B.T * B).inv() * B.T * gradient(self.plant.U, self.plant.q).subs(self.there)
        theta = self.theta[None]
        cells = subdivide(self.theta, _PARTS) if 0 < len(self.theta.lo) <= _MOST_CUT else theta
        weight = matrix_enclosure(force, tuple(self.plant.ranges), cells)[..., 0]
        held = Interval(weight.lo.min(axis=0), weight.hi.max(axis=0))
        pushed = [tuple(map(constant, side)) for side in disturbance]
        d = Interval(
            np.array([lo.lo for lo, _ in pushed]).reshape(m),
            np.array([hi.hi for _, hi in pushed]).reshape(m),
        )
        return held - d * point(1 / units)

    @cached_property
    def _closed(self) -> sp.Expr:
        """Ũ + ½eᵀ(BDBᵀ + R − M/τ)e/τ, of q and θ."""
        tau, B, m = exact(self.tau), sp.Matrix(self.plant.B), self.m
        D = sp.Matrix(m, m, lambda i, j: exact(float(self.design.damping[i, j])))
        stiff = B * D * B.T + sp.Matrix(self.plant.R) - sp.Matrix(self.plant.M) / tau
        return sp.sympify(self.remainder + (self.e.T * stiff * self.e)[0, 0] / (2 * tau))

    def falls(self, Z: Interval) -> Truth:
        """Whether S ≻ 0 and M ≻ 0 on boxes (B, 2m + parameters)."""
        with np.errstate(all="ignore"):
            e, theta = Z[:, : self.k], Z[:, 2 * self.m :]
            at = beside(e + np.broadcast_to(self.q_star, e.shape), theta)
            inertia = self.inertia(at, e)[0]
            return np.asarray(positive_definite(self._form(Z)) & positive_definite(inertia))

    def _form(self, Z: Interval) -> Interval:
        """S over boxes, (B, 3m, 3m), in (q̇, e, ω) with ω = ∇H₀ − ∇K₀."""
        k, inverse = self.k, 1.0 / point(self.tau)
        e = Z[:, :k]
        theta = Z[:, 2 * self.m :]
        M, bent = self.inertia(beside(e + np.broadcast_to(self.q_star, e.shape), theta), e)
        U, h, bends = self.mean_slopes(Z)
        series, share = _in_series(h, bends)
        BGc = matmul(self.B, transposed(self.Gc))
        R = matrix_enclosure(self.plant.R, tuple(self.plant.ranges), theta)
        damped = matmul(matmul(self.B, self.D), transposed(self.B)) + R
        S_vv = damped - (M + bent) * inverse
        S_ee = (U + matmul(matmul(BGc, series), transposed(BGc))) * inverse
        S_ew = matmul(BGc, share) * (0.5 * inverse)
        S_ww = matmul(matmul(self.Gc, self.Dc), transposed(self.Gc))
        return _blocks(S_vv, S_ee, S_ew, S_ww, Z.shape[0])


def _in_series(h: Interval, k: Interval) -> tuple[Interval, Interval]:
    """h(h + k)⁻¹k, which is symmetric, and h(h + k)⁻¹; (B, m, m) each."""
    if h.shape[-1] == 1:
        share = (1.0 + k * h.reciprocal()).reciprocal()
        series = (h.reciprocal() + k.reciprocal()).reciprocal()
        positive = (h.lo > 0) & (k.lo > 0)
        bad = np.where(positive, 0.0, np.nan)
        return series + bad, share + bad
    other = solve(h + k, h)  # (h + k)⁻¹h
    return (h - matmul(h, other)).meet(matmul(k, other)), transposed(other)


def _blocks(vv: Interval, ee: Interval, ew: Interval, ww: Interval, boxes: int) -> Interval:
    m = vv.shape[-1]
    lo, hi = np.zeros((boxes, 3 * m, 3 * m)), np.zeros((boxes, 3 * m, 3 * m))
    first, second, third = slice(m), slice(m, 2 * m), slice(2 * m, None)
    for rows, columns, block in (
        (first, first, vv), (second, second, ee), (third, third, ww),
        (second, third, ew), (third, second, transposed(ew)),
    ):  # fmt: skip
        lo[:, rows, columns], hi[:, rows, columns] = block.lo, block.hi
    return Interval(lo, hi)
