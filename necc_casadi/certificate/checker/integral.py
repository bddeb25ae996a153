"""Integral action, proved again: E_W above the level on the sides, and S ≻ 0 where it is not.

With e = q − q*, ξ̃ = ξ − ξ̄, remainders Ũ, H₀, K₀ beyond first order, mean slopes a, h, k of ∇U, ∇Hc
and ∇K between rest and a point, η = GcBᵀe and ω = ∇H₀ − ∇K₀,

    E_W = Ũ + K₀ + H₀ + ½eᵀ(BDBᵀ + R − M/τ)e/τ,
    −Ẇ ≥ q̇ᵀ[BDBᵀ + R − (M + ½Σeᵢ∂ᵢM)/τ]q̇ + (1/τ){eᵀae + ηᵀh(h+k)⁻¹kη + ηᵀh(h+k)⁻¹ω} + ωᵀGcDcGcᵀω.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
import sympy as sp
from flint import arb, arb_mat

from necc_casadi.certificate.checker.arithmetic.balls import (
    Box,
    ball,
    by_bisection,
    ends,
    evaluate,
    times,
)
from necc_casadi.certificate.checker.arithmetic.definite import norm, positive, solve
from necc_casadi.certificate.checker.arithmetic.networks import Net
from necc_casadi.certificate.checker.evidence import Checked, Evidence
from necc_casadi.certificate.checker.loops import StoredInterconnection
from necc_casadi.certificate.checker.model import StoredDesign
from necc_casadi.certificate.checker.plants import StoredPlants, stated_ranges
from necc_casadi.certificate.claims import statements
from necc_casadi.symbolic.zero import is_zero

__all__ = ["check_integral"]


#: How often a cell may be halved.
_DEPTH = 24


#: Stretches of the way from rest to a point, along each of which slopes are enclosed.
_STRETCHES = (4, 16)


#: A number is its double within this share.
_ROUNDED = 2.0**-50


#: Radii of the ball in which ξ̄ is sought.
_RADII = tuple(2.0**-k for k in range(18))


def check_integral(
    evidence: Evidence, sound: bool, plant_file: Callable[[], str | None]
) -> Checked | None:
    """The claim about integral action; None where nothing is claimed.

    `sound`: the Casimirs, the structure and what is measured are proved. `plant_file` gives
    plant.json, with the parameters that the claim may be about.
    """
    model = evidence.model
    if not evidence.claimed("integral"):
        return None
    level = evidence.number("integral", "level")
    widths = [float(v) for v in evidence.claims["integral"].data["half_widths"]]
    limits = model.integral.stated if model.integral is not None else [0.0]
    kept = [*range(model.n // 2), *range(model.n, len(model.z))]
    sides = zip(kept, widths, strict=False)
    told = {model.states[i]: width * model.units.state[i] for i, width in sides}
    ranges = stated_ranges(evidence, "integral")
    text = statements.integral(level * model.units.energy, told, limits, ranges)
    if model.integral is None or not _is_covered(model):
        return Checked("integral", False, f"{text}; not proved: the plant and loop are covered")
    if len(widths) != 2 * model.m or not all(v > 0 for v in widths):
        return Checked("integral", False, f"{text}; not proved: a box of (e, ξ̃)")
    varied = StoredPlants(model, plant_file(), ranges) if ranges else None
    if varied is not None and not varied.fits(model):
        return Checked("integral", False, f"{text}; not proved: plant.json is of this design")
    fall = _Fall(model, level, varied)
    box: Box = tuple((-v, v) for v in widths) + fall.theta
    return Checked.by(
        "integral",
        text,
        [
            ("Casimirs, structure and measurement", lambda: sound),
            ("the box keeps the bounds of the model", partial(fall.keeps_bounds, box)),
            ("a minimum of Hc + K at q*", lambda: fall.xi_bar is not None),
            ("E_W above the level on the sides", partial(fall.is_closed, box)),
            ("S ≻ 0 where E_W is not above the level", partial(fall.falls_in, box)),
        ],
    )


def _is_covered(model: StoredDesign) -> bool:
    """q̇ measured, B regular and constant, the published loop, linear Casimirs, no coupling."""
    loop, (k, odd) = model.loop, divmod(model.n, 2)
    published = isinstance(loop, StoredInterconnection) and model.ahead is None
    if not published or odd or model.inertia is None or model.m != k or model.nc != k:
        return False
    if model.form["phi"] is not None or model.form["betas"] or len(model.casimirs) != k:
        return False
    q, p = model.z[:k], model.z[k : model.n]
    rates = model.J[:k, k : model.n]
    zero = [*model.J[:k, :k], *model.J[k : model.n, k : model.n], *model.R[:k, :],
            *model.R[:, :k], *model.G[:k, :], *(model.J + model.J.T)]  # fmt: skip
    own = slice(model.n, None)
    zero += [*model.Jcl[own, own], *model.Rcl[own, own]]
    zero += [sp.diff(c, s) for c in model.casimirs for s in p]
    constant = [*rates, *model.R[k:, k:], *model.G[k:, :], *model.ports[model.n :, k:]]
    constant += [sp.diff(c, s) for c in model.casimirs for s in (*q, *model.z[model.n :])]
    Gc, slopes = model.ports[model.n :, k:], _slopes(model)[:, k:]
    regular = [model.G[k:, :].det(), Gc.det(), slopes.det(), rates.det()]
    moves, m = set(model.z), model.m
    coupled = [model.damping[i][j] for i in range(m) for j in range(m, 2 * m)]
    coupled += [model.damping[j][i] for i in range(m) for j in range(m, 2 * m)]
    blocks = [[row[s] for row in model.damping[s]] for s in (slice(m), slice(m, 2 * m))]
    symmetric = all(b[i][j] == b[j][i] for b in blocks for i in range(m) for j in range(m))
    return (
        all(is_zero(v) is True for v in zero)
        and not any(moves & sp.sympify(v).free_symbols for v in constant)
        and all(is_zero(v) is False for v in regular)
        and symmetric
        and not any(coupled)
    )


def _slopes(model: StoredDesign) -> sp.Matrix:
    """∂c/∂(q, ξ), m × 2m."""
    symbols = (*model.z[: model.n // 2], *model.z[model.n :])
    return sp.Matrix([[sp.diff(c, s) for s in symbols] for c in model.casimirs])


def _constants(matrix: sp.Matrix) -> arb_mat:
    return arb_mat([[evaluate(sp.sympify(v), {}) for v in row] for row in matrix.tolist()])


class _Fall:
    """E_W and S over boxes of (e, ξ̃, θ), in natural units but for θ."""

    def __init__(self, model: StoredDesign, level: float, plants: StoredPlants | None) -> None:
        integral = model.integral
        if integral is None or model.inertia is None:
            raise ValueError("no integral action")
        self.model, self.level = model, arb(level)
        k = self.k = model.m
        self.q, self.xi = model.z[:k], model.z[model.n :]
        A = model.J[:k, k : model.n]
        rates = A.T.inv()  # y = Gᵀ∂H/∂p = BᵀA⁻¹q̇
        self.tau = arb(integral.tau)
        H, friction, inertia = model.H, model.R, model.inertia
        if plants is not None:
            H, friction, inertia = plants.H, plants.R, plants.inertia
        B, R = rates * model.G[k:, :], rates * friction[k:, k:] * A.inv()
        self.M = rates * inertia
        self.U = H.subs(dict.fromkeys(model.z[k : model.n], 0))
        self.R = R
        self.symbols = () if plants is None else tuple(plants.ranges)
        sides = () if plants is None else plants.ranges.values()
        self.theta: Box = tuple(
            (ends(evaluate(lo, {}))[0], ends(evaluate(hi, {}))[1]) for lo, hi in sides
        )
        self.B, self.Gc = _constants(B), _constants(model.ports[model.n :, k:])
        D, Dc = (
            arb_mat([[arb(v) for v in row[s]] for row in model.damping[s]])
            for s in (slice(k), slice(k, 2 * k))
        )
        self.damping = self.B * D * self.B.transpose()
        self.inner = self.Gc * Dc * self.Gc.transpose()
        self.slopes = _constants(_slopes(model))
        start = [sp.Integer(0)] * (2 * k)
        symbols = (*self.q, *self.xi)
        self.offset = [
            evaluate(c.subs(dict(zip(symbols, start, strict=True))), {}) for c in model.casimirs
        ]
        self.hc, used = Net.from_weights(model.form["hc"], model.weights)
        self.kc, _ = Net.from_weights(model.form["k"], model.weights[used:])
        #: The target as a double, whichever way it was rounded.
        self.q_star = [
            v + ball(-_ROUNDED, _ROUNDED) * v.abs_upper()
            for v in (evaluate(t, {}) for t in model.target[:k])
        ]
        grad = [sp.diff(self.U, s) for s in self.q]
        self.grad_U, self.hess_U = grad, [[sp.diff(g, s) for s in self.q] for g in grad]
        self.bent = [self.M.diff(s) for s in self.q]
        self.xi_bar = self._minimum()
        if self.xi_bar is not None:
            self.rest = self._rest()

    # --- where it rests -----------------------------------------------------------------------

    def _minimum(self) -> list[arb] | None:
        """ξ̄, the minimum of Hc(ξ) + K(c(q*, ξ)) in ξ."""
        xi = [arb(v) for v in self.model.xi_star]
        g = norm(self._slope_xi(xi)).upper()
        for radius in _RADII:
            box = [v + ball(-radius, radius) for v in xi]
            hess = self._hess_xi(box)
            middle = arb_mat([[arb(v.mid()) for v in row] for row in self._hess_xi(xi).tolist()])
            least = _least(middle) / 2
            if least > 0 and positive(hess, least) and g < arb(least) * radius:
                away = (g / arb(least)).upper()
                return [v + (-away).union(away) for v in xi]
        return None

    def _c(self, q: list[arb], xi: list[arb]) -> list[arb]:
        found = self.slopes * arb_mat([[v] for v in (*q, *xi)])
        return [found[i, 0] + self.offset[i] for i in range(self.k)]

    def _slope_xi(self, xi: list[arb]) -> list[arb]:
        dk = self.kc(_box(self._c(self.q_star, xi)))[1]
        dh = self.hc(_box(xi))[1]
        N = self.slopes
        return [
            dh[i] + sum((N[j, self.k + i] * dk[j] for j in range(self.k)), arb(0))
            for i in range(self.k)
        ]

    def _hess_xi(self, xi: list[arb]) -> arb_mat:
        return self._full(self.hc, xi) + self._springs_k(self._c(self.q_star, xi))

    def _full(self, net: Net, at: list[arb]) -> arb_mat:
        hess, k = net(_box(at))[2], self.k
        return arb_mat([[hess[min(i, j), max(i, j)] for j in range(k)] for i in range(k)])

    def _springs_k(self, c: list[arb]) -> arb_mat:
        """N_ξ ∇²K N_ξᵀ."""
        k = self.k
        N = arb_mat([[self.slopes[i, k + j] for j in range(k)] for i in range(k)])
        return N.transpose() * self._full(self.kc, c) * N

    def _rest(self) -> tuple[arb, list[arb]]:
        """Hc + K and its slopes in q at rest; those in ξ are 0 there."""
        xi = self.xi_bar or []
        c = self._c(self.q_star, xi)
        k_value, dk, _ = self.kc(_box(c))
        along = [
            sum((self.slopes[j, i] * dk[j] for j in range(self.k)), arb(0)) for i in range(self.k)
        ]
        return self.hc(_box(xi))[0] + k_value, along

    def _known(self, box: Box) -> dict[sp.Symbol, arb]:
        """θ over a box of (e, ξ̃, θ)."""
        return {s: ball(*side) for s, side in zip(self.symbols, box[2 * self.k :], strict=True)}

    # --- the box ------------------------------------------------------------------------------

    def keeps_bounds(self, box: Box) -> bool:
        """Whether every bound that the model names is outside."""
        model, k = self.model, self.k
        at = [*self.q_star, *(arb(v) for v in model.xi_star)]
        places = [*range(k), *range(model.n, len(model.z))]
        for (lo, hi), middle, place in zip(box[: 2 * k], at, places, strict=True):
            low, high = model.named_bounds[place]
            if not (middle + arb(lo) > low and middle + arb(hi) < high):
                return False
        return True

    def is_closed(self, box: Box) -> bool:
        """E_W > c on every side."""
        faces = (
            (*box[:i], (end, end), *box[i + 1 :])
            for i, side in enumerate(box[: 2 * self.k])
            for end in side
        )
        return all(by_bisection(face, self._is_high, _DEPTH) for face in faces)

    def falls_in(self, box: Box) -> bool:
        """E_W > c or S ≻ 0 on cells that cover the box."""
        return by_bisection(box, lambda cell: self._is_high(cell) or self._falls(cell), _DEPTH)

    def _is_high(self, box: Box) -> bool:
        return bool(self._energy(box) > self.level)

    def _energy(self, box: Box) -> arb:
        """E_W over a box: value at the middle and slopes over the box; θ is not centred."""
        at = tuple((m, m) for m in (lo / 2 + hi / 2 for lo, hi in box[: 2 * self.k]))
        middle: Box = at + box[2 * self.k :]
        value = self._value_and_slopes(middle)[0]
        if middle == box:
            return value
        slopes = self._value_and_slopes(box)[1]
        for (lo, hi), (m, _), slope in zip(box[: 2 * self.k], at, slopes, strict=True):
            value = value + slope * (ball(lo, hi) - arb(m))
        return value

    def _value_and_slopes(self, box: Box) -> tuple[arb, list[arb]]:
        k, (level, along) = self.k, self.rest
        known, rest_q = self._known(box), dict(zip(self.q, self.q_star, strict=True))
        U0 = evaluate(self.U, rest_q | known)
        grad0 = [evaluate(g, rest_q | known) for g in self.grad_U]
        xi_bar = self.xi_bar or []
        e = [ball(*side) for side in box[:k]]
        q = [v + s for v, s in zip(self.q_star, e, strict=True)]
        xi = [v + ball(*side) for v, side in zip(xi_bar, box[k : 2 * k], strict=True)]
        k_value, dk, _ = self.kc(_box(self._c(q, xi)))
        h_value, dh, _ = self.hc(_box(xi))
        there = dict(zip(self.q, q, strict=True)) | known
        stiff = self._damped(known) - self._inertia(there) * (1 / self.tau)
        forces = (stiff * arb_mat([[v] for v in e])).tolist()
        value = evaluate(self.U, there) - U0 + k_value + h_value - level
        slopes = []
        for i in range(k):
            value = value - (grad0[i] + along[i]) * e[i] + e[i] * forces[i][0] / (2 * self.tau)
            own = evaluate(self.grad_U[i], there) - grad0[i] - along[i] + forces[i][0] / self.tau
            bent = _constants_at(self.bent[i], there)
            turned = (arb_mat([e]) * bent * arb_mat([[v] for v in e]))[0, 0]
            own = own - turned / (2 * self.tau * self.tau)
            slopes.append(own + sum((self.slopes[j, i] * dk[j] for j in range(k)), arb(0)))
        for i in range(k):
            pull = sum((self.slopes[j, k + i] * dk[j] for j in range(k)), arb(0))
            slopes.append(dh[i] + pull)
        return value, slopes

    def _damped(self, known: dict[sp.Symbol, arb]) -> arb_mat:
        """BDBᵀ + R."""
        return self.damping + _constants_at(self.R, known)

    def _inertia(self, there: dict[sp.Symbol, arb]) -> arb_mat:
        return _constants_at(self.M, there)

    def _falls(self, box: Box) -> bool:
        """M ≻ 0 and S ≻ 0 over a box, in (q̇, e, ω), in few stretches or in many."""
        return any(self._is_positive(box, stretches) for stretches in _STRETCHES)

    def _is_positive(self, box: Box, stretches: int) -> bool:
        k, tau = self.k, self.tau
        e = [ball(*side) for side in box[:k]]
        known = self._known(box)
        here = {s: v + d for s, v, d in zip(self.q, self.q_star, e, strict=True)} | known
        a, h, bends = self._mean_slopes(box, stretches)
        found = _in_series(h, bends)
        if found is None:
            return False
        series, share = found
        M = self._inertia(here)
        if not positive(M, 0.0):
            return False
        for i, d in enumerate(e):
            M = M + _constants_at(self.bent[i], here) * (d / 2)
        BGc = self.B * self.Gc.transpose()
        vv = self._damped(known) - M * (1 / tau)
        ee = (a + BGc * series * BGc.transpose()) * (1 / tau)
        ew = BGc * share * (1 / (2 * tau))
        S = arb_mat(3 * k, 3 * k)
        for i in range(k):
            for j in range(k):
                S[i, j], S[k + i, k + j] = vv[i, j], ee[i, j]
                S[2 * k + i, 2 * k + j] = self.inner[i, j]
                S[k + i, 2 * k + j] = S[2 * k + j, k + i] = ew[i, j]
        return positive(S, 0.0)

    def _mean_slopes(self, box: Box, stretches: int) -> tuple[arb_mat, arb_mat, arb_mat]:
        """∇²U, ∇²Hc and N_ξ∇²K N_ξᵀ, averaged along straight ways from rest into the box."""
        k, xi_bar = self.k, self.xi_bar or []
        total = [arb_mat(k, k) for _ in range(3)]
        for part in range(stretches):
            share = arb(part) / stretches
            share = share.union(arb(part + 1) / stretches)
            steps = [times(share, ball(*side)) for side in box[: 2 * k]]
            q = [v + d for v, d in zip(self.q_star, steps[:k], strict=True)]
            xi = [v + d for v, d in zip(xi_bar, steps[k:], strict=True)]
            there = dict(zip(self.q, q, strict=True)) | self._known(box)
            a = arb_mat([[evaluate(v, there) for v in row] for row in self.hess_U])
            found = a, self._full(self.hc, xi), self._springs_k(self._c(q, xi))
            total = [old + new / stretches for old, new in zip(total, found, strict=True)]
        return total[0], total[1], total[2]


def _constants_at(matrix: sp.Matrix, values: dict[sp.Symbol, arb]) -> arb_mat:
    return arb_mat([[evaluate(sp.sympify(v), values) for v in row] for row in matrix.tolist()])


def _box(values: list[arb]) -> Box:
    return tuple(ends(v) for v in values)


def _least(A: arb_mat) -> float:
    return float(np.linalg.eigvalsh([[float(v.mid()) for v in row] for row in A.tolist()])[0])


def _in_series(h: arb_mat, k: arb_mat) -> tuple[arb_mat, arb_mat] | None:
    """h(h + k)⁻¹k and h(h + k)⁻¹."""
    size = h.nrows()
    if size == 1:
        if not (h[0, 0] > 0 and k[0, 0] > 0):
            return None
        share = 1 / (1 + k[0, 0] / h[0, 0])
        return arb_mat([[1 / (1 / h[0, 0] + 1 / k[0, 0])]]), arb_mat([[share]])
    columns = [solve(h + k, [h[i, j] for i in range(size)]) for j in range(size)]
    if any(column is None for column in columns):
        return None
    other = arb_mat([[(columns[j] or [])[i] for j in range(size)] for i in range(size)])
    return k * other, other.transpose()
