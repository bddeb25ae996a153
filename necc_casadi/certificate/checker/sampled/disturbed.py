"""The claim about the sampled loop under rounding, noise and delay, proved again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property, reduce
from itertools import pairwise

import numpy as np
from flint import arb, arb_mat

from necc_casadi.certificate.checker.arithmetic.balls import Box, by_bisection
from necc_casadi.certificate.checker.arithmetic.definite import middle_of, positive
from necc_casadi.certificate.checker.evidence import Checked, Evidence, Obligation
from necc_casadi.certificate.checker.measurement import gives_momenta
from necc_casadi.certificate.checker.sampled.disturbance import Computed, DisturbedStep, Falls, cut
from necc_casadi.certificate.checker.sampled.rounding import RoundingProof
from necc_casadi.certificate.checker.sampled.sampled import HALVINGS, SampledProof
from necc_casadi.certificate.checker.sampled.step import StepProof
from necc_casadi.certificate.claims import statements
from necc_casadi.certificate.claims.disturbed import Core, DisturbedRegion
from necc_casadi.certificate.claims.sampled import BEYOND, SampledRegion

__all__ = ["check_disturbed"]


#: Room for eigenvalues, as a share of the largest.
_SLACK = 1e-9
#: How often a box of the certificate may be halved again; pieces of the periods near z̄.
_AGAIN, _PIECES = 16, 8
#: How often the core of `sampled` may be halved.
_DEEP = 12
#: Pieces of the box of the region on which errors of the law are bounded.
_PARTS = 729
#: Pieces of a core on which ∇²V is enclosed.
_HULLS = 256


def check_disturbed(evidence: Evidence, sampled: bool) -> Checked:
    """Where solutions from a part of Ω_T come to and stay; `sampled` is held of Ω_T."""
    if not evidence.claimed("disturbed") or not evidence.claimed("sampled"):
        return Checked("disturbed", False, "nothing is claimed of rounding, noise and delay")
    model = evidence.model
    region = SampledRegion.read(evidence.claims["sampled"].data)
    found = DisturbedRegion.read(evidence.claims["disturbed"].data)
    size, m = len(model.z), model.m
    square = len(found.frame) == size and all(len(row) == size for row in found.frame)
    fits = (len(found.noise), len(found.input_error)) == (model.n, m)
    if not (square and fits and len(found.radius) == size and _fit(found.cores, size)):
        raise ValueError("what is claimed of disturbances does not fit the states")
    if not found.leaves(region):
        raise ValueError("the sampled region has no boxes")
    text = statements.disturbed(
        found, model.states, model.inputs, model.units, model.input_units, model.inertia is not None
    )
    claim: Obligation = ("the claim about the sampled loop", lambda: sampled)
    if not sampled:
        return Checked.by("disturbed", text, [claim])
    return Checked.by("disturbed", text, _Disturbed(evidence, region, found).obligations())


class _Disturbed:
    """What has to be proved of {W < w₁} and {W < w_∞}."""

    def __init__(self, evidence: Evidence, region: SampledRegion, found: DisturbedRegion) -> None:
        self.evidence, self.model, self.region, self.found = evidence, evidence.model, region, found
        self.exact = SampledProof(evidence, region)
        self.energy = evidence.full
        step = StepProof(self.model, self.energy, region.integrator)
        self.step = DisturbedStep(step, arb_mat([list(row) for row in region.metric]), found)
        self.rounding = RoundingProof(
            step, self.step.measured, found.precision, found.casimirs, found.law
        )
        self.z_bar = evidence.z_bar(range(len(self.model.z)))
        self.columns = [
            sum((v * v for (v,) in _column(self.step.frame, i)), arb(0)).sqrt()
            for i in range(len(self.model.z))
        ]

    def obligations(self) -> list[Obligation]:
        """Each in words, with its proof."""
        return [
            ("numbers that are meant", self._is_meant),
            ("a law of what is measured alone, with one network of Casimirs", self._is_covered),
            ("q̇ of the plant at p = M(q)q̇", self._is_measured),
            ("the operations are those of the law", self._is_of_this_law),
            ("the height above V(z̄)", self._is_above),
            ("what is left near z̄", self._comes_near),
            ("V is steep outside of the first core", self._is_steep),
            ("W falls at every step, on every box", self._on_every_box),
        ]

    def _is_meant(self) -> bool:
        found, region = self.found, self.region
        sizes = (*found.noise, *found.input_error)
        lower = all(v == 0 for i, row in enumerate(found.frame) for v in row[i + 1 :]) and all(
            row[i] > 0 for i, row in enumerate(found.frame)
        )
        return (
            0 < found.shortest <= found.period <= region.period
            and found.level <= region.level
            and min(found.height, found.rate, found.slope, found.above, *found.radius) > 0
            and (found.delay is None or found.delay > 0)
            and all(v >= 0 for v in sizes)
            and lower
            and all(core.rate > 0 and _inside(core.box, region.box) for core in found.cores)
        )

    def _is_covered(self) -> bool:
        model = self.model
        plain = not model.setpoints and not model.told_ranges
        return plain and not model.form["betas"] and model.form["phi"] is None

    def _is_measured(self) -> bool:
        return self.model.inertia is None or gives_momenta(self.model)

    def _is_of_this_law(self) -> bool:
        return self.rounding.is_of_this_law(self.region.box)

    def _is_above(self) -> bool:
        bottom = self.energy.value(self.z_bar)
        return bool(bottom + self.found.height <= self.found.level)

    def _computed(self, box: Box, pieces: int = 1) -> Computed:
        seen = self.step.seen(box)
        inputs, rates = self.rounding.over(seen)
        late = [] if self.found.delay is None else self.step.earlier(box, inputs, pieces)
        return Computed(seen, inputs, rates, late)

    def _kept(self, falls: Falls) -> bool:
        limits = self.model.u_limits or ()
        pairs = zip(falls.inputs, limits, strict=False)
        return all(bool(v >= lo) and bool(v <= hi) for v, (lo, hi) in pairs)

    # --- near z̄ -----------------------------------------------------------------------------------

    def _comes_near(self) -> bool:
        """W may rise in a core alone, up to some height, below which all is inside of the next."""
        found, above, late = self.found, arb(0), self._everywhere.earlier
        for core in found.cores:
            shape, computed = self._shape(core), self._computed(core.box)
            if shape is None or not self._holds(core, above, shape):
                return False
            highest = self._highest(core, replace(computed, earlier=late), shape)
            if highest is None or not self._holds(core, highest, shape):
                return False
            above, late = highest, computed.earlier
        return bool(above <= found.above) and self._is_near(found.cores[-1])

    def _is_near(self, last: Core) -> bool:
        """Whether the radii follow from w_∞."""
        limit, shape = arb(self.found.above), self._shape(last)
        if shape is None or not self._holds(last, limit, shape):
            return False
        reach = self._reach(limit, shape)
        radii = zip(self.columns, self.found.radius, strict=True)
        return all(bool(reach * c <= r) for c, r in radii)

    @staticmethod
    def _reach(above: arb, shape: tuple[arb, arb, arb]) -> arb:
        """|C⁻ᵀ(z − z̄)| at most where W − V(z̄) ≤ above."""
        return (2 * above / shape[1]).sqrt()

    def _holds(self, core: Core, above: arb, shape: tuple[arb, arb, arb]) -> bool:
        """Whether {W − V(z̄) ≤ above} is inside of a core, and below w₁."""
        reach = self._reach(above, shape)
        sides = zip(core.box, self.z_bar, self.columns, strict=True)
        return bool(above < self.found.height) and all(
            bool(arb(lo) < arb(a) - reach * c) and bool(arb(b) + reach * c < arb(hi))
            for (lo, hi), (a, b), c in sides
        )

    def _highest(self, core: Core, computed: Computed, shape: tuple[arb, arb, arb]) -> arb | None:
        """W, or S, above V(z̄) at most where it may not fall, and after a sample; None: unknown."""
        found, (near, _, high) = self.found, shape
        rate = arb(core.rate)
        gradient, _ = self.exact.gradient_and_hessian(core.box)
        ends = [found.period * k / _PIECES for k in range(_PIECES)] + [found.period]
        least = rise = arb(0)
        for period in pairwise(ends):
            falls = self.step.over(core.box, period, gradient, rate, computed)
            if falls is None or not self._kept(falls):
                return None
            least, rise = least.max(falls.least), rise.max(falls.rise)
        top = high / 2 / (1 - near) ** 2
        if found.delay is not None:
            top = top.max(arb(found.delay) * arb(found.period) / self.step.weight(rate))
        return (top * least**2 + rise).upper()

    def _shape(self, core: Core) -> tuple[arb, arb, arb] | None:
        """‖C∇²VCᵀ − I‖ at most, and bounds of 2(W − V(z̄))/|C⁻ᵀ(z − z̄)|² in a core."""
        C, back = self.step.frame, self.step.back
        size = len(self.model.z)
        identity = arb_mat([[int(i == j) for j in range(size)] for i in range(size)])
        near = _frobenius(C * self._hull(core.box) * C.transpose() - identity)
        metric = back.transpose() * self.step.Q * back
        return self._bounds(near, metric)

    def _hull(self, box: Box) -> arb_mat:
        """∇²V over a box, in pieces: balls of closed forms are wide where a box is."""
        hulls = (self.energy.hull(piece) for piece in cut(box, _HULLS))
        size = range(len(box))
        return reduce(
            lambda a, b: arb_mat([[a[i, j].union(b[i, j]) for j in size] for i in size]),
            map(arb_mat, hulls),
        )

    def _bounds(self, near: arb, metric: arb_mat) -> tuple[arb, arb, arb] | None:
        values = _extremes(metric)
        if values is None:
            return None
        low, high = values
        size = abs(low).max(abs(high)).upper()
        off = near + (2 * near + near * near) * size
        low, high = (1 + low - off).lower(), (1 + high + off).upper()
        return (near, low, high) if bool(near < 1) and bool(low > 0) else None

    # --- everywhere else --------------------------------------------------------------------------

    def _on_every_box(self) -> bool:
        return all(
            self._proved(cell, node, _AGAIN) for cell, node in self.found.leaves(self.region)
        )

    @cached_property
    def _everywhere(self) -> Computed:
        return self._computed(self.region.box, _PARTS)

    def _is_steep(self) -> bool:
        """|C∇V| is larger than the slope that is claimed, outside of the first core.

        In the core of `sampled` it is, where C∇²VCᵀ ⪰ μI with |C∇V| ≥ μ|C⁻ᵀ(z − z̄)|.
        """
        first = self.found.cores[0].box
        sides = zip(first, self.z_bar, self.columns, strict=True)
        half = reduce(
            arb.min,
            (((arb(hi) - arb(b)).min(arb(a) - arb(lo))) / c for (lo, hi), (a, b), c in sides),
        )
        mu = (arb(self.found.slope) / half).upper() if bool(half > 0) else arb(1)
        if self._is_steeper(float(mu) * (1 + _SLACK)):
            first = self.region.core

        def settled(box: Box, W: arb, slope: list[arb]) -> bool:
            core = zip(first, box, strict=True)
            if bool(self.found.level < W) or all(a <= lo and hi <= b for (a, b), (lo, hi) in core):
                return True
            gradient, _ = self.exact.gradient_and_hessian(box)
            turned = self.step.frame * arb_mat([[v] for v in gradient])
            length = sum((v.abs_lower() ** 2 for (v,) in turned.tolist()), arb(0)).lower()
            return bool(length > arb(self.found.slope) ** 2)

        return self.exact.nowhere(self.region.box, settled, HALVINGS)

    def _is_steeper(self, mu: float) -> bool:
        """Whether C∇²VCᵀ ⪰ μI on the core of `sampled`."""
        C = self.step.frame
        return by_bisection(
            self.region.core,
            lambda box: positive(C * self.energy.hessian(box) * C.transpose(), mu),
            _DEEP,
        )

    def _proved(self, cell: Box, node: int, left: int) -> bool:
        box = cell[:-1]
        if self._beyond(box) or (node != BEYOND and self._falls(box, cell[-1])):
            return True
        if left == 0:
            return False
        root = (*self.region.box, (0.0, self.found.period))
        shares = [(hi - lo) / (b - a) for (lo, hi), (a, b) in zip(cell, root, strict=True)]
        k = max(range(len(cell) - (node == BEYOND)), key=shares.__getitem__)
        lo, hi = cell[k]
        middle = lo / 2 + hi / 2
        return all(
            self._proved((*cell[:k], half, *cell[k + 1 :]), node, left - 1)
            for half in ((lo, middle), (middle, hi))
        )

    def _beyond(self, box: Box) -> bool:
        return bool(self.found.level < self.exact.level_and_slope(box)[0])

    def _falls(self, box: Box, period: tuple[float, float]) -> bool:
        gradient, _ = self.exact.gradient_and_hessian(box)
        falls = self.step.over(box, period, gradient, arb(self.found.rate), self._everywhere)
        return falls is not None and self._kept(falls) and bool(falls.least < self.found.slope)


def _fit(cores: Sequence[Core], size: int) -> bool:
    return bool(cores) and all(len(core.box) == size for core in cores)


def _inside(box: Box, whole: Box) -> bool:
    return all(a < lo < hi < b for (a, b), (lo, hi) in zip(whole, box, strict=True))


def _column(A: arb_mat, i: int) -> list[list[arb]]:
    return [[row[i]] for row in A.tolist()]


def _frobenius(A: arb_mat) -> arb:
    return sum((v.abs_upper() ** 2 for row in A.tolist() for v in row), arb(0)).upper().sqrt()


def _extremes(A: arb_mat) -> tuple[arb, arb] | None:
    """Bounds of the eigenvalues of a symmetric matrix."""
    A = (A + A.transpose()) / 2
    values = np.linalg.eigvalsh(middle_of(A))
    slack = _SLACK * float(np.abs(values).max() + 1)
    low, high = float(values[0]) - slack, float(values[-1]) + slack
    proved = positive(A, low) and positive(-A, -high)
    return (arb(low), arb(high)) if proved else None
