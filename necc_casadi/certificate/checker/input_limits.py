"""Input limits over boxes of the states that are no momenta: u of Lemma EnergyCasimirControl."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import sympy as sp
from flint import arb, arb_mat

from necc_casadi.certificate.checker.arithmetic.balls import Box, ball, by_bisection, evaluate
from necc_casadi.certificate.checker.arithmetic.potential import Energy
from necc_casadi.certificate.checker.evidence import Checked, Evidence
from necc_casadi.certificate.checker.model import StoredDesign
from necc_casadi.certificate.checker.region.proof import RegionProof
from necc_casadi.certificate.claims import statements

__all__ = ["InputProof", "check_clipping", "check_input_limits"]


#: How often a box may be halved: small levels need small boxes.
_DEPTH = 28


class InputProof:
    """u = −A∇Hc − [D B] 𝒢ᵀ∇V over boxes, [D B] the first rows of 𝒟.

    The momenta s are within ½ δ sᵀAs ≤ c_u − V(y, 0); u₀ is at most quadratic in them.
    """

    def __init__(
        self, model: StoredDesign, energy: Energy, level: float, damping: Sequence[Sequence[Any]]
    ) -> None:
        self.model, self.energy, self.level, self.damping = model, energy, level, damping
        self.resting = [i for i in range(len(model.z)) if i not in energy.active]
        columns = [
            j for j in range(model.ports.cols) if j < model.m or any(row[j] for row in damping)
        ]
        self.seen = model.ports[:, columns]  # what u sees ∇V through
        self.driven = [(k, i) for k, i in enumerate(energy.active) if any(self.seen.row(i))]
        s = [model.z[i] for i in self.resting]
        self.A = sp.hessian(model.H, s) if s else sp.zeros(0)
        u0 = [] if model.ahead is None or not s else list(model.ahead.u0)
        self.linear = [[sp.diff(u, v).subs(dict.fromkeys(s, 0)) for v in s] for u in u0]
        self.bent = [sp.Matrix([[sp.diff(u, v, w) for w in s] for v in s]) for u in u0]

    def covered(self) -> bool:
        """Whether the momenta enter u through Gᵀ Φ₁ A s and a quadratic u₀ alone."""
        model, s = self.model, [self.model.z[i] for i in self.resting]
        if not s:
            return True
        coupled = any(self.A.has(model.z[i]) for _, i in self.driven)
        moved = self.seen.has(*s) or model.feedback.has(*s)
        scaled = self.energy.phi is not None
        if model.ahead is not None:
            moved = moved or model.ahead.gain.has(*s) or any(N.has(*s) for N in self.bent)
            moved = moved or (scaled and sp.Matrix(list(model.ahead.u0)).has(*s))
        return not (coupled or moved or (self.driven and scaled))

    def kept(self, box: Box) -> bool:
        """Whether u is within the limits wherever V ≤ c_u over a box."""
        return by_bisection(box, self._within, _DEPTH)

    def _within(self, box: Box) -> bool:
        room = self.level - self.energy.value(box)
        if room < 0:
            return True
        if not room.is_finite():
            return False
        model, gradient = self.model, self.energy.gradient(box)
        values = {v: ball(*b) for v, b in zip(self.energy.variables, box, strict=True)}
        slopes = self.energy.hc(box[-model.nc :])[1]
        ports = [[evaluate(e, values) for e in row] for row in model.ports.tolist()]
        gain = [[evaluate(e, values) for e in row] for row in model.feedback.tolist()]
        stiff = [[evaluate(e, values) for e in row] for row in self.A.tolist()]
        ahead, base = self._ahead(values)
        for k, (lo, hi) in enumerate(model.u_limits or ()):
            given = [_dot(ahead[k], column) for column in zip(*self.damping, strict=True)]
            damped = [_dot(given, row) for row in ports]
            u = base[k] - _dot(ahead[k], [_dot(row, slopes) for row in gain])
            u = u - sum((damped[i] * gradient[at] for at, i in self.driven), arb(0))
            linear, bend = self._powers(k, values, stiff)
            swing = self._swing([damped[i] for i in self.resting], stiff, room, linear)
            swing = swing + bend * room.upper()
            if not (bool(u - swing > float(lo)) and bool(u + swing < float(hi))):
                return False
        return True

    def _ahead(self, values: Mapping[sp.Symbol, arb]) -> tuple[list[list[arb]], list[arb]]:
        """B and u₀ of u = u₀ + Bũ, (m, m) and (m,)."""
        m, ahead = self.model.m, self.model.ahead
        if ahead is None:
            return [[arb(i == j) for j in range(m)] for i in range(m)], [arb(0)] * m
        gain = [[evaluate(e, values) for e in row] for row in ahead.gain.tolist()]
        at_rest = {self.model.z[i]: arb(0) for i in self.resting}
        return gain, [evaluate(e, {**values, **at_rest}) for e in ahead.u0]

    def _powers(
        self, k: int, values: Mapping[sp.Symbol, arb], A: list[list[arb]]
    ) -> tuple[list[arb], arb]:
        """Of u₀ = … + bᵀs + ½ sᵀNs b, and a bound ρ of |sᵀNs|/sᵀAs: ρ² = tr (A⁻¹N)²."""
        if k >= len(self.bent):
            return [arb(0)] * len(self.resting), arb(0)
        linear = [evaluate(e, values) for e in self.linear[k]]
        if self.bent[k].is_zero_matrix:
            return linear, arb(0)
        N = arb_mat([[evaluate(e, values) for e in row] for row in self.bent[k].tolist()])
        try:
            share = arb_mat(A).solve(N)
        except ZeroDivisionError:  # A is not proved regular on this box
            return linear, arb("inf")
        product = share * share
        squares = sum((product[i, i] for i in range(len(self.resting))), arb(0)).upper()
        return linear, squares.max(arb(0)).sqrt() if squares.is_finite() else arb("inf")

    def _swing(self, w: list[arb], A: list[list[arb]], room: arb, b: list[arb]) -> arb:
        """The most that Φ₁ wᵀAs − bᵀs can be."""
        form = sum((a * x * y for x, row in zip(w, A, strict=True)
                    for y, a in zip(w, row, strict=True)), arb(0))  # fmt: skip
        if not all(entry.is_zero() for entry in b):
            try:
                moved = arb_mat(A).solve(arb_mat([[entry] for entry in b]))
            except ZeroDivisionError:  # A is not proved regular on this box
                return arb("inf")
            form = form - 2 * _dot(w, b) + _dot(b, [moved[i, 0] for i in range(len(b))])
        most = (form * 2 * room.upper()).upper()
        if not most.is_finite():
            return arb("inf")
        phi = self.energy.phi
        root = most.max(arb(0)).sqrt()
        if phi is None:
            return arb(root.upper())
        first, second = phi.layers[0][0], phi.layers[1][0]
        delta = arb(self.model.form["phi"]["delta"])
        slope = sum((first[i, 0] * second[0, i] for i in range(first.nrows())), delta)
        return arb((root * slope / delta.sqrt()).upper())


def check_input_limits(evidence: Evidence, proof: RegionProof | None, sound: bool) -> Checked:
    """U stays within the model's limits wherever V ≤ c_u on the cells of the region."""
    model = evidence.model
    given = model.damping[: model.m]
    return _check(evidence, proof, sound, "input_limits", evidence.certificate.level_u, given)


def _check_everywhere(evidence: Evidence, sound: bool) -> Checked:
    """−A∇Hc is 0 and u₀ a constant strictly within the limits, whatever the state."""
    model = evidence.model
    ahead = [sp.Integer(0)] * model.m if model.ahead is None else list(model.ahead.u0)
    limits = model.u_limits or []

    def inside(u: sp.Expr, lo: float, hi: float) -> bool:
        value = evaluate(u, {})
        return bool(value > arb(lo)) and bool(value < arb(hi))

    return Checked.by(
        "clipping",
        statements.clipped_everywhere(model.scales_damping),
        [
            ("there are limits", lambda: bool(limits)),
            ("what holds without them is proved", lambda: sound),
            ("no level says less", lambda: evidence.certificate.level_clipped is None),
            ("u does not depend on Hc", lambda: all(e == 0 for e in model.feedback)),
            ("u₀ is constant", lambda: not any(u.free_symbols for u in ahead)),
            (
                "u₀ is strictly within the limits",
                lambda: all(inside(u, *pair) for u, pair in zip(ahead, limits, strict=True)),
            ),
        ],
    )


def check_clipping(evidence: Evidence, proof: RegionProof | None, sound: bool) -> Checked:
    """U without its damping is strictly within the limits: 0 ≺ Σ ⪯ I of −Dw are left, or τ.

    With D diagonal clipping leaves −y_c − ΣDw, Σ diagonal; else the code scales all of 𝒟 that has
    to do with u by 0 < τ ≤ 1. V̇ ≤ 0 stays, and V̇ = 0 still means w = 0. 𝒟 ≻ 0, on which that
    rests, is of the claim that V falls.
    """
    if evidence.claimed("clipping") and evidence.claims["clipping"].data.get("everywhere") is True:
        return _check_everywhere(evidence, sound)
    model, level = evidence.model, evidence.certificate.level_clipped
    none = [[0] * len(model.damping) for _ in range(model.m)]
    return _check(evidence, proof, sound, "clipping", level, none)


def _dot(a: Sequence[Any], b: Sequence[Any]) -> arb:
    return sum((x * y for x, y in zip(a, b, strict=True)), arb(0))


def _check(
    evidence: Evidence,
    proof: RegionProof | None,
    sound: bool,
    name: str,
    level: float | None,
    damping: Sequence[Sequence[Any]],
) -> Checked:
    """The inputs with this damping are within the limits up to a level."""
    limits, unit = evidence.model.stated_limits, evidence.model.units.energy
    if level is None or limits is None or proof is None or not (sound and evidence.claimed(name)):
        given = level is not None and limits is not None and proof is not None
        missing = "what it rests on" if given else "limits, a level or a region in the files"
        return Checked(name, False, f"no input limits are proved, for want of {missing}")
    height = evidence.number(name, "level_above_minimum")
    natural, bottom = level / unit, proof.bottom
    whole = natural == proof.level
    text = statements.input_limits(limits, height, whole)
    if name == "clipping":
        text = statements.clipping(limits, height, whole, evidence.model.scales_damping)
    inputs = InputProof(evidence.model, proof.energy, natural, damping)
    return Checked.by(
        name,
        text,
        [
            ("V(z̄) < c_u", lambda: bool(bottom < natural)),
            ("c_u is as high above V(z̄)", lambda: bool(bottom + height / unit <= natural)),
            ("c_u ≤ c", lambda: natural <= proof.level),
            ("the momenta enter u through Gᵀ Φ₁ A s and a quadratic u₀", inputs.covered),
            (
                "u is within its limits where V ≤ c_u",
                lambda: all(map(inputs.kept, proof.boxes(natural))),
            ),
        ],
    )
