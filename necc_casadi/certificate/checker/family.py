"""A family: what stands in family.json, and every claim about it proved again in Arb balls.

The loop there is seen from the set-point. It is tied to the plant of design.json by algebra: at the
nominal ϑ it is that plant, and for every other one its flow is that of a plant with the unknown
parameters at x̂ + x*(r) − x*(r₀), with the feed-forward and the disturbance on its inputs.
"""

from __future__ import annotations

import copy
import hashlib
import json
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import sympy as sp
from flint import arb, arb_mat

from necc_casadi.certificate.checker.arithmetic.balls import Box, ball, by_bisection, ends, evaluate
from necc_casadi.certificate.checker.arithmetic.definite import middle_of, positive
from necc_casadi.certificate.checker.arithmetic.potential import Energy, hessian_hull
from necc_casadi.certificate.checker.arithmetic.smooth import is_smooth_on
from necc_casadi.certificate.checker.evidence import Checked, Evidence, Obligation
from necc_casadi.certificate.checker.model import StoredDesign
from necc_casadi.certificate.checker.units import rationals
from necc_casadi.certificate.claims.family import FAMILY_FILE, FamilyBox, FamilyClaim, statement
from necc_casadi.certificate.claims.regions import Side
from necc_casadi.files import read_text
from necc_casadi.symbolic.expressions import parse
from necc_casadi.symbolic.semidefinite import is_positive_semidefinite
from necc_casadi.symbolic.zero import is_zero

__all__ = ["check_family"]


#: Bytes of family.json, parameters, boxes, and letters of an expression.
_LARGEST, _MOST, _MOST_BOXES, _LONGEST = 1 << 24, 50, 10_000, 20_000


#: How often a box of ϑ may be halved.
_HALVINGS = 12


def check_family(evidence: Evidence, folder: Path, design_hash: str) -> Checked:
    """Every ϑ: V_ϑ falls, and z̄(ϑ) is where the certificate says."""
    claim = FamilyClaim.read(evidence.claims["family"].data)
    text = read_text(folder / FAMILY_FILE, _LARGEST)
    data = json.loads(text)
    family = _StoredFamily(evidence.model, data)
    minima = _Minima(family)
    sides = {p.name: p.side for p in family.parameters}
    units = dict(zip(evidence.model.states, evidence.model.units.state, strict=True))
    unknown = any(p.kind == "uncertain" for p in family.parameters)
    worded = statement(sides, claim.error, units, unknown)
    own: list[Obligation] = [
        (
            "family.json is the one that is claimed about, and of this design",
            lambda: (
                hashlib.sha256(text.encode()).hexdigest() == claim.family
                and data["design"] == design_hash
            ),
        )
    ]
    obligations = [
        *own,
        *family.obligations(),
        ("the boxes cover the ranges", lambda: _cover(family.exact, claim.boxes)),
        ("everything is smooth on the boxes", lambda: minima.smooth(claim.boxes)),
        ("the minimum is where it is claimed", lambda: all(map(minima.holds, claim.boxes))),
        ("the errors are those of the boxes", lambda: minima.within(claim)),
    ]
    return Checked.by("family", worded, obligations)


class _Parameter:
    """A symbol with a range, in the units of the model."""

    def __init__(self, entry: Mapping[str, Any], symbol: str) -> None:
        self.name, self.kind = str(entry["name"]), entry["kind"]
        self.symbol = sp.Symbol(symbol, real=True)
        self.lo, self.hi = (parse(_short(v), {}) for v in entry["range"])
        self.nominal = parse(_short(entry["nominal"]), {})
        if self.kind not in ("setpoint", "uncertain", "disturbance"):
            raise ValueError(f"no such kind: {self.kind!r:.20}")
        if self.kind != "setpoint" and not self.name.isidentifier():
            raise ValueError("a parameter whose name is no word")

    @property
    def side(self) -> Side:
        """The range as doubles near its ends, for words."""
        lo, hi = (evaluate(v, {}) for v in (self.lo, self.hi))
        return float(lo.mid()), float(hi.mid())


def _short(text: Any) -> str:
    if not isinstance(text, str) or len(text) > _LONGEST:
        raise ValueError(f"no expression, or one of more than {_LONGEST} characters")
    return text


class _StoredFamily:
    """family.json as expressions in natural units."""

    def __init__(self, model: StoredDesign, data: Mapping[str, Any]) -> None:
        self.model = model
        names, entries = data["symbols"], data["parameters"]
        N, n = len(model.z), model.n
        if not (data["format"] == 1 and len(names) == N + len(entries) == len(set(names))):
            raise ValueError("family.json has another format, or symbols of other states")
        if names[:N] != list(model.symbols) or len(entries) > _MOST:
            raise ValueError("family.json names other states, or too many parameters")
        pairs = zip(entries, names[N:], strict=True)
        self.parameters = [_Parameter(entry, name) for entry, name in pairs]
        moved = {p.name for p in self.parameters if p.kind == "setpoint"}
        if not moved <= set(model.states[:n]):
            raise ValueError("family.json moves what is no state of the plant")
        S, U = rationals(model.units.state[:n]), rationals(model.input_units)
        E, T = rationals([model.units.energy, model.units.time])
        known = dict(zip(names, [*model.z, *self.symbols], strict=True))
        scale = {s: u * s for s, u in zip(model.z, S, strict=False) if u != 1}

        def read(text: Any) -> sp.Expr:
            found = parse(_short(text), known)
            if found.free_symbols & set(model.z[n:]):
                raise ValueError("the plant of a family knows no controller state")
            return found.xreplace(scale)

        def matrix(rows: Any, unit: Any) -> sp.Matrix:
            return sp.Matrix(
                [[read(v) * unit(i, j) for j, v in enumerate(row)] for i, row in enumerate(rows)]
            )

        self.H = read(data["H"]) / E
        self.J, self.R = (matrix(data[k], lambda i, j: T * E / (S[i] * S[j])) for k in "JR")
        self.G = matrix(data["G"], lambda i, j: T * U[j] / S[i])
        self.x_star = [read(v) / s for v, s in zip(data["x_star"], S, strict=True)]
        self.feed = sp.Matrix([read(v) / u for v, u in zip(data["feedforward"], U, strict=True)])
        if (self.J.shape, self.R.shape, self.G.shape) != ((n, n), (n, n), (n, model.m)):
            raise ValueError("the matrices of family.json do not fit the plant")
        self.U = U

    @property
    def symbols(self) -> list[sp.Symbol]:
        """ϑ."""
        return [p.symbol for p in self.parameters]

    @property
    def exact(self) -> list[tuple[arb, arb]]:
        """The ranges, as balls around their ends."""
        return [(evaluate(p.lo, {}), evaluate(p.hi, {})) for p in self.parameters]

    def obligations(self) -> list[Obligation]:
        """What makes this the family of the design, and V fall for all of it."""
        return [
            ("Φ is the sum", lambda: self.model.form["phi"] is None),
            ("the loop is the published one", self._is_published),
            ("at the nominal parameters it is the plant of the design", self._is_of_the_design),
            ("x*(r) is the target at r₀", self._starts_at_the_target),
            ("it is the plant seen from the set-point", self._is_the_plant),
            ("J = −Jᵀ and R = Rᵀ for every parameter", self._is_symmetric),
            ("R ⪰ 0 for every parameter", self._dissipates),
            ("∇Cᵀ(Jcl − Rcl) = 0 for every parameter", self._has_casimirs),
            ("no unknown stands in the damping", self._is_known),
        ]

    def _is_published(self) -> bool:
        return self.model.ahead is None and hasattr(self.model.loop, "Gc")

    def _nominal(self, kinds: Sequence[str]) -> dict[sp.Symbol, sp.Expr]:
        return {p.symbol: p.nominal for p in self.parameters if p.kind in kinds}

    def _is_of_the_design(self) -> bool:
        known = self._nominal(("setpoint", "uncertain", "disturbance"))
        pairs = [(self.J, self.model.J), (self.R, self.model.R), (self.G, self.model.G)]
        off = [e for own, other in pairs for e in own.subs(known) - other]
        slope = [sp.diff(self.H.subs(known) - self.model.H, s) for s in self._x]
        return _vanish([*off, *slope])

    @property
    def _x(self) -> tuple[sp.Symbol, ...]:
        return self.model.z[: self.model.n]

    def _starts_at_the_target(self) -> bool:
        known = self._nominal(("setpoint",))
        pairs = zip(self.x_star, self.model.target, strict=True)
        free = all(v.free_symbols <= set(known) for v in self.x_star)
        return free and _vanish([v.subs(known) - t for v, t in pairs])

    def _is_the_plant(self) -> bool:
        """The flow at (x̂; r, θ, d) is that at (x̂ + x*(r) − x*(r₀); r₀, θ, 0), and G(u_r + d)."""
        base = self._nominal(("setpoint", "disturbance"))
        shift = {
            s: s + v - t for s, v, t in zip(self._x, self.x_star, self.model.target, strict=True)
        }
        plain = (self.J - self.R) * sp.Matrix([sp.diff(self.H, s) for s in self._x])
        there = plain.subs(base).subs(shift, simultaneous=True)
        d = [p.symbol for p in self.parameters if p.kind == "disturbance"]
        added: list[sp.Expr] = [*d, *[sp.Integer(0)] * (self.model.m - len(d))]
        scaled = sp.Matrix([a / u for a, u in zip(added, self.U, strict=True)])
        G = self.G.subs(base).subs(shift, simultaneous=True)
        pairs = zip([*self.G], [*G], strict=True)
        moved = [a - b for a, b in pairs]
        return _vanish([*(plain - there - G * (self.feed + scaled)), *moved])

    def _is_symmetric(self) -> bool:
        return _vanish([*(self.J + self.J.T), *(self.R - self.R.T)])

    def _dissipates(self) -> bool:
        beyond = {
            p.symbol: p.lo + sp.Symbol(f"above {p.name}", real=True) ** 2 for p in self.parameters
        }
        return is_positive_semidefinite(self.R.subs(beyond)) is True

    def _has_casimirs(self) -> bool:
        loop: Any = self.model.loop
        coupling = self.G * loop.Gc.T
        upper = (self.J - self.R).row_join(-coupling)
        M = upper.col_join(coupling.T.row_join(loop.Jc - loop.Rc))
        slopes = [sp.Matrix([[sp.diff(c, v) for v in self.model.z]]) for c in self.model.casimirs]
        return all(_vanish([*(slope * M)]) for slope in slopes)

    def _is_known(self) -> bool:
        unknown = {p.symbol for p in self.parameters if p.kind == "uncertain"}
        slopes = sp.Matrix([[sp.diff(c, v) for v in self._x] for c in self.model.casimirs])
        used = (slopes * self.G).applyfunc(sp.simplify)
        return not used.free_symbols & unknown


def _vanish(entries: Sequence[sp.Expr]) -> bool:
    return all(is_zero(sp.sympify(entry)) is True for entry in entries)


class _Minima:
    """z̄(ϑ) on boxes of ϑ, by Krawczyk's operator in balls."""

    def __init__(self, family: _StoredFamily) -> None:
        self.family, self.model = family, family.model
        nothing = copy.copy(self.model)
        nothing.H = sp.Integer(0)
        self.networks = Energy(nothing, range(len(self.model.z)))
        x = self.model.z[: self.model.n]
        slope = [sp.diff(family.H, s) for s in x]
        here = dict(zip(x, self.model.target, strict=True))
        self.at_target = [sp.simplify(e.subs(here)) for e in slope]
        self.bends = [[sp.diff(e, s) for s in x] for e in slope]
        self.turns = [[sp.diff(e, s) for s in family.symbols] for e in self.at_target]
        self.target = self.model.target_balls()

    def smooth(self, boxes: Sequence[FamilyBox]) -> bool:
        """Whether H, J, R, G and the Casimirs are smooth on the hull of all boxes and z*."""
        family, model = self.family, self.model
        z = [ends(t) for t in self.target]
        sides = [(*box.around, *box.theta) for box in boxes]
        hull = [(min(s[0] for s in c), max(s[1] for s in c)) for c in zip(*sides, strict=True)]
        whole = [(min(a, z[i][0]), max(b, z[i][1])) if i < len(z) else (a, b)
                 for i, (a, b) in enumerate(hull)]  # fmt: skip
        written = [family.H, *family.J, *family.R, *family.G, *model.written]
        return is_smooth_on(written, (*model.z, *family.symbols), tuple(whole))

    def holds(self, claimed: FamilyBox) -> bool:
        """X in the inside of B and ∇²V ≻ 0 on B: one minimum in X, for each ϑ of the box."""
        inside = all(b[0] < x[0] and x[1] < b[1]
                     for x, b in zip(claimed.minimum, claimed.around, strict=True))  # fmt: skip
        return inside and by_bisection(
            claimed.theta, partial(self._maps_into, claimed.around, claimed.minimum), _HALVINGS
        )

    def _maps_into(self, B: Box, X: Box, sides: Box) -> bool:
        """Whether Krawczyk's operator takes B into X for every ϑ of a box."""
        z0 = [arb(lo / 2 + hi / 2) for lo, hi in X]
        theta = {s: ball(*side) for s, side in zip(self.family.symbols, sides, strict=True)}
        hess = self._hessian(B, theta)
        guess = middle_of(hess)
        if not np.isfinite(guess).all() or not positive(hess, 0):
            return False
        Y = arb_mat(np.linalg.inv(guess).tolist())
        slope = arb_mat([[g] for g in self._gradient(z0, theta, sides)])
        N = len(z0)
        identity = arb_mat([[int(i == j) for j in range(N)] for i in range(N)])
        offset = arb_mat([[ball(*side) - m] for side, m in zip(B, z0, strict=True)])
        moved = (identity - Y * hess) * offset - Y * slope
        found = [ends(m + row[0]) for m, row in zip(z0, moved.tolist(), strict=True)]
        return all(x <= lo and hi <= y for (lo, hi), (x, y) in zip(found, X, strict=True))

    def _hessian(self, box: Box, theta: Mapping[sp.Symbol, arb]) -> arb_mat:
        total, n = self._of_networks(box), self.model.n
        known = {**dict(zip(self.model.z, (ball(*s) for s in box), strict=True)), **theta}
        for i in range(n):
            for j in range(n):
                total[i, j] = total[i, j] + evaluate(self.bends[i][j], known)
        return total

    def _of_networks(self, box: Box) -> arb_mat:
        """∇²(Hc + K) over a box, entry by entry where the Casimirs are linear."""
        values, slopes = self.networks.casimirs(box)
        if self.model.form["betas"] or any(v.rad() > 0 for row in slopes for v in row):
            return hessian_hull(self.networks, box)
        first, N = self.model.n, len(box)
        of_hc = self.networks.hc(box[first:])[2]
        of_k = self.networks.k(tuple(ends(c) for c in values))[2]
        inner = arb_mat([[_entry(of_k, a, b) for b in range(len(slopes))]
                         for a in range(len(slopes))])  # fmt: skip
        N_c = arb_mat(slopes)
        total = N_c.transpose() * inner * N_c
        for i in range(first, N):
            for j in range(first, N):
                total[i, j] = total[i, j] + _entry(of_hc, i - first, j - first)
        return total

    def _gradient(
        self, z: Sequence[arb], theta: Mapping[sp.Symbol, arb], sides: Sequence[Side]
    ) -> list[arb]:
        """∇V at a point: of Ĥ by that at the target, and ∇²Ĥ in between."""
        n = self.model.n
        known = {s: t.union(v) for s, t, v in zip(self.model.z, self.target, z, strict=True)}
        known.update(theta)
        grad = list(self.networks.gradient_at(list(z)))
        centre = {s: arb(lo / 2 + hi / 2) for s, (lo, hi) in zip(theta, sides, strict=True)}
        for i in range(n):
            start = evaluate(self.at_target[i], centre)
            for s, slope in zip(theta, self.turns[i], strict=True):
                start = start + evaluate(slope, theta) * (theta[s] - centre[s])
            for j in range(n):
                start = start + evaluate(self.bends[i][j], known) * (z[j] - self.target[j])
            grad[i] = grad[i] + start
        return grad

    def within(self, claim: FamilyClaim) -> bool:
        """Whether the claimed errors hold those of all boxes."""
        if set(claim.error) != set(self.model.states[: self.model.n]):
            return False
        for i, name in enumerate(self.model.states[: self.model.n]):
            unit, (lo, hi) = self.model.units.state[i], claim.error[name]
            for box in claim.boxes:
                low, high = ((arb(v) - self.target[i]) * unit for v in box.minimum[i])
                if not (arb(lo) <= low.lower() and high.upper() <= arb(hi)):
                    return False
        return True


def _entry(hess: Mapping[tuple[int, int], arb], i: int, j: int) -> arb:
    return hess[min(i, j), max(i, j)]


def _cover(exact: Sequence[tuple[arb, arb]], boxes: Sequence[FamilyBox]) -> bool:
    """Whether boxes hold every point of the ranges."""
    if not boxes or len(boxes) > _MOST_BOXES:
        return False
    whole = tuple((ends(lo)[0], ends(hi)[1]) for lo, hi in exact)
    return _covered(whole, [box.theta for box in boxes])


def _covered(region: Box, boxes: list[Box]) -> bool:
    """By halving the region at a side of a box that crosses it."""
    near = [b for b in boxes if all(lo <= y and x <= hi for (x, y), (lo, hi) in
                                    zip(region, b, strict=True))]  # fmt: skip
    for box in near:
        if all(lo <= x and y <= hi for (x, y), (lo, hi) in zip(region, box, strict=True)):
            return True
    for box in near:
        for k, ((x, y), side) in enumerate(zip(region, box, strict=True)):
            for cut in side:
                if x < cut < y:
                    parts = ((x, cut), (cut, y))
                    return all(
                        _covered((*region[:k], part, *region[k + 1 :]), near) for part in parts
                    )
    return False
