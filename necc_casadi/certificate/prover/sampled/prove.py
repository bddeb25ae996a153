"""The sampled loop: {W < w₀} from which it converges, whatever the periods (docs/theory.md)."""

from __future__ import annotations

from itertools import product

import numpy as np

from necc_casadi.arrays import Vector
from necc_casadi.cases import Integrator
from necc_casadi.certificate.claims.certificate import Certificate
from necc_casadi.certificate.claims.regions import numbers, rows
from necc_casadi.certificate.claims.sampled import SampledRegion
from necc_casadi.certificate.claims.statements import NotSampled
from necc_casadi.certificate.prover.arithmetic.boxes import subdivide
from necc_casadi.certificate.prover.arithmetic.definite import positive_definite
from necc_casadi.certificate.prover.arithmetic.intervals import Interval, point
from necc_casadi.certificate.prover.arithmetic.potential import Potential
from necc_casadi.certificate.prover.arithmetic.tables import TabledPotential
from necc_casadi.certificate.prover.region.bounds import bounds_of
from necc_casadi.certificate.prover.sampled.cover import (
    cover,
    falls,
    is_never_clipped,
    level_by_states,
)
from necc_casadi.certificate.prover.sampled.metric import Guide, choose_metric
from necc_casadi.certificate.prover.sampled.step import Step
from necc_casadi.designs.design import Design
from necc_casadi.model.shaped_loop import ShapedLoop

__all__ = ["prove_sampled", "rates_of_change"]


#: States at which Q is chosen, and random starts of the domain beside its corners.
_POINTS, _STARTS = 400, 200
#: States at which it is looked how fast Π changes.
_FEW = 60
#: Shares of the height that are tried, and boxes that may be looked at for each; a share is reached
#: where this much of it is.
_SHARES = ((1.0, 20_000), (0.4, 6_000), (0.1, 6_000), (0.03, 6_000), (0.01, 6_000))
_ENOUGH = 0.9
#: Boxes of states alone.
_CELLS = 20_000
#: Boxes for each longer period that is tried, and by which factors: the first as long as it
#: succeeds, then the second.
_LONGER, _FACTORS, _TRIALS = 10_000, (2.0, 2.0**0.5), 8
#: The share of the height that a longer period has to reach.
_AS_HIGH = 0.999
#: The share of w₀ − V(z̄) that is given away, for other arithmetic.
_EASED = 1e-6
#: The core reaches this share of the way to the box, and is made smaller by this factor.
_CORE, _SMALLER, _TRIES = 0.9, 0.8, 30
#: A step of finite differences, in sizes; a share of the fastest change that every state has.
_APART, _LEAST = 0.02, 0.02


def prove_sampled(
    design: Design, certificate: Certificate, sample_time: float, integrator: Integrator
) -> SampledRegion | NotSampled:
    """The region from which the sampled loop converges for all periods up to one (s), or longer.

    It is as high as Ω where the certificate has one, and otherwise as what holds the starts of the
    domain, or lower where that is not proved.
    """
    natural = design.natural
    missing = _missing(natural, certificate, integrator)
    if missing is not None:
        return missing
    period = sample_time / design.units.time
    step, height = Step(TabledPotential(natural), integrator), _height(design, certificate)
    best: SampledRegion | None = None
    for share, most in _SHARES:
        found = _region(step, period, share * height, most)
        if found is not None and (best is None or found.height > best.height):
            best = found
        if best is not None and best.height >= _ENOUGH * share * height:
            break
    if best is None:
        return "no region is proved for the sample time asked for"
    return _longest(step, best)


def _longest(step: Step, found: SampledRegion) -> SampledRegion:
    """The region of the longest period that was found to reach as high."""
    for factor in _FACTORS:
        for _ in range(_TRIALS):
            longer = _region(step, factor * found.period, found.height, _LONGER, _AS_HIGH)
            if longer is None:
                break
            found = longer
    return found


def _missing(design: Design, certificate: Certificate, integrator: Integrator) -> NotSampled | None:
    held = {claim.name for claim in certificate.claims if claim.holds}
    if not {"equilibrium", "decrease"} <= held:
        return "V is not proved to decrease around a proved minimum"
    if design.form.phi is not None:
        return "only Φ = H + Hc + C is covered"
    other = isinstance(design.loop, ShapedLoop) or design.loop.plant.preliminary is not None
    if other or design.integral is not None:
        return "only the published loop is covered"
    if integrator not in ("euler", "heun"):
        return "only Euler's and Heun's methods are covered"
    controller = design.loop.controller
    if any(A.has(*controller.xi) for A in (controller.Jc, controller.Rc, controller.Gc)):
        return "the structure of the controller depends on its states"
    return None


def _height(design: Design, certificate: Certificate) -> float:
    """How far above V(z̄) the region is to reach, in natural units."""
    if certificate.level_above_minimum is not None:
        return certificate.level_above_minimum / design.units.energy
    natural, n = design.natural, design.loop.plant.n
    lo, hi = natural.domain.lo[:n], natural.domain.hi[:n]
    corners = np.array(list(product(*zip(lo, hi, strict=True)))[:_STARTS])
    random = np.random.default_rng(natural.seed).uniform(lo, hi, (_STARTS, n))
    starts = [np.concatenate([x, natural.xi_at_start(x)]) for x in (*corners, *random)]
    return float((natural.lyapunov.V(np.array(starts)) - natural.V(natural.z_bar)).max())


def _region(
    step: Step, period: float, height: float, most: int, enough: float = 0.0
) -> SampledRegion | None:
    """{W < w₀} with w₀ − V(z̄) up to a height, by as many boxes; None: less than enough of it."""
    potential, design = step.potential, step.potential.design
    plain = Guide(design, np.zeros((design.loop.n,) * 2))
    points = plain.inside(height, _POINTS)
    Q = choose_metric(step, points, period)
    if Q is None:
        return None
    guide = Guide(design, Q)
    box = guide.box_around(height)
    if box is None:
        return None
    box = box.meet(bounds_of(design))
    bottom = float(potential.jet(Interval(design.z_bar[None], design.z_bar[None])).value.hi[0])
    core = _core(potential, box)
    root = Interval(np.append(box.lo, 0.0), np.append(box.hi, period))
    least = bottom + enough * height
    level = level_by_states(potential, Q, box, core, bottom + height, _CELLS, least)
    if not level > least:
        return None
    few = points[:_FEW]
    weights, clipping = rates_of_change(step, guide, few, period), _clipping(step, guide, few)
    found = cover(step, Q, root, level, weights, most, least, falls(step, Q, clipping))
    if not found.level > least:
        return None
    clipped = _seen_to_clip(step, guide, found.level - bottom)
    clipped = clipped or not is_never_clipped(step, Q, box, found.level, _CELLS)
    return SampledRegion(
        period,
        "euler" if step.integrator == "euler" else "heun",
        rows(Q),
        found.level,
        (1 - _EASED) * (found.level - bottom),
        tuple(zip(numbers(box.lo), numbers(box.hi), strict=True)),
        tuple(zip(numbers(core.lo), numbers(core.hi), strict=True)),
        clipped,
        found.tree,
    )


def _clipping(step: Step, guide: Guide, points: Vector) -> Vector:
    """How fast Π changes with each state and the period where u is limited, (channels, N + 1).

    A share goes from 1 to 0 while an input moves by the room between its limits.
    """
    limits = guide.design.loop.plant.u_limits or ()
    rates = np.zeros((len(limits), points.shape[1] + 1))
    S, root, scale = guide.stiffness, guide.root, np.diag(guide.stiffness) ** -0.5

    def inputs(at: Vector) -> Vector:
        return step.inputs(point(at), step.potential.jet(point(at)).grad).mid

    size, base = points.shape[1], inputs(points)
    for k in range(size):
        moved = points.copy()
        moved[:, k] += _APART * scale[k]
        change = np.abs(inputs(moved) - base) / (_APART * scale[k])
        rates[:, k] = np.nanmedian(change, axis=0)[: len(limits)]
    for i, (lo, hi) in enumerate(limits):
        rates[i] /= hi - lo
    channels = step.channels(point(points[:1]))
    rates = rates if len(channels) == len(rates) else rates.sum(0, keepdims=True)
    for i, channel in enumerate(channels):
        part = (np.eye(size) + guide.Q @ S) @ channel.mid[0]
        rates[i] *= np.linalg.norm(root @ (part + part.T) @ root)
    return rates


def _seen_to_clip(step: Step, guide: Guide, height: float) -> bool:
    """Whether u is clipped at one of some states of {W − V(z̄) ≤ height}."""
    if guide.design.loop.plant.u_limits is None:
        return False
    points = guide.inside(height, _POINTS)
    shares = step.over(point(points), point(np.zeros(len(points)))).shares
    return bool((shares.hi < 1).any())


def _core(potential: Potential, box: Interval) -> Interval:
    """A box around z̄ with ∇²V ≻ 0."""
    z_bar = potential.design.z_bar
    half = _CORE * np.minimum(box.hi - z_bar, z_bar - box.lo)
    for _ in range(_TRIES):
        core = Interval(z_bar - half, z_bar + half)
        if positive_definite(potential.lower_hessian(subdivide(core, 2))).all():
            return core
        half = _SMALLER * half
    return Interval(z_bar, z_bar)


def rates_of_change(step: Step, guide: Guide, points: Vector, period: float) -> Vector:
    """How fast Π changes with each state and the period, (N + 1,).

    A wide box also moves over more states: what it does to their rates counts for a period.
    """
    size, design = points.shape[1], guide.design
    S, root = guide.stiffness, guide.root

    def form(at: Vector) -> Vector:
        Z, s = Interval(at[:, :-1], at[:, :-1]), Interval(at[:, -1], at[:, -1])
        value: Vector = root @ step.over(Z, s).form(guide.Q).center @ root
        return value

    at = np.column_stack([points, np.full(len(points), period / 2)])
    base, rates = form(at), np.zeros(size + 1)
    scale = np.append(np.diag(S) ** -0.5, period)
    for k in range(size + 1):
        moved = at.copy()
        moved[:, k] += _APART * scale[k]
        change = np.linalg.norm(form(moved) - base, axis=(-2, -1)) / (_APART * scale[k])
        rates[k] = np.nanmedian(change)
    spread = np.abs(design.lyapunov.linearisation(design.z_bar)).T @ rates[:-1]
    rates[:-1] += period * spread
    return np.asarray(np.maximum(rates, _LEAST * np.nanmax(rates * scale) / scale), float)
