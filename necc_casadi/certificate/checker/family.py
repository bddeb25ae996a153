"""A family: every claim about what stands in family.json proved again in Arb balls."""

from __future__ import annotations

import copy
import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np
import sympy as sp
from flint import arb, arb_mat

from necc_casadi.certificate.checker.arithmetic.balls import Box, ball, by_bisection, ends, evaluate
from necc_casadi.certificate.checker.arithmetic.definite import middle_of, positive
from necc_casadi.certificate.checker.arithmetic.potential import Energy, hessian_hull
from necc_casadi.certificate.checker.arithmetic.smooth import is_smooth_on
from necc_casadi.certificate.checker.evidence import Checked, Evidence, Obligation
from necc_casadi.certificate.checker.stored_family import StoredFamily
from necc_casadi.certificate.claims.family import FAMILY_FILE, FamilyBox, FamilyClaim, statement
from necc_casadi.certificate.claims.regions import Side
from necc_casadi.files import read_text

__all__ = ["check_family"]


#: Bytes of family.json, and boxes.
_LARGEST, _MOST_BOXES = 1 << 24, 10_000


#: How often a box of ϑ may be halved.
_HALVINGS = 12


def check_family(
    evidence: Evidence, folder: Path, design_hash: str, plant_file: Callable[[], str | None]
) -> Checked:
    """Every ϑ: V_ϑ falls, and z̄(ϑ) is where the certificate says; `plant_file` gives plant.json."""
    claim = FamilyClaim.read(evidence.claims["family"].data)
    text = read_text(folder / FAMILY_FILE, _LARGEST)
    data = json.loads(text)
    family = StoredFamily(evidence.model, data)
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
        (
            "unknown parameters do what plant.json says",
            lambda: not unknown or family.is_written_in(plant_file()),
        ),
        ("the boxes cover the ranges", lambda: _cover(family.exact, claim.boxes)),
        ("everything is smooth on the boxes", lambda: minima.smooth(claim.boxes)),
        ("the minimum is where it is claimed", lambda: all(map(minima.holds, claim.boxes))),
        ("the errors are those of the boxes", lambda: minima.within(claim)),
    ]
    return Checked.by("family", worded, obligations)


class _Minima:
    """z̄(ϑ) on boxes of ϑ, by Krawczyk's operator in balls."""

    def __init__(self, family: StoredFamily) -> None:
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
        seen = [*family.x_star, *family.feed]
        written = [family.H, *family.J, *family.R, *family.G, *seen, *model.written]
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
    if not all(lo <= hi for lo, hi in whole):
        return False
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
