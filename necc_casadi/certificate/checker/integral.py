"""Integral action, proved again: E_W above the level on the sides, and S ≻ 0 where it is not.

With e = q − q*, ξ̃ = ξ − ξ̄, remainders Ũ, H₀, K₀ beyond first order, mean slopes a, h, k of ∇U, ∇Hc
and ∇K between rest and a point, η = GcBᵀe and ω = ∇H₀ − ∇K₀,

    E_W = Ũ + K₀ + H₀ + ½eᵀ(BDBᵀ + R − M/τ)e/τ,
    −Ẇ ≥ q̇ᵀ[BDBᵀ + R − (M + ½Σeᵢ∂ᵢM)/τ]q̇ + (1/τ){eᵀae + ηᵀh(h+k)⁻¹kη + ηᵀh(h+k)⁻¹ω} + ωᵀGcDcGcᵀω.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import sympy as sp
from flint import arb, arb_mat

from necc_casadi.certificate.checker.arithmetic.balls import (
    Box,
    ball,
    by_bisection,
    ends,
    evaluate,
)
from necc_casadi.certificate.checker.arithmetic.definite import positive, solve
from necc_casadi.certificate.checker.evidence import Checked, Evidence
from necc_casadi.certificate.checker.loops import StoredInterconnection
from necc_casadi.certificate.checker.model import StoredDesign
from necc_casadi.certificate.checker.plants import StoredPlants, stated_ranges
from necc_casadi.certificate.checker.remainders import StoredRemainders, casimir_slopes, matrix_at
from necc_casadi.certificate.claims import statements
from necc_casadi.symbolic.expressions import parse
from necc_casadi.symbolic.zero import is_zero

__all__ = ["check_integral", "is_covered", "is_of_the_kind", "stated_disturbance"]


#: How often a cell of parameters may be halved where ζ* is enclosed.
_DEPTH = 16


def check_integral(
    evidence: Evidence, sound: bool, plant_file: Callable[[], str | None]
) -> Checked | None:
    """The claim about integral action; None where nothing is claimed.

    `sound`: the Casimirs, the structure and what is measured are proved. `plant_file` gives
    plant.json, with the parameters that the claim may be about.
    """
    model = evidence.model
    if not evidence.claimed("integral"):
        if model.integral is None or evidence.claimed("local_integral"):
            return (
                None  # elsewhere; what else is claimed of solutions would be of the loop with ζ = 0
            )
        return Checked("integral", False, "nothing is claimed of the integral action of the design")
    level = evidence.number("integral", "level")
    widths = [float(v) for v in evidence.claims["integral"].data["half_widths"]]
    limits = model.integral.stated if model.integral is not None else [0.0]
    kept = [*range(model.n // 2), *range(model.n, len(model.z))]
    sides = zip(kept, widths, strict=False)
    told = {model.states[i]: width * model.units.state[i] for i, width in sides}
    ranges, pushes = stated_ranges(evidence, "integral"), stated_disturbance(evidence, "integral")
    text = statements.integral(level * model.units.energy, told, limits, ranges, pushes)
    if model.integral is None or not is_covered(model):
        return Checked("integral", False, f"{text}; not proved: the plant and loop are covered")
    if len(widths) != 2 * model.m or not all(v > 0 for v in widths):
        return Checked("integral", False, f"{text}; not proved: a box of (e, ξ̃)")
    varied = StoredPlants(model, plant_file(), ranges) if ranges else None
    if varied is not None and not varied.fits(model):
        return Checked("integral", False, f"{text}; not proved: plant.json is of this design")
    if pushes and len(pushes) != model.m:
        return Checked("integral", False, f"{text}; not proved: a disturbance of each input")
    fall = _Fall(model, level, varied)
    box: Box = tuple((-v, v) for v in widths) + fall.theta
    return Checked.by(
        "integral",
        text,
        [
            ("Casimirs, structure and measurement", lambda: sound),
            ("the box keeps the bounds of the model", partial(fall.keeps_bounds, box)),
            ("a minimum of Hc + K at q*", lambda: fall.xi_bar is not None),
            ("ζ* of every disturbance", lambda: not pushes or fall.has_room(evidence, pushes)),
            ("M ≻ 0 in the box", partial(fall.has_mass, box)),
            ("E_W above the level on the sides", partial(fall.is_closed, box)),
            ("S ≻ 0 where E_W is not above the level", partial(fall.falls_in, box)),
            ("the momenta keep the bounds of the model", partial(fall.keeps_momenta, box)),
        ],
    )


def stated_disturbance(evidence: Evidence, claim: str) -> list[tuple[str, str]]:
    """Ranges of disturbances that a claim is about, by input; none: all that ζ can hold."""
    sides = evidence.claims[claim].data.get("disturbance", [])
    return [(str(lo), str(hi)) for lo, hi in sides]


def is_covered(model: StoredDesign, *, coupled: bool = False) -> bool:
    """The loop is :func:`is_of_the_kind`, with an input for each coordinate."""
    return 2 * model.m == model.n and is_of_the_kind(model, coupled=coupled)


def is_of_the_kind(model: StoredDesign, *, coupled: bool = False) -> bool:
    """q̇ measured, B constant, its columns independent, the published loop, linear Casimirs.

    The two ports are damped apart, by symmetric matrices, unless they may be coupled.
    """
    loop, m, (k, odd) = model.loop, model.m, divmod(model.n, 2)
    published = isinstance(loop, StoredInterconnection) and model.ahead is None
    if not published or odd or model.inertia is None or m > k or model.nc != m:
        return False
    if model.form["phi"] is not None or model.form["betas"] or len(model.casimirs) != m:
        return False
    q, p = model.z[:k], model.z[k : model.n]
    rates = model.J[:k, k : model.n]
    zero = [*model.J[:k, :k], *model.J[k : model.n, k : model.n], *model.R[:k, :],
            *model.R[:, :k], *model.G[:k, :], *(model.J + model.J.T)]  # fmt: skip
    own = slice(model.n, None)
    zero += [*model.Jcl[own, own], *model.Rcl[own, own]]
    zero += [sp.diff(c, s) for c in model.casimirs for s in p]
    constant = [*rates, *model.R[k:, k:], *model.G[k:, :], *model.ports[model.n :, m:]]
    constant += [sp.diff(c, s) for c in model.casimirs for s in (*q, *model.z[model.n :])]
    Gc, slopes, B = model.ports[model.n :, m:], casimir_slopes(model)[:, k:], model.G[k:, :]
    regular = [(B.T * B).det(), Gc.det(), slopes.det(), rates.det()]
    moves = set(model.z)
    ties = [model.damping[i][j] for i in range(m) for j in range(m, 2 * m)]
    ties += [model.damping[j][i] for i in range(m) for j in range(m, 2 * m)]
    blocks = [[row[s] for row in model.damping[s]] for s in (slice(m), slice(m, 2 * m))]
    symmetric = all(b[i][j] == b[j][i] for b in blocks for i in range(m) for j in range(m))
    return (
        all(is_zero(v) is True for v in zero)
        and not any(moves & sp.sympify(v).free_symbols for v in constant)
        and all(is_zero(v) is False for v in regular)
        and (coupled or (symmetric and not any(ties)))
    )


class _Fall(StoredRemainders):
    """E_W and S over boxes."""

    def __init__(self, model: StoredDesign, level: float, plants: StoredPlants | None) -> None:
        if model.integral is None:
            raise ValueError("no integral action")
        super().__init__(model, level, plants)
        self.tau, k = arb(model.integral.tau), self.k
        D, Dc = (
            arb_mat([[arb(v) for v in row[s]] for row in model.damping[s]])
            for s in (slice(k), slice(k, 2 * k))
        )
        self.damping = self.B * D * self.B.transpose()
        self.inner = self.Gc * Dc * self.Gc.transpose()
        self.limit = model.integral.limit
        self.by_theta = [(self.M.diff(s), self.R.diff(s)) for s in self.symbols]

    @property
    def leads(self) -> arb:
        """1/τ."""
        return 1 / self.tau

    def has_room(self, evidence: Evidence, disturbance: Sequence[Sequence[str]]) -> bool:
        """ζ* = d − B⁻¹∇U(q*) − Gcᵀ∇Hc(ξ̄) as told for all θ and d, 0 among these, and in ±limit."""
        k, scale = self.k, self.model.input_units
        told = [(float(lo), float(hi)) for lo, hi in evidence.claims["integral"].data["resting"]]
        if len(told) != k or not all(-b < lo and hi < b for (lo, hi), b in
                                     zip(told, self.limit, strict=True)):  # fmt: skip
            return False
        ends_of = [[parse(v, {}) for v in side] for side in disturbance]
        if not all(bool(lo <= 0) and bool(hi >= 0) for lo, hi in ends_of):
            return False
        d = [
            [evaluate(v, {}) / arb(unit) for v in side]
            for side, unit in zip(ends_of, scale, strict=True)
        ]
        slope = arb_mat([[v] for v in self.hc(tuple(map(ends, self.xi_bar or [])))[1]])
        own = (self.Gc.transpose() * slope).tolist()

        def within(cell: Box) -> bool:
            known = dict(zip(self.symbols, (ball(*side) for side in cell), strict=True))
            there = dict(zip(self.q, self.q_star, strict=True)) | known
            force = arb_mat([[evaluate(g, there)] for g in self.grad_U])
            held = (self.B.inv() * force).tolist()
            off = [held[i][0] + own[i][0] for i in range(k)]
            sides = zip(d, off, told, strict=True)
            return all(bool(a - v > lo) and bool(b - v < hi) for (a, b), v, (lo, hi) in sides)

        return by_bisection(self.theta, within, _DEPTH)

    def added(
        self, there: dict[sp.Symbol, arb], known: dict[sp.Symbol, arb], e: list[arb]
    ) -> tuple[arb, list[arb]]:
        """½eᵀ(BDBᵀ + R − M/τ)e/τ and its slopes in q and θ."""
        tau = self.tau
        stiff = self._damped(known) - self.inertia(there) * (1 / tau)
        column = arb_mat([[v] for v in e])
        forces = (stiff * column).tolist()
        value = sum((v * f[0] for v, f in zip(e, forces, strict=True)), arb(0)) / (2 * tau)
        turned = [(arb_mat([e]) * matrix_at(M, there) * column)[0, 0] for M in self.bent]
        slopes = [f[0] / tau - v / (2 * tau * tau) for f, v in zip(forces, turned, strict=True)]
        for heavier, rougher in self.by_theta:
            stiffer = matrix_at(rougher, known) - matrix_at(heavier, there) * (1 / tau)
            slopes.append((arb_mat([e]) * stiffer * column)[0, 0] / (2 * tau))
        return value, slopes

    def _damped(self, known: dict[sp.Symbol, arb]) -> arb_mat:
        """BDBᵀ + R."""
        return self.damping + matrix_at(self.R, known)

    def is_positive(self, box: Box, stretches: int) -> bool:
        """M ≻ 0 and S ≻ 0 over a box, in (q̇, e, ω)."""
        k, tau = self.k, self.tau
        e = [ball(*side) for side in box[:k]]
        known = self.known(box)
        here = {s: v + d for s, v, d in zip(self.q, self.q_star, e, strict=True)} | known
        a, h, bends = self.mean_slopes(box, stretches)
        found = _in_series(h, bends)
        if found is None:
            return False
        series, share = found
        M = self.inertia(here)
        if not positive(M, 0.0):
            return False
        for i, d in enumerate(e):
            M = M + matrix_at(self.bent[i], here) * (d / 2)
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
