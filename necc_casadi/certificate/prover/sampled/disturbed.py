"""Where the sampled loop comes to and stays under rounding, noise and delay (docs/theory.md)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from necc_casadi.arrays import Truth, Vector
from necc_casadi.certificate.claims.disturbed import Core, Disturbances, DisturbedRegion
from necc_casadi.certificate.claims.regions import Side, numbers, rows
from necc_casadi.certificate.claims.sampled import SampledRegion
from necc_casadi.certificate.claims.statements import NotDisturbed
from necc_casadi.certificate.prover.arithmetic.boxes import subdivide
from necc_casadi.certificate.prover.arithmetic.definite import positive_definite
from necc_casadi.certificate.prover.arithmetic.intervals import Interval, matmul, point
from necc_casadi.certificate.prover.arithmetic.potential import Potential
from necc_casadi.certificate.prover.arithmetic.tables import TabledPotential
from necc_casadi.certificate.prover.measurement import prove_measurement
from necc_casadi.certificate.prover.sampled.cover import Shown, cover, where_above, within
from necc_casadi.certificate.prover.sampled.disturbance import Computed, Disturbed, Falls
from necc_casadi.certificate.prover.sampled.measured import Measured
from necc_casadi.certificate.prover.sampled.metric import Guide
from necc_casadi.certificate.prover.sampled.prove import rates_of_change
from necc_casadi.certificate.prover.sampled.rounding import Rounding, programs, unit
from necc_casadi.certificate.prover.sampled.step import Step
from necc_casadi.designs.design import Design

__all__ = ["prove_disturbed"]


#: The shortest period, as a share of the longest, where none is asked for: rounding of ξ costs
#: nothing there, since what it leaves is kept.
_SHORTEST = 0.01
#: Shares of the fastest fall at points that are asked for on boxes, and near z̄.
_RATES, _CORE_RATES = (0.4, 0.15), (0.95, 0.85, 0.6, 0.3)
#: States and shares of the longest period at which it is looked at.
_POINTS, _SHARES = 60, (0.02, 0.5, 1.0)
#: Boxes that may be looked at.
_BOXES = 20_000
#: Halves of cores, in units in which ∇²V(z̄) = I and as shares of the one of `sampled`; how close to
#: the least radius that of the last one is; the share of the height that is worth having.
_CORES, _CLOSE, _LEAST = 2.0 ** -np.arange(1, 17.0), 1.05, 0.1
#: A slope outside of the first core, as a share of the half of it, and as a multiple of what states
#: of the region need; pieces of a side of the core of `sampled` on which ∇²V is bounded.
_STEEP, _ROOM, _CUTS = 0.5, 2.0, 3
#: Pieces of the periods in the core.
_PIECES = 8
#: Pieces of the box of the region on which errors of the law are bounded.
_PARTS = 729
#: What is given away for other arithmetic: of heights, of w_∞ and of radii.
_EASED, _ABOVE, _RADIUS = 1e-6, 0.02, 0.01
#: α, as multiples of the largest ∇²V(z̄), and at which of the states it is chosen.
_ALPHAS, _EVERY = 2.0 ** np.arange(-2, 9), 4


def prove_disturbed(
    design: Design, region: SampledRegion, sample_time: float, asked: Disturbances
) -> DisturbedRegion | NotDisturbed:
    """Where solutions from a part of Ω_T come to and stay for periods up to one, s."""
    measured = prove_measurement(design)
    if measured is not None and not measured.holds:
        return "velocities are measured, and p = M(q)q̇ is not proved"
    if design.setpoints or design.told:
        return "set-points or parameters at run time are not covered"
    if design.form.betas:
        return "the law that the C code computes is not of the kind that is covered"
    made = programs(design)
    if made is None:
        return "the law has an operation whose rounding is not known"
    period = sample_time / design.units.time
    proof = _Proof(design, region, Rounding(design, asked.precision, *made), asked, period)
    return proof.found()


@dataclass(frozen=True, eq=False)
class _Core:
    """A box around z̄ in which solutions come to rest, as far as they do."""

    box: Interval  # (N,)
    half: float  # |C⁻ᵀ(z − z̄)| on its sides is at least this
    low: float  # 2(W − V(z̄)) ≥ low |C⁻ᵀ(z − z̄)|² in it
    rate: float
    least: float  # δ
    above: float  # w_∞ − V(z̄)
    earlier: Vector | None  # errors of a u that was computed in it, where u is late

    @property
    def reach(self) -> float:
        """|C⁻ᵀ(z − z̄)| at most, in the end."""
        return self.holding(self.above)

    def holding(self, above: float) -> float:
        """|C⁻ᵀ(z − z̄)| at most where W is below."""
        return float(np.sqrt(2 * above / self.low)) * (1 + _EASED)

    def holds(self, above: float) -> bool:
        """Whether {W − V(z̄) ≤ above} is inside."""
        return self.holding(above) < (1 - _EASED) * self.half


@dataclass(frozen=True, eq=False)
class _Proof:
    """The search for one design."""

    design: Design
    region: SampledRegion
    rounding: Rounding
    asked: Disturbances
    period: float
    _known: dict[Disturbed, Computed] = field(default_factory=dict)

    def found(self) -> DisturbedRegion | NotDisturbed:
        loop = self._loop
        if loop is None:
            return "with a delay of one sample no function is found that falls"
        cores = self._cores(loop)
        if not cores:
            return "near the minimum the disturbances are as large as what they are to leave"
        fast = float(self._fastest(loop).min())
        for share in _RATES if fast > 0 else ():
            for slope in self._slopes(loop, cores[0], share * fast):
                made = self._cover(loop, cores, share * fast, slope)
                if made is not None:
                    return made
        return "no region is proved from which solutions come near the minimum"

    def _cover(
        self, loop: Disturbed, cores: list[_Core], rate: float, slope: float
    ) -> DisturbedRegion | None:
        region, design, first, last = self.region, self.design, cores[0], cores[-1]
        box, computed = self._box, self._everywhere(loop)
        limits = design.natural.loop.plant.u_limits
        wide = replace(loop, step=replace(loop.step, potential=TabledPotential(design.natural)))
        convex = self._is_steeper(slope / first.half)
        around = Interval(*np.array(region.core).T) if convex else first.box

        def steep(Z: Interval, _: Interval) -> Truth:
            inner = ((around.lo <= Z.lo) & (Z.hi <= around.hi)).all(-1)
            g = matmul(point(loop.frame[None]), wide.step.potential.jet(Z).grad[..., None])[..., 0]
            return np.asarray(inner | (_length(g) > slope * (1 + _EASED)), dtype=bool)

        def proof(Z: Interval, s: Interval) -> Shown:
            found = wide.over(Z, s, rate, computed)
            small = found.least < slope * (1 - _EASED)
            return Shown(found.proved & within(found.inputs, limits) & small)

        least = self._bottom + max(first.above / (1 - 2 * _EASED), _LEAST * region.height)
        top = where_above(wide.step.potential, loop.Q, box, region.level, _BOXES, least, steep)
        if not top > least:
            return None
        root = Interval(np.append(box.lo, 0.0), np.append(box.hi, self.period))
        guide, points = Guide(design.natural, loop.Q), self._points(loop)
        weights = rates_of_change(wide.step, guide, points, self.period)
        got = cover(wide.step, loop.Q, root, top, weights, _BOXES, least, proof)
        if not got.level > least:
            return None
        height = (1 - _EASED) * (got.level - self._bottom)
        radius = last.reach * np.sqrt((self._frame**2).sum(0)) * (1 + _RADIUS)
        return DisturbedRegion(
            loop.shortest,
            self.period,
            self.asked.precision,
            numbers(loop.noise),
            numbers(loop.input_error),
            loop.delay,
            self.rounding.casimirs,
            self.rounding.law,
            rows(self._frame),
            got.level,
            height,
            rate,
            slope,
            got.tree,
            tuple(Core(_sides(core.box), core.rate) for core in cores),
            last.above,
            numbers(radius),
        )

    def _slopes(self, loop: Disturbed, first: _Core, rate: float) -> list[float]:
        """Slopes to try, from what is needed at states of the region to what there is."""
        points, T = self._points(loop), self.period
        at, s = Interval(points, points), np.full(len(points), T)
        needed = loop.over(at, Interval(s, s), rate, self._everywhere(loop)).least
        widest = _STEEP * first.half
        close = max(_ROOM * float(np.nanmax(needed)), float(np.sqrt(first.least * widest)))
        return sorted({min(close, widest), widest})

    def _points(self, loop: Disturbed) -> Vector:
        return Guide(self.design.natural, loop.Q).inside(self.region.height, _POINTS)

    def _is_steeper(self, mu: float) -> bool:
        """Whether C∇²VCᵀ ⪰ μI on the core of `sampled`, so that |C∇V| ≥ μ|C⁻ᵀ(z − z̄)| in it."""
        back = np.linalg.inv(self._frame)
        least = mu * (1 + 1e3 * _EASED) * back @ back.T
        pieces = subdivide(Interval(*np.array(self.region.core).T), _CUTS)
        bent = self._potential.lower_hessian(pieces) - (least + least.T) / 2
        return bool(positive_definite(bent).all())

    # --- near z̄ -----------------------------------------------------------------------------------

    def _cores(self, loop: Disturbed) -> list[_Core]:
        """The largest box that solutions stay in, and the largest in it that is close to the best.

        Where u is late, the first u in a box was computed before solutions were in it: the last box
        counts once more with what is computed in it.
        """
        inner = np.array(self.region.core)
        columns = np.sqrt((self._frame**2).sum(0))
        widest = float(((inner[:, 1] - inner[:, 0]) / 2 / columns).min())
        fast = float(self._fastest(loop, near=True).min())
        late = None if loop.delay is None else self._everywhere(loop).earlier
        halves = [float(share * widest) for share in _CORES]
        first = next((c for h in halves if (c := self._core_of(loop, h, fast, late))), None)
        if first is None:
            return []
        inside = (self._core_of(loop, h, fast, first.earlier) for h in halves if h <= first.half)
        known = [core for core in inside if core is not None and core.holds(first.above)]
        least = min((core.reach for core in known), default=first.reach)
        best = next((core for core in known if core.reach <= _CLOSE * least), first)
        cores = [first] if best.half == first.half else [first, best]
        again = None if late is None else self._core_of(loop, best.half, fast, best.earlier)
        return cores if again is None else [*cores, again]

    def _core_of(
        self, loop: Disturbed, half: float, fast: float, earlier: Vector | None
    ) -> _Core | None:
        """What is proved in a box with |C⁻ᵀ(z − z̄)| ≥ half on its sides."""
        z_bar, columns = self.design.natural.z_bar, np.sqrt((self._frame**2).sum(0))
        box = Interval(z_bar - half * columns, z_bar + half * columns)
        shape = self._shape(box)
        if shape is None or not fast > 0:
            return None
        ends = np.linspace(0.0, self.period, _PIECES + 1)
        Z = Interval(*(np.repeat(v[None], _PIECES, 0) for v in (box.lo, box.hi)))
        s = Interval(*(np.array(v) for v in zip(*pairwise(ends), strict=True)))
        own, limits = self._computed(loop, box), self.design.natural.loop.plant.u_limits
        computed = replace(own, earlier=earlier)
        for share in _CORE_RATES:
            rate = share * fast
            falls = loop.over(Z, s, rate, computed)
            if not (falls.proved & within(falls.inputs, limits)).all():
                continue
            above = self._highest(loop, falls, rate, shape[0], shape[2]) * (1 + _ABOVE)
            least = float(falls.least.max())
            core = _Core(box, half, shape[1], rate, least, above, own.earlier)
            return core if core.holds(above) and above < self.region.height else None
        return None

    def _highest(
        self, loop: Disturbed, falls: Falls, rate: float, near: float, high: float
    ) -> float:
        """W, or S, above V(z̄) at most where it may not fall, and after a sample from there."""
        least = float(falls.least.max())
        top = high / 2 / (1 - near) ** 2
        if loop.delay is not None:
            top = max(top, 2 * rate * self.period)  # αT|e|² with α|e|²/(2 rate) ≤ δ²
        return top * least**2 + float(falls.rise.max())

    def _shape(self, box: Interval) -> tuple[float, float, float] | None:
        """‖C∇²VCᵀ − I‖ at most, and bounds of 2(W − V(z̄))/|C⁻ᵀ(z − z̄)|² over a box around z̄."""
        C = self._frame
        over, Z = self._potential, Interval(box.lo[None], box.hi[None])
        S = (over.sharp_jet(Z) if over.has_sharp_jet else over.jet(Z)).hess
        turned = matmul(matmul(point(C[None]), S), point(C.T[None])) - np.eye(len(C))
        near = float(np.sqrt((turned.magnitude**2).sum())) * (1 + _EASED)
        back = np.linalg.inv(C)
        metric = back.T @ np.array(self.region.metric) @ back
        values = np.linalg.eigvalsh((metric + metric.T) / 2)
        size = float(np.abs(values).max())
        off = (near + (2 * near + near**2) * size) * (1 + _EASED) + _EASED
        low, high = 1 + float(values[0]) - off, 1 + float(values[-1]) + off
        return (near, low, high) if near < 1 and low > 0 else None

    # --- what is known before ---------------------------------------------------------------------

    def _computed(self, loop: Disturbed, box: Interval, pieces: int = 1) -> Computed:
        """On a box, a u that is late computed on it, too."""
        seen = loop.seen(box)
        measured = loop.measured.over(seen[None])[0]
        found = Computed(seen, *self.rounding.over(measured))
        late = None if loop.delay is None else loop.earlier(box, found, pieces)
        return replace(found, earlier=late)

    def _everywhere(self, loop: Disturbed) -> Computed:
        """On the box of the region, once for each loop."""
        if loop not in self._known:
            self._known[loop] = self._computed(loop, self._box, _PARTS)
        return self._known[loop]

    @cached_property
    def _box(self) -> Interval:
        return Interval(*np.array(self.region.box).T)

    @cached_property
    def _loop(self) -> Disturbed | None:
        """The disturbed loop, with the α that lets S fall fastest; None: none is found."""
        design, asked, plant = self.design, self.asked, self.design.loop.plant
        m, measured = plant.m, Measured(design)
        plain = Disturbed(
            Step(self._potential, self.region.integrator),
            measured,
            np.array(self.region.metric),
            self._frame,
            _named(asked.noise, design.measurement.names) / measured.units[: plant.n],
            _named(asked.input_error, plant.input_names) / design.units.input,
            unit(asked.precision)[0],
            self._shortest,
            self.period,
            None,
            np.zeros(m),
        )
        if not asked.delayed:
            return plain
        scale = float(np.linalg.eigvalsh(self._stiffness)[-1])
        alphas = [float(scale * a) for a in _ALPHAS]
        some = self._points(plain)[::_EVERY]
        rates = [float(self._rates(replace(plain, delay=a), some).min()) for a in alphas]
        best = int(np.argmax(rates))
        if not rates[best] > 0:
            return None
        height = self.region.height * (1 + _EASED)
        most = float(np.sqrt(height / (alphas[best] * self.period)))
        return replace(plain, delay=alphas[best], reach=np.full(m, most * (1 + _EASED)))

    @property
    def _shortest(self) -> float:
        least = self.asked.shortest
        least = _SHORTEST * self.period if least is None else least / self.design.units.time
        return least * (1 - _EASED / 100)

    def _fastest(self, loop: Disturbed, near: bool = False) -> Vector:
        """Rates at states of the region, or at z̄."""
        return self._rates(loop, self.design.natural.z_bar[None] if near else self._points(loop))

    def _rates(self, loop: Disturbed, points: Vector) -> Vector:
        Z = np.repeat(points, len(_SHARES), 0)
        return loop.largest_rate(Z, np.tile(np.array(_SHARES) * self.period, len(points)))

    @cached_property
    def _potential(self) -> Potential:
        return Potential(self.design.natural)

    @cached_property
    def _stiffness(self) -> Vector:
        natural = self.design.natural
        S = natural.lyapunov.hessian(natural.z_bar)
        return np.asarray((S + S.T) / 2)

    @cached_property
    def _frame(self) -> Vector:
        """C with CSCᵀ = I at z̄."""
        return np.asarray(np.tril(np.linalg.inv(np.linalg.cholesky(self._stiffness))))

    @cached_property
    def _bottom(self) -> float:
        z_bar = self.design.natural.z_bar[None]
        return float(self._potential.jet(Interval(z_bar, z_bar)).value.hi[0])


def _sides(box: Interval) -> tuple[Side, ...]:
    return tuple(zip(numbers(box.lo), numbers(box.hi), strict=True))


def _length(v: Interval) -> Vector:
    """|v| is at least this, (B,)."""
    least = np.maximum(np.maximum(v.lo, -v.hi), 0.0)
    length: Vector = np.sqrt((least**2).sum(-1)) * (1 - _EASED)
    return length


def _named(sizes: Mapping[str, float], names: Sequence[object]) -> Vector:
    """By name; a little more, so that what is said is not less than what is asked."""
    return np.array([sizes.get(str(name), 0.0) for name in names], float) * (1 + _EASED / 100)
