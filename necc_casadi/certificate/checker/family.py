"""A family: every claim about what stands in family.json proved again in Arb balls."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property, partial
from pathlib import Path

import numpy as np
import sympy as sp
from flint import arb, arb_mat

from necc_casadi.certificate.checker.arithmetic.balls import (
    Box,
    ball,
    by_bisection,
    ends,
    evaluate,
    meet,
)
from necc_casadi.certificate.checker.arithmetic.definite import middle_of, positive
from necc_casadi.certificate.checker.arithmetic.potential import Energy, hessian_hull
from necc_casadi.certificate.checker.arithmetic.smooth import is_smooth_on
from necc_casadi.certificate.checker.evidence import Checked, Evidence, Obligation
from necc_casadi.certificate.checker.stored_family import StoredFamily
from necc_casadi.certificate.claims.family import FAMILY_FILE, FamilyBox, FamilyClaim, statement
from necc_casadi.certificate.claims.regions import Side
from necc_casadi.files import read_text

__all__ = ["Minima", "StoredMembers", "check_family", "covers"]


#: Bytes of family.json, and boxes.
_LARGEST, _MOST_BOXES = 1 << 24, 10_000


#: How often a box of ϑ may be halved, and Krawczyk's operator applied to what is left.
_HALVINGS, _STEPS = 12, 4


class StoredMembers:
    """family.json beside its design, and what makes V fall for all that it describes."""

    def __init__(
        self,
        evidence: Evidence,
        folder: Path,
        design_hash: str,
        plant_file: Callable[[], str | None],
        falls: bool,
    ) -> None:
        """`plant_file` gives plant.json; `falls`: the damping and the design's own structure."""
        text = read_text(folder / FAMILY_FILE, _LARGEST)
        data = json.loads(text)
        self.hash = hashlib.sha256(text.encode()).hexdigest()
        self.family = family = StoredFamily(evidence.model, data)
        unknown = family.has_unknown
        self._rests_on: list[Obligation] = [
            ("family.json is of this design", lambda: data["design"] == design_hash),
            ("V of the design never increases", lambda: falls),
            *family.obligations(),
            (
                "unknown parameters do what plant.json says",
                lambda: not unknown or family.is_written_in(plant_file()),
            ),
        ]

    def obligations(self, claimed: str) -> list[Obligation]:
        """What a claim about the family with this hash rests on; proved once for all of them."""
        own: Obligation = ("family.json is the one that is claimed about",
                           lambda: self.hash == claimed)  # fmt: skip
        return [own, *((what, partial(self._proved, what)) for what, _ in self._rests_on)]

    def _proved(self, what: str) -> bool:
        if what not in self._known:
            self._known[what] = dict(self._rests_on)[what]()
        return self._known[what]

    @cached_property
    def _known(self) -> dict[str, bool]:
        return {}


def check_family(evidence: Evidence, members: StoredMembers) -> Checked:
    """Every ϑ: V_ϑ falls, and z̄(ϑ) is where the certificate says."""
    claim, family = FamilyClaim.read(evidence.claims["family"].data), members.family
    minima = Minima(family)
    units = dict(zip(evidence.model.states, evidence.model.units.state, strict=True))
    worded = statement(family.sides, claim, units, family.has_unknown)
    boxes = [box.theta for box in claim.boxes] + list(claim.left)
    obligations = [
        *members.obligations(claim.family),
        ("the boxes, with those left out, cover the ranges", lambda: covers(family.box, boxes)),
        ("everything is smooth on the boxes", lambda: minima.smooth(claim.boxes)),
        ("the minimum is where it is claimed", lambda: all(map(minima.holds, claim.boxes))),
        ("the errors are those of the boxes", lambda: minima.within(claim)),
    ]
    return Checked.by("family", worded, obligations)


class Minima:
    """z̄(ϑ) on boxes of ϑ, by Krawczyk's operator in balls."""

    def __init__(self, family: StoredFamily) -> None:
        self.family, self.model = family, family.model
        self.networks = Energy(family.without_energy(), range(len(self.model.z)))
        x = self.model.z[: self.model.n]
        self.slope = slope = [sp.diff(family.H, s) for s in x]
        here = dict(zip(x, self.model.target, strict=True))
        self.at_target = [sp.simplify(e.subs(here)) for e in slope]
        self.bends = [[sp.diff(e, s) for s in x] for e in slope]
        self.turns = [[sp.diff(e, s) for s in family.symbols] for e in self.at_target]
        self.mixed = [[sp.diff(e, s) for s in family.symbols] for e in slope]
        self.target = self.model.target_balls()

    @cached_property
    def reaches(self) -> list[float]:
        """Lengths of sides of ϑ that move the slope at the target alike."""
        ranges = {
            s: ball(*side) for s, side in zip(self.family.symbols, self.family.box, strict=True)
        }
        steep = [
            max(float(evaluate(row[k], ranges).abs_upper()) for row in self.turns)
            for k in range(len(ranges))
        ]
        return [1 / v if 0 < v < math.inf else 1.0 for v in steep]

    def smooth(self, boxes: Sequence[FamilyBox]) -> bool:
        """Whether H, J, R, G and the Casimirs are smooth on the hull of each box and z*."""
        z = [ends(t) for t in self.target]
        sides = [(*box.around, *box.theta) for box in boxes]
        hull = tuple((min(s[0] for s in c), max(s[1] for s in c)) for c in zip(*sides, strict=True))
        return self._smooth_on(hull, z) or all(self._smooth_on(side, z) for side in sides)

    def _smooth_on(self, box: Box, z: Sequence[Side]) -> bool:
        family, model = self.family, self.model
        whole = [(min(a, z[i][0]), max(b, z[i][1])) if i < len(z) else (a, b)
                 for i, (a, b) in enumerate(box)]  # fmt: skip
        seen = [*family.x_star, *family.feed]
        written = [family.H, *family.J, *family.R, *family.G, *seen, *model.written]
        return is_smooth_on(written, (*model.z, *family.symbols), tuple(whole))

    def holds(self, claimed: FamilyBox) -> bool:
        """X in the inside of B and ∇²V ≻ 0 on B: one minimum in X, for each ϑ of the box."""
        inside = all(b[0] < x[0] and x[1] < b[1]
                     for x, b in zip(claimed.minimum, claimed.around, strict=True))  # fmt: skip
        test = partial(self._leads_to, claimed.around, claimed.minimum)
        return inside and by_bisection(claimed.theta, test, _HALVINGS, sizes=self.reaches)

    def _leads_to(self, B: Box, X: Box, sides: Box) -> bool:
        """Whether Krawczyk's operator takes B into itself, and what is left of it into X.

        For every ϑ of a box. Once V has one critical point in B, the operator keeps it in any part.
        """
        middle = [arb(lo / 2 + hi / 2) for lo, hi in X]
        found = self._image(B, middle, sides)
        if found is None or not _within(found, B, strictly=True):
            return False
        for _ in range(_STEPS):
            if _within(found, X):
                return True
            around = _common(found, B)
            again = self._image(around, [arb(lo / 2 + hi / 2) for lo, hi in around], sides)
            if again is None:
                return False
            found = _common(again, around)
        return _within(found, X)

    def _image(self, B: Box, z0: list[arb], sides: Box) -> Box | None:
        """What Krawczyk's operator makes of B; None where ∇²V ≻ 0 is not proved on it."""
        theta = {s: ball(*side) for s, side in zip(self.family.symbols, sides, strict=True)}
        hess = self._hessian(B, theta)
        guess = middle_of(hess)
        if not np.isfinite(guess).all() or not positive(hess, 0):
            return None
        Y = arb_mat(np.linalg.inv(guess).tolist())
        slope = arb_mat([[g] for g in self.gradient(z0, theta, sides)])
        N = len(z0)
        identity = arb_mat([[int(i == j) for j in range(N)] for i in range(N)])
        offset = arb_mat([[ball(*side) - m] for side, m in zip(B, z0, strict=True)])
        moved = (identity - Y * hess) * offset - Y * slope
        return tuple(ends(m + row[0]) for m, row in zip(z0, moved.tolist(), strict=True))

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

    def gradient(
        self, z: Sequence[arb], theta: Mapping[sp.Symbol, arb], sides: Sequence[Side]
    ) -> list[arb]:
        """∇V at a point: of Ĥ as it stands, and by that at the target and ∇²Ĥ in between."""
        n = self.model.n
        way = {s: t.union(v) for s, t, v in zip(self.model.z, self.target, z, strict=True)}
        way.update(theta)
        here = dict(zip(self.model.z, z, strict=True))
        grad = list(self.networks.gradient_at(list(z)))
        for i in range(n):
            start = self._over_theta(self.at_target[i], self.turns[i], {}, theta, sides)
            for j in range(n):
                start = start + evaluate(self.bends[i][j], way) * (z[j] - self.target[j])
            direct = self._over_theta(self.slope[i], self.mixed[i], here, theta, sides)
            grad[i] = grad[i] + meet(start, direct)
        return grad

    def _over_theta(
        self,
        expr: sp.Expr,
        slopes: Sequence[sp.Expr],
        known: Mapping[sp.Symbol, arb],
        theta: Mapping[sp.Symbol, arb],
        sides: Sequence[Side],
    ) -> arb:
        """An expression at known states over ϑ: its value at the middle, and slopes."""
        centre = {s: arb(lo / 2 + hi / 2) for s, (lo, hi) in zip(theta, sides, strict=True)}
        total, whole = evaluate(expr, {**known, **centre}), {**known, **theta}
        for s, slope in zip(theta, slopes, strict=True):
            total = total + evaluate(slope, whole) * (theta[s] - centre[s])
        return total

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


def _within(inner: Box, outer: Box, strictly: bool = False) -> bool:
    """Whether a box is in another one."""
    pairs = zip(inner, outer, strict=True)
    if strictly:
        return all(a < lo and hi < b for (lo, hi), (a, b) in pairs)
    return all(a <= lo and hi <= b for (lo, hi), (a, b) in pairs)


def _common(a: Box, b: Box) -> Box:
    """What two boxes that hold one point have in common."""
    return tuple((max(x[0], y[0]), min(x[1], y[1])) for x, y in zip(a, b, strict=True))


def _entry(hess: Mapping[tuple[int, int], arb], i: int, j: int) -> arb:
    return hess[min(i, j), max(i, j)]


def covers(whole: Box, boxes: Sequence[Box]) -> bool:
    """Whether boxes hold every point of the ranges."""
    sized = all(len(box) == len(whole) for box in boxes)
    return sized and 0 < len(boxes) <= _MOST_BOXES and _covered(whole, list(boxes))


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
