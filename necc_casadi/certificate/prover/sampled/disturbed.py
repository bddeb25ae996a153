"""Where the sampled loop comes to and stays under rounding, noise and delay (docs/theory.md)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from necc_casadi.arrays import Truth, Vector
from necc_casadi.certificate.claims.disturbed import Disturbances, DisturbedRegion
from necc_casadi.certificate.claims.regions import numbers, rows
from necc_casadi.certificate.claims.sampled import SampledRegion
from necc_casadi.certificate.claims.statements import NotDisturbed
from necc_casadi.certificate.prover.arithmetic.intervals import Interval, matmul, point
from necc_casadi.certificate.prover.arithmetic.potential import Potential
from necc_casadi.certificate.prover.arithmetic.tables import TabledPotential
from necc_casadi.certificate.prover.sampled.cover import cover, within
from necc_casadi.certificate.prover.sampled.disturbance import Computed, Disturbed, Falls
from necc_casadi.certificate.prover.sampled.metric import Guide
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
#: Boxes that may be looked at, and how often one is halved.
_BOXES, _DEEPEST = 20_000, 120
#: Halves of the core, in units in which ∇²V(z̄) = I and as shares of the one of `sampled`: the first
#: with a radius that is close to the least one.
_CORES, _CLOSE = 2.0 ** -np.arange(1, 22, 2), 1.05
#: Pieces of the periods in the core.
_PIECES = 8
#: Pieces of the box of the region on which errors of the law are bounded.
_PARTS = 729
#: What is given away for other arithmetic: of heights, of w_∞ and of radii.
_EASED, _ABOVE, _RADIUS = 1e-6, 0.02, 0.01
#: α, as multiples of the largest ∇²V(z̄).
_ALPHAS = 2.0 ** np.arange(-3, 9)


def prove_disturbed(
    design: Design, region: SampledRegion, sample_time: float, asked: Disturbances
) -> DisturbedRegion | NotDisturbed:
    """Where solutions from a part of Ω_T come to and stay for periods up to one, s."""
    if design.form.betas or design.setpoints or design.told or design.measurement.of_velocities:
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
    rate: float
    above: float  # w_∞ − V(z̄)
    first: float  # the same while a u that is late may have been computed anywhere
    reach: float  # |C⁻ᵀ(z − z̄)| is at most this


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
        core = self._core(loop)
        if core is None:
            return "near the minimum the disturbances are as large as what they are to leave"
        for share in _RATES:
            rate = share * float(self._fastest(loop).min())
            if rate > 0 and (made := self._cover(loop, core, rate)) is not None:
                return made
        return "no region is proved from which solutions come near the minimum"

    def _cover(self, loop: Disturbed, core: _Core, rate: float) -> DisturbedRegion | None:
        region, design, top = self.region, self.design, self.region.level
        box, computed = self._box, self._everywhere(loop)
        limits = design.natural.loop.plant.u_limits

        wide = replace(loop, step=replace(loop.step, potential=TabledPotential(design.natural)))

        def proof(Z: Interval, s: Interval) -> tuple[Truth, Truth]:
            inner = ((core.box.lo <= Z.lo) & (Z.hi <= core.box.hi)).all(-1)
            found = wide.over(Z, s, rate, computed)
            steep = _length(found.slopes) > found.least * (1 + _EASED)
            kept = found.proved & within(found.inputs, limits)
            return inner | (kept & steep), kept & ~steep

        least = self._bottom + max(core.first / (1 - 2 * _EASED), 0.1 * region.height)
        root = Interval(np.append(box.lo, 0.0), np.append(box.hi, self.period))
        weights = np.append(np.sqrt(np.diag(self._stiffness)), _WEIGHT / self.period)
        got = cover(wide.step, loop.Q, root, top, weights, _BOXES, least, proof, _DEEPEST)
        if not got.level > least:
            return None
        height = (1 - _EASED) * (got.level - self._bottom)
        radius = core.reach * np.sqrt((self._frame**2).sum(0)) * (1 + _RADIUS)
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
            got.tree,
            tuple(zip(numbers(core.box.lo), numbers(core.box.hi), strict=True)),
            core.rate,
            core.above,
            numbers(radius),
        )

    # --- near z̄ -----------------------------------------------------------------------------------

    def _core(self, loop: Disturbed) -> _Core | None:
        """The largest box whose radius is close to the least one that was found."""
        inner = np.array(self.region.core)
        columns = np.sqrt((self._frame**2).sum(0))
        widest = float(((inner[:, 1] - inner[:, 0]) / 2 / columns).min())
        fast = float(self._fastest(loop, near=True).min())
        found = [self._core_of(loop, share * widest, fast) for share in _CORES]
        known = [core for core in found if core is not None]
        if not known:
            return None
        least = min(core.reach for core in known)
        return next(core for core in known if core.reach <= _CLOSE * least)

    def _core_of(self, loop: Disturbed, half: float, fast: float) -> _Core | None:
        """What is proved in a box with |C⁻ᵀ(z − z̄)| ≥ half on its sides."""
        z_bar, columns = self.design.natural.z_bar, np.sqrt((self._frame**2).sum(0))
        box = Interval(z_bar - half * columns, z_bar + half * columns)
        shape = self._shape(box)
        if shape is None or not fast > 0:
            return None
        ends = np.linspace(0.0, self.period, _PIECES + 1)
        Z = Interval(*(np.repeat(v[None], _PIECES, 0) for v in (box.lo, box.hi)))
        s = Interval(*(np.array(v) for v in zip(*pairwise(ends), strict=True)))
        computed, low = self._computed(loop, box), shape[1]
        stages = [computed]
        if loop.delay is not None:  # at first u may have been computed anywhere
            stages.insert(0, replace(computed, earlier=self._everywhere(loop).earlier))
        for share in _CORE_RATES:
            rate = share * fast
            heights = [self._above(loop, Z, s, rate, stage, shape) for stage in stages]
            known = [height for height in heights if height is not None]
            if len(known) < len(stages):
                continue
            reaches = [float(np.sqrt(2 * v / low)) * (1 + _EASED) for v in known]
            if max(reaches) < (1 - _EASED) * half and max(known) < self.region.height:
                return _Core(box, rate, known[-1], max(known), reaches[-1])
            return None
        return None

    def _above(
        self,
        loop: Disturbed,
        Z: Interval,
        s: Interval,
        rate: float,
        computed: Computed,
        shape: tuple[float, float, float],
    ) -> float | None:
        """w_∞ − V(z̄); None: W is not proved to fall, or u to be within its limits."""
        falls, limits = loop.over(Z, s, rate, computed), self.design.natural.loop.plant.u_limits
        if not (falls.proved & within(falls.inputs, limits)).all():
            return None
        return self._highest(loop, falls, rate, shape[0], shape[2]) * (1 + _ABOVE)

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
        found = Computed(seen, *self.rounding.over(seen))
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
        m = plant.m
        plain = Disturbed(
            Step(self._potential, self.region.integrator),
            np.array(self.region.metric),
            self._frame,
            _named(asked.noise, design.loop.plant.states)
            / design.units.state[: -design.loop.controller.nc],
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
        rates = [float(self._fastest(replace(plain, delay=alpha)).min()) for alpha in alphas]
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
        guide = Guide(self.design.natural, loop.Q)
        points = guide.inside(self.region.height, _POINTS)
        points = self.design.natural.z_bar[None] if near else points
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


#: The width of all periods beside that of states in sizes of ∇²V(z̄)^(−1/2).
_WEIGHT = 1.0


def _length(v: Interval) -> Vector:
    """|v| is at least this, (B,)."""
    least = np.maximum(np.maximum(v.lo, -v.hi), 0.0)
    length: Vector = np.sqrt((least**2).sum(-1)) * (1 - _EASED)
    return length


def _named(sizes: Mapping[str, float], names: Sequence[object]) -> Vector:
    """By name; a little more, so that what is said is not less than what is asked."""
    return np.array([sizes.get(str(name), 0.0) for name in names], float) * (1 + _EASED / 100)
