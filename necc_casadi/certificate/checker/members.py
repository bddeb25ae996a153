"""Regions of a family's members, proved again in balls: each box of ϑ, and that they cover.

With E(y; ϑ) = V_ϑ(y, 0) − V_ϑ(z*): E > h on the sides of a box of y, and on its cells E > h, or a
slope, or the core, in which ∂²V/∂y² ≻ 0.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from itertools import product

import sympy as sp
from flint import arb, arb_mat

from necc_casadi.certificate.checker.arithmetic.balls import (
    Box,
    ball,
    by_bisection,
    ends,
    evaluate,
    meet,
    widths,
)
from necc_casadi.certificate.checker.arithmetic.definite import positive
from necc_casadi.certificate.checker.arithmetic.potential import Energy
from necc_casadi.certificate.checker.arithmetic.smooth import is_smooth_on
from necc_casadi.certificate.checker.everywhere import StoredWhole
from necc_casadi.certificate.checker.evidence import Checked, Evidence, Obligation
from necc_casadi.certificate.checker.family import StoredMembers, covers
from necc_casadi.certificate.checker.region.floor import evaluated
from necc_casadi.certificate.claims.family import FamilyClaim
from necc_casadi.certificate.claims.members import HeldBox, MembersClaim, members
from necc_casadi.certificate.claims.regions import Region

__all__ = ["check_members"]


#: How often a cell of y and ϑ may be halved, and one of ϑ beside a marked cell of y.
_DEPTH, _BESIDE = 30, 12


#: Momenta may be anything.
_ANY = (-1e300, 1e300)


#: Boxes of ϑ at most.
_MOST = 1000


def check_members(evidence: Evidence, stored: StoredMembers) -> Checked:
    """Every member keeps its region, and what is common to all of them."""
    claim = MembersClaim.read(evidence.claims["members"].data)
    family = stored.family
    text = members(family.sides, claim, evidence.model.units.energy, family.has_unknown)
    if not evidence.claimed("family"):
        return Checked("members", False, f"{text}; not proved: where the members rest")
    near = FamilyClaim.read(evidence.claims["family"].data)
    regions = _Regions(evidence, stored, claim, near)
    return Checked.by("members", text, [*stored.obligations(claim.family), *regions.obligations()])


class _Regions:
    """E and its slopes over boxes of y and ϑ."""

    def __init__(
        self, evidence: Evidence, stored: StoredMembers, claim: MembersClaim, near: FamilyClaim
    ) -> None:
        self.model, self.family, self.claim, self.near = evidence.model, stored.family, claim, near
        self.evidence, self.stored = evidence, stored
        self.whole = StoredWhole(evidence, stored, claim.active)
        self.d = len(claim.active)
        sized = all(
            len(box.half) == self.d and len(box.theta) == len(self.family.symbols)
            for box in claim.boxes
        )
        if not sized or not 0 < len(claim.boxes) <= _MOST:
            raise ValueError("members: boxes of another size")
        nothing = self.family.without_energy()
        self.networks = Energy(nothing, claim.active)
        self.star = [self.model.target_balls()[i] for i in claim.active]
        x = self.model.z[: self.model.n]
        U = self.family.H.subs(dict.fromkeys(self.whole.s, sp.Integer(0)))
        here = dict(zip(x, self.model.target, strict=True))
        self.own = sp.expand(U - U.subs(here))
        self.symbols = [*self.whole.y, *self.family.symbols]
        self.slopes = [sp.diff(self.own, s) for s in self.symbols]
        self.bends = [[sp.diff(g, s) for s in self.symbols] for g in self.slopes[: self.d]]
        self.bottom = self.networks.value_and_gradient(self._at_star)[0]

    @cached_property
    def _at_star(self) -> Box:
        return tuple(ends(v) for v in self.star)

    def obligations(self) -> list[Obligation]:
        """What each member keeps, and what all have in common."""
        claim = self.claim
        boxes = [box.theta for box in claim.boxes] + list(claim.left)
        return [
            *self.whole.of_the_loop(),
            ("what follows for solutions", self.whole.converges),
            ("the model bounds no momentum", self._leaves_momenta_free),
            ("the boxes, with those left out, cover the ranges",
             lambda: covers(self.family.box, boxes)),
            ("each region is kept", lambda: all(map(self._is_kept, claim.boxes))),
            ("marked cells are in every region", self._are_common),
            ("their share of the domain", self._has_share),
            ("steps of the set-point", self._may_step),
        ]  # fmt: skip

    # --- enclosures -------------------------------------------------------------------------------

    def _known(self, cell: Box) -> dict[sp.Symbol, arb]:
        return {s: ball(*side) for s, side in zip(self.symbols, cell, strict=True)}

    def _value(self, cell: Box) -> arb:
        """E: at the middle, and slopes over the cell."""
        d = self.d
        middle: Box = tuple((m, m) for m in (lo / 2 + hi / 2 for lo, hi in cell))
        at = self.networks.value_and_gradient(middle[:d])[0]
        total = at - self.bottom + evaluate(self.own, self._known(middle))
        if middle == cell:
            return total
        known, inner = self._known(cell), self.networks.value_and_gradient(cell[:d])[1]
        for i, (slope, (lo, hi), (m, _)) in enumerate(zip(self.slopes, cell, middle, strict=True)):
            if lo < hi:
                steep = evaluate(slope, known) + (inner[i] if i < d else arb(0))
                total = total + steep * (ball(lo, hi) - arb(m))
        return total

    def _reaches(self, cell: Box) -> list[float]:
        """Lengths of sides of (y, ϑ) along which E changes alike."""
        known, inner = self._known(cell), self.networks.value_and_gradient(cell[: self.d])[1]
        steep = [evaluate(slope, known) for slope in self.slopes]
        steep[: self.d] = [a + b for a, b in zip(steep, inner, strict=False)]
        most = [float(v.abs_upper()) for v in steep]
        return [1 / v if 0 < v < math.inf else 1.0 for v in most]

    def _has_slope(self, cell: Box) -> bool:
        """Whether ∂V/∂y has an entry other than 0 all over a cell."""
        d, known = self.d, self._known(cell)
        middle: Box = tuple((m, m) for m in (lo / 2 + hi / 2 for lo, hi in cell))
        at, inner = self._known(middle), self.networks.value_and_gradient(cell[:d])[1]
        start = self.networks.value_and_gradient(middle[:d])[1]
        hess = self.networks.hessian(cell[:d])
        steps = [ball(*side) - arb(m) for side, (m, _) in zip(cell, middle, strict=True)]
        for i in range(d):
            naive = evaluate(self.slopes[i], known) + inner[i]
            centred = evaluate(self.slopes[i], at) + start[i]
            for j, step in enumerate(steps):
                bend = evaluate(self.bends[i][j], known) + (hess[i, j] if j < d else arb(0))
                centred = centred + bend * step
            slope = meet(naive, centred)
            if bool(slope > 0) or bool(slope < 0):
                return True
        return False

    def _is_convex(self, cell: Box) -> bool:
        d, known = self.d, self._known(cell)
        hess = arb_mat(self.networks.hessian(cell[:d]))
        for i in range(d):
            for j in range(d):
                hess[i, j] = hess[i, j] + evaluate(self.bends[i][j], known)
        return positive(hess, 0)

    # --- one box of ϑ -----------------------------------------------------------------------------

    def _around(self, half: Sequence[float], theta: Box) -> Box:
        """The box of y around z*, outwards, and ϑ."""
        pairs = zip(self._at_star, half, strict=True)
        return tuple((_down(lo - h), _up(hi + h)) for (lo, hi), h in pairs) + theta

    def _is_kept(self, held: HeldBox) -> bool:
        """E > h on the sides, and on cells E > h, a slope or the core."""
        theta, level = tuple(held.theta), arb(held.level)
        if not (all(h > 0 for h in held.half) and held.level > 0 and 0 < held.core <= 1):
            return False
        box, half = self._around(held.half, theta), [held.core * h for h in held.half]
        core = self._around(half, theta)
        sizes, reaches = widths(box), self._reaches(box)

        def high(cell: Box) -> bool:
            return bool(self._value(cell) > level)

        def settled(cell: Box) -> bool:
            inner = all(a <= lo and hi <= b for (lo, hi), (a, b)
                        in zip(cell[: self.d], core[: self.d], strict=True))  # fmt: skip
            return inner or high(cell) or self._has_slope(cell)

        def tested(region: Box, test: Callable[[Box], bool]) -> bool:
            return by_bisection(region, test, _DEPTH, sizes=sizes)

        def above(region: Box, test: Callable[[Box], bool]) -> bool:
            return by_bisection(region, test, _DEPTH, sizes=reaches)

        faces = ((*box[:i], (end, end), *box[i + 1 :]) for i in range(self.d) for end in box[i])
        return (
            self._keeps_bounds(box)
            and self._is_defined(box)
            and tested(core, self._is_convex)
            and self._holds_minima(core)
            and all(above(face, high) for face in faces)
            and above(box, settled)
        )

    def _keeps_bounds(self, box: Box) -> bool:
        """Whether bounds that the model names are outside, wherever the set-point is."""
        known = {s: ball(*side) for s, side in zip(self.symbols, box, strict=True)}
        for k, i in enumerate(self.claim.active):
            low, high = self.model.named_bounds[i]
            moved = arb(0)
            if i < self.model.n:
                moved = evaluate(self.family.x_star[i] - self.model.target[i], known)
            at = ball(*box[k]) + moved
            if not (bool(at > low) and bool(at < high)):
                return False
        return True

    def _leaves_momenta_free(self) -> bool:
        return not any(self.model.states[i] in self.model.domain for i in self.whole.resting)

    def _is_defined(self, box: Box) -> bool:
        """Whether all is smooth there, and ∂²H/∂p² ≻ 0."""
        family, whole = self.family, self.whole
        written = [family.H, *family.J, *family.R, *family.G, *self.model.written]
        symbols = [*whole.s, *self.symbols]
        if not is_smooth_on(written, symbols, (*(_ANY for _ in whole.s), *box)):
            return False
        if not whole.s:
            return True

        def heavy(cell: Box) -> bool:
            return positive(evaluated(whole.inertia, self._known(cell)), 0)

        return by_bisection(box, heavy, _DEPTH, sizes=widths(box))

    def _holds_minima(self, core: Box) -> bool:
        """Whether every place at rest of these ϑ is in the core."""
        theta = core[self.d :]
        for box in self.near.boxes:
            if all(a <= hi and lo <= b for (a, b), (lo, hi) in zip(box.theta, theta, strict=True)):
                found = [box.minimum[i] for i in self.claim.active]
                pairs = zip(found, core, strict=False)
                if not all(lo < a and b < hi for (a, b), (lo, hi) in pairs):
                    return False
        return True

    # --- what all have in common ------------------------------------------------------------------

    @cached_property
    def _cells(self) -> list[Box]:
        """The marked cells of y."""
        claim = self.claim
        region = Region(0.0, claim.active, tuple(range(self.d)), (), (None, None), (),
                        claim.grid, (), claim.cells)  # fmt: skip
        sized = len(claim.grid.lo) == len(claim.grid.side) == self.d and claim.grid.parts > 0
        if not sized or not all(side > 0 for side in claim.grid.side):
            raise ValueError("members: a grid of another size")
        return [claim.grid.cell(leaf) for leaf in region.leaves]

    def _are_common(self) -> bool:
        """Every marked cell is in each box, with E ≤ h for all its ϑ."""
        pairs = product(self.claim.boxes, self._cells)
        return all(self._is_low(cell, held, _BESIDE) for held, cell in pairs)

    def _is_low(self, cell: Box, held: HeldBox, depth: int) -> bool:
        box, level = self._inside(held), arb(held.level)
        inside = all(a <= lo and hi <= b for (lo, hi), (a, b) in zip(cell, box, strict=True))
        whole = (*cell, *held.theta)
        return inside and by_bisection(
            whole, lambda c: bool(self._value(c) <= level), depth, sizes=widths(whole)
        )

    def _inside(self, held: HeldBox) -> Box:
        """The box of y around z*, inwards."""
        pairs = zip(self._at_star, held.half, strict=True)
        return tuple((_up(hi - h), _down(lo + h)) for (lo, hi), h in pairs)

    def _has_share(self) -> bool:
        """The volume of marked cells in the domain is at least what is claimed of it."""
        sizes = self.model.domain_sizes
        total, volume = arb(0), arb(1)
        sides = []
        for k, i in enumerate(self.claim.active):
            low, high = self.model.named_bounds[i]
            reach = 2 * arb(sizes[i])
            least = arb(low) if low > -math.inf else self.star[k] - reach
            most = arb(high) if high < math.inf else self.star[k] + reach
            sides.append((least, most))
            volume = volume * (most - least)
        for cell in self._cells:
            part = arb(1)
            for (lo, hi), (a, b) in zip(cell, sides, strict=True):
                length = arb(hi).min(b) - arb(lo).max(a)
                part = part * length.max(arb(0))
            total = total + part
        return bool((total / volume).upper() >= self.claim.share >= 0)

    def _may_step(self) -> bool:
        """From rest at a set-point that is no farther, every member's region is kept."""
        far = self.claim.step
        moving = {p.name: p for p in self.family.parameters if p.kind == "setpoint"}
        if not far:
            return True
        if set(far) != set(moving) or self.claim.left or not all(v >= 0 for v in far.values()):
            return False
        units = self.family.units_of_states
        for i, name in enumerate(self.model.states[: self.model.n]):
            shift = self.family.x_star[i] - self.model.target[i]
            own = (moving[name].symbol - moving[name].nominal) / units[i] if name in moving else 0
            if sp.simplify(shift - own) != 0:
                return False
        return all(self._starts_inside(held, far) for held in self.claim.boxes)

    def _starts_inside(self, held: HeldBox, far: Mapping[str, float]) -> bool:
        gaps = [far.get(p.name, 0.0) for p in self.family.parameters]
        found: list[Box] = []
        for box in self.near.boxes:
            pairs = zip(box.theta, held.theta, gaps, strict=True)
            if all(a <= _up(hi + g) and _down(lo - g) <= b for (a, b), (lo, hi), g in pairs):
                found.append(tuple(box.minimum[i] for i in self.claim.active))
        start = []
        for k, i in enumerate(self.claim.active):
            reach = 0.0
            if i < self.model.n:
                reach = _up(far.get(self.model.states[i], 0.0) / self.model.units.state[i])
            low, high = min(box[k][0] for box in found), max(box[k][1] for box in found)
            start.append((_down(low - reach), _up(high + reach)))
        return self._is_low(tuple(start), held, _DEPTH)


def _down(value: float) -> float:
    return math.nextafter(value, -math.inf)


def _up(value: float) -> float:
    return math.nextafter(value, math.inf)
