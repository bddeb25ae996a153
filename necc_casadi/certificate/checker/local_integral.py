"""Integral action near the target of a plant with fewer inputs than coordinates, proved again.

With x = (e, q̇, ξ̃, ζ̃), h = ∇²Hc and κ = N_ξ∇²K N_ξᵀ at rest, V = BGcᵀ and L = GcDcGcᵀ,

    ẋ = [0, I, 0, 0;  −M⁻¹a, −M⁻¹(R + BDBᵀ), −M⁻¹Vh, −M⁻¹B;  LκVᵀ, Vᵀ, −L(h + κ), 0;
         KᵢBᵀ, τKᵢBᵀ, 0, 0]x + o(x),    a = ∇²U(q*; θ),

for every θ and constant d, where the rows that no input reaches are at rest at q* for every θ.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cached_property

import numpy as np
import sympy as sp
from flint import arb, arb_mat

from necc_casadi.certificate.checker.arithmetic.balls import (
    Box,
    ball,
    by_bisection,
    ends,
    evaluate,
    widths,
)
from necc_casadi.certificate.checker.arithmetic.definite import (
    hurwitz,
    middle_of,
    norm,
    positive,
)
from necc_casadi.certificate.checker.arithmetic.networks import Derivatives, Net
from necc_casadi.certificate.checker.evidence import Checked, Evidence
from necc_casadi.certificate.checker.integral import is_of_the_kind, stated_disturbance
from necc_casadi.certificate.checker.model import StoredDesign
from necc_casadi.certificate.checker.plants import StoredPlants, stated_ranges
from necc_casadi.certificate.checker.remainders import casimir_slopes, constants, matrix_at
from necc_casadi.certificate.claims import statements
from necc_casadi.symbolic.expressions import parse
from necc_casadi.symbolic.zero import is_zero

__all__ = ["check_local_integral"]


#: How often a cell of parameters may be halved.
_DEPTH = 16


#: Radii of the ball in which ξ̄ is sought.
_RADII = tuple(2.0**-k for k in range(18))


def check_local_integral(
    evidence: Evidence, sound: bool, plant_file: Callable[[], str | None]
) -> Checked:
    """The claim that the target is held near it without offset.

    `sound`: the Casimirs, the structure and what is measured are proved. `plant_file` gives
    plant.json, with the parameters that the claim may be about.
    """
    model, name = evidence.model, "local_integral"
    limits = model.integral.stated if model.integral is not None else [0.0]
    ranges, pushes = stated_ranges(evidence, name), stated_disturbance(evidence, name)
    text = statements.local_integral(limits, ranges, pushes, model.stated_limits or ())
    if model.integral is None or not is_of_the_kind(model):
        return Checked(name, False, f"{text}; not proved: the plant and loop are covered")
    varied = StoredPlants(model, plant_file(), ranges) if ranges else None
    if varied is not None and not varied.fits(model):
        return Checked(name, False, f"{text}; not proved: plant.json is of this design")
    if pushes and len(pushes) != model.m:
        return Checked(name, False, f"{text}; not proved: a disturbance of each input")
    rest = _Rest(model, varied)
    return Checked.by(
        name,
        text,
        [
            ("Casimirs, structure and measurement", lambda: sound),
            ("q* is a rest for every parameter", lambda: rest.is_held),
            ("a minimum of Hc + K at q*", lambda: rest.xi_bar is not None),
            (
                "ζ* and u of every disturbance",
                lambda: not pushes or rest.has_room(evidence, pushes),
            ),
            ("the Lyapunov inequality at rest", rest.is_stable),
        ],
    )


class _Rest:
    """The loop at rest, in natural units but for θ."""

    def __init__(self, model: StoredDesign, plants: StoredPlants | None) -> None:
        if model.integral is None or model.inertia is None:
            raise ValueError("no integral action, or the states are measured")
        self.model, self.integral = model, model.integral
        k = self.k = model.n // 2
        self.q = model.z[:k]
        A = model.J[:k, k : model.n]
        rates = A.T.inv()  # y = Gᵀ∂H/∂p = BᵀA⁻¹q̇
        H, friction, inertia = model.H, model.R, model.inertia
        if plants is not None:
            H, friction, inertia = plants.H, plants.R, plants.inertia
        self.exact_B, self.M = rates * model.G[k:, :], rates * inertia
        self.R = rates * friction[k:, k:] * A.inv()
        U = H.subs(dict.fromkeys(model.z[k : model.n], 0))
        self.slope = sp.Matrix([sp.diff(U, s) for s in self.q])
        self.stiffness = self.slope.jacobian(list(self.q))
        self.symbols = () if plants is None else tuple(plants.ranges)
        sides = () if plants is None else plants.ranges.values()
        self.theta: Box = tuple(
            (ends(evaluate(lo, {}))[0], ends(evaluate(hi, {}))[1]) for lo, hi in sides
        )
        self.B, self.Gc = constants(self.exact_B), constants(model.ports[model.n :, model.m :])
        self.slopes = constants(casimir_slopes(model))
        origin = dict.fromkeys((*self.q, *model.z[model.n :]), sp.Integer(0))
        self.offset = [evaluate(c.subs(origin), {}) for c in model.casimirs]
        self.hc, used = Net.from_weights(model.form["hc"], model.weights)
        self.kc, _ = Net.from_weights(model.form["k"], model.weights[used:])
        self.q_star = [evaluate(t, {}) for t in model.target[:k]]
        free = [[-math.inf, math.inf]] * model.m
        self.input_limits = [[arb(v) for v in side] for side in model.u_limits or free]
        self.xi_bar = self._minimum()

    @property
    def is_held(self) -> bool:
        """Whether no row that no input reaches is pulled at q*, whatever θ."""
        there = dict(zip(self.q, self.model.target[: self.k], strict=True))
        pull, B = self.slope.subs(there), self.exact_B
        left = pull - B * (B.T * B).inv() * B.T * pull
        return all(is_zero(v) is True for v in left)

    # --- ξ̄ and the springs ----------------------------------------------------------------------

    def _nets(self, xi: list[arb]) -> tuple[Derivatives, Derivatives]:
        c = self.slopes * arb_mat([[v] for v in (*self.q_star, *xi)])
        at = tuple(ends(c[i, 0] + v) for i, v in enumerate(self.offset))
        return self.hc(tuple(map(ends, xi))), self.kc(at)

    def _springs(self, xi: list[arb]) -> tuple[arb_mat, arb_mat]:
        """∇²Hc and N_ξ∇²K N_ξᵀ."""
        found, size = [], range(self.model.m)
        for _, _, hess in self._nets(xi):
            found.append(arb_mat([[hess[min(i, j), max(i, j)] for j in size] for i in size]))
        N = arb_mat([[self.slopes[i, self.k + j] for j in size] for i in size])
        return found[0], N.transpose() * found[1] * N

    def _minimum(self) -> list[arb] | None:
        """ξ̄, the minimum of Hc(ξ) + K(c(q*, ξ)) in ξ."""
        xi, size = [arb(v) for v in self.model.xi_star], range(self.model.m)
        (_, dh, _), (_, dk, _) = self._nets(xi)
        g = norm(
            [dh[i] + sum((self.slopes[j, self.k + i] * dk[j] for j in size), arb(0)) for i in size]
        ).upper()
        least = _least(sum(self._springs(xi), arb_mat(len(xi), len(xi)))) / 2
        for radius in _RADII:
            h, k = self._springs([v + ball(-radius, radius) for v in xi])
            if least > 0 and positive(h + k, least) and g < arb(least) * radius:
                away = (g / arb(least)).upper()
                return [v + (-away).union(away) for v in xi]
        return None

    # --- what is to be proved -------------------------------------------------------------------

    def has_room(self, evidence: Evidence, disturbance: list[tuple[str, str]]) -> bool:
        """For all θ and d u = (BᵀB)⁻¹Bᵀ∇U(q*) − d and ζ* = −u − Gcᵀ∇Hc(ξ̄) as told: in limits."""
        told = evidence.claims["local_integral"].data["resting"]
        sides = [(float(lo), float(hi)) for lo, hi in told]
        limits, m = self.integral.limit, self.model.m
        if len(sides) != m or not all(
            -b < lo and hi < b for (lo, hi), b in zip(sides, limits, strict=True)
        ):
            return False
        pushed = [[parse(v, {}) for v in side] for side in disturbance]
        if not all(bool(lo <= 0) and bool(hi >= 0) for lo, hi in pushed):
            return False
        scale = zip(pushed, self.model.input_units, strict=True)
        d = [[evaluate(v, {}) / arb(unit) for v in side] for side, unit in scale]
        slope = arb_mat([[v] for v in self._nets(self.xi_bar or [])[0][1]])
        own, across = (self.Gc.transpose() * slope).tolist(), self.B.transpose()

        def within(cell: Box) -> bool:
            force = matrix_at(self.slope, self._there(cell))
            held = ((across * self.B).inv() * (across * force)).tolist()
            return all(
                bool(a - v - y > lo and b - v - y < hi and v - b > low and v - a < high)
                for (v,), (y,), (a, b), (lo, hi), (low, high) in zip(
                    held, own, d, sides, self.input_limits, strict=True
                )
            )

        return by_bisection(self.theta, within, _DEPTH, sizes=widths(self.theta))

    def is_stable(self) -> bool:
        """AᵀP + PA ≺ 0 with P ≻ 0, one P for each of the cells that cover θ."""

        def decays(cell: Box) -> bool:
            return hurwitz(self._linearised(cell))

        return by_bisection(self.theta, decays, _DEPTH, sizes=widths(self.theta))

    def _there(self, cell: Box) -> dict[sp.Symbol, arb]:
        known = {s: ball(*side) for s, side in zip(self.symbols, cell, strict=True)}
        return dict(zip(self.q, self.q_star, strict=True)) | known

    @cached_property
    def _at_rest(self) -> tuple[arb_mat, arb_mat]:
        return self._springs(self.xi_bar or [])

    @cached_property
    def _inverse(self) -> sp.Matrix:
        """M⁻¹ at q*, of θ, as quotients that name each θ as seldom as they can."""
        there = dict(zip(self.q, self.model.target[: self.k], strict=True))
        return self.M.subs(there).inv().applyfunc(sp.factor)

    def _linearised(self, cell: Box) -> arb_mat:
        model, k, m, there = self.model, self.k, self.model.m, self._there(cell)
        D, Dc = (
            arb_mat([[arb(v) for v in row[s]] for row in model.damping[s]])
            for s in (slice(m), slice(m, 2 * m))
        )
        h, bends = self._at_rest
        B, Y = self.B, self.B * self.Gc.transpose()
        inverse = matrix_at(self._inverse, there)
        damped = matrix_at(self.R, there) + B * D * B.transpose()
        leak = self.Gc * Dc * self.Gc.transpose()
        gain = arb_mat(m, m)
        for i, value in enumerate(self.integral.gain):
            gain[i, i] = arb(value)
        pulled = gain * B.transpose()
        one = arb_mat(k, k)
        for i in range(k):
            one[i, i] = arb(1)
        blocks = {
            (0, 1): one,
            (1, 0): -(inverse * matrix_at(self.stiffness, there)),
            (1, 1): -(inverse * damped),
            (1, 2): -(inverse * Y * h),
            (1, 3): -(inverse * B),
            (2, 0): leak * bends * Y.transpose(),
            (2, 1): Y.transpose(),
            (2, 2): -(leak * (h + bends)),
            (3, 0): pulled,
            (3, 1): pulled * arb(self.integral.tau),
        }
        first = [0, k, 2 * k, 2 * k + m]
        A = arb_mat(2 * (k + m), 2 * (k + m))
        for (row, column), block in blocks.items():
            for i in range(block.nrows()):
                for j in range(block.ncols()):
                    A[first[row] + i, first[column] + j] = block[i, j]
        return A


def _least(A: arb_mat) -> float:
    return float(np.linalg.eigvalsh(middle_of(A))[0])
