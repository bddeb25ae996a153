"""certify(design): run the proofs and collect what holds."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from necc_casadi.cases import Integrator
from necc_casadi.certificate.claims import statements
from necc_casadi.certificate.claims.certificate import Certificate
from necc_casadi.certificate.claims.claim import Claim
from necc_casadi.certificate.claims.disturbed import Disturbances, DisturbedRegion
from necc_casadi.certificate.claims.motions import Solutions
from necc_casadi.certificate.claims.regions import (
    MOST_KEPT,
    GlobalClaim,
    Obstacle,
    Side,
    Stability,
)
from necc_casadi.certificate.claims.sampled import SampledRegion
from necc_casadi.certificate.prover.arithmetic.intervals import Interval, self_test
from necc_casadi.certificate.prover.arithmetic.potential import Potential
from necc_casadi.certificate.prover.arithmetic.smooth import ends_at, written
from necc_casadi.certificate.prover.attraction import prove_attraction, prove_only_stable
from necc_casadi.certificate.prover.decrease import prove_decrease
from necc_casadi.certificate.prover.equilibrium import Equilibrium, prove_equilibrium
from necc_casadi.certificate.prover.global_stability import prove_global_stability
from necc_casadi.certificate.prover.input_limits import holds_everywhere
from necc_casadi.certificate.prover.integral import prove_integral
from necc_casadi.certificate.prover.local_integral import prove_local_integral
from necc_casadi.certificate.prover.measurement import prove_measurement
from necc_casadi.certificate.prover.region.proof import RegionProof
from necc_casadi.certificate.prover.region.region import prove_region, prove_region_within_limits
from necc_casadi.certificate.prover.sampled.disturbed import prove_disturbed
from necc_casadi.certificate.prover.sampled.prove import prove_sampled
from necc_casadi.certificate.prover.setpoints import prove_setpoints
from necc_casadi.certificate.prover.solutions import what_follows
from necc_casadi.certificate.prover.units import units_of
from necc_casadi.certificate.prover.vanishing_damping import prove_slow_attraction
from necc_casadi.designs.design import Design
from necc_casadi.model.lagrangian import Plants
from necc_casadi.model.ranges import Range

__all__ = ["certify", "with_sampled_loop"]


Report = Callable[[str, float], None]

#: Rounding in double alone.
_NONE = Disturbances()

#: Coordinates of an obstacle that are smaller, in natural units, are 0; a pole is sought within
#: this share of the region's reach.
_NOTHING, _BESIDE = 1e-9, 0.1


def certify(
    design: Design,
    *,
    region: bool = True,
    sample_time: float | None = None,
    integrator: Integrator = "heun",
    disturbances: Disturbances = _NONE,
    report: Report | None = None,
    plants: Plants | None = None,
    disturbance: Sequence[Range] = (),
) -> Certificate:
    """Prove what can be proved about a design.

    Parameters
    ----------
    design
        The finished design.
    region
        Whether to look for a region, input limits and the whole space, which takes longest.
    sample_time
        Sampling periods (s) up to which the sampled loop is to be proved as well.
    integrator
        How ξ is advanced over one.
    disturbances
        Under which it is to come to z̄ and stay near: the C code's numbers, noise, delay.
    report
        Called with the stage at hand and the share that is done.
    plants
        The plants for which integral action is to leave no offset; by default that of the model.
    disturbance
        Of the inputs, one range each, for which it is; by default whatever its limits allow.

    Returns
    -------
    Certificate
        What holds and what does not; a proof that fails is a claim that does not hold.

    References
    ----------
    docs/theory.md. LaSalle (1960); Moore, Kearfott and Cloud (2009); Rump (2010).

    Examples
    --------
    >>> from necc_casadi import certify, design, find_casimirs, judge, load_model, parse_target
    >>> loop = load_model("pendulum.py").loop
    >>> x_star = parse_target(loop.plant, "pi/4")
    >>> casimirs = find_casimirs(loop)
    >>> made = design(loop, casimirs, judge(loop, casimirs, x_star), x_star)
    >>> certificate = certify(made)
    >>> certificate.certified, certificate.stability
    (True, 'asymptotic')
    >>> certificate.obstacle.kind, certificate.obstacle_share > 0.98
    ('critical_point', True)
    """
    told = report or (lambda stage, share: None)
    if not self_test():
        claim = Claim("arithmetic", False, "this machine does not round as IEEE 754 says")
        return _collect(design, (claim,), Equilibrium(design.natural.z_bar, math.inf), None)
    told("equilibrium", 0.0)
    potential = Potential(design.natural)
    equilibrium = prove_equilibrium(potential)
    told("decrease", 0.5)
    claims, stability = _local(design, potential, equilibrium)
    certificate = _collect(design, claims, equilibrium, stability)
    if region:
        told("region", 0.0)
        certificate = _extended(certificate, design, potential, equilibrium)
        if stability is not None:
            added = (
                prove_integral(design, plants, disturbance),
                prove_local_integral(design, plants, disturbance),
                prove_setpoints(design),
            )
            more = tuple(claim for claim in added if claim is not None)
            certificate = replace(certificate, claims=(*certificate.claims, *more))
        told("region", 1.0)
    if sample_time is not None:
        told("sampled", 0.0)
        certificate = with_sampled_loop(design, certificate, sample_time, integrator, disturbances)
        told("sampled", 1.0)
    return certificate


def with_sampled_loop(
    design: Design,
    certificate: Certificate,
    sample_time: float,
    integrator: Integrator,
    disturbances: Disturbances = _NONE,
) -> Certificate:
    """The certificate with what is proved of the loop that the C code makes.

    Parameters
    ----------
    sample_time
        The period (s) up to which it is to converge whatever the periods are.
    integrator
        How ξ is advanced over one.
    disturbances
        Under which it is to come to z̄ and stay near.

    References
    ----------
    docs/theory.md#sampled-loop, #rounding-noise-and-delay.
    """
    found = prove_sampled(design, certificate, sample_time, integrator)
    if isinstance(found, SampledRegion):
        limits = design.loop.plant.u_limits or ()
        text = statements.sampled(
            found, design.loop.states, units_of(design), limits, design.scales_damping
        )
        claim = Claim("sampled", True, text, found.data)
        near = _disturbed(design, found, sample_time, disturbances)
        return certificate.having(claim, near)
    return certificate.having(Claim("sampled", False, statements.sampled_is_not_covered(found)))


def _disturbed(
    design: Design, region: SampledRegion, sample_time: float, disturbances: Disturbances
) -> Claim:
    """What is proved of the same loop under rounding, noise and delay."""
    found = prove_disturbed(design, region, sample_time, disturbances)
    if not isinstance(found, DisturbedRegion):
        return Claim("disturbed", False, statements.disturbed_is_not_covered(found))
    names, units = (design.loop.states, design.loop.plant.input_names), units_of(design)
    inputs = list(map(float, design.units.input))
    velocities = design.measurement.of_velocities
    text = statements.disturbed(found, *names, units, inputs, velocities)
    return Claim("disturbed", True, text, found.data)


def _local(
    design: Design, potential: Potential, equilibrium: Equilibrium
) -> tuple[tuple[Claim, ...], Stability | None]:
    """What holds near z̄, and the kind of stability that follows."""
    decrease = prove_decrease(design)
    measured = prove_measurement(design)
    claims = (
        _equilibrium_claim(equilibrium),
        *decrease.claims,
        *(() if measured is None else (measured,)),
    )
    attraction = prove_attraction(potential, equilibrium, decrease.casimir, design.units.time)
    if not (equilibrium.proved and decrease.decrease.holds):
        return (*claims, attraction), None
    if attraction.holds:
        return (*claims, attraction), "asymptotic"
    slow = prove_slow_attraction(potential, equilibrium.box)
    if slow is not None:
        return (*claims, slow), "asymptotic"
    only_stable = prove_only_stable(design)
    if only_stable is None:
        return (*claims, attraction), None
    return (*claims, only_stable), "stable"


def _extended(
    certificate: Certificate,
    design: Design,
    potential: Potential,
    equilibrium: Equilibrium,
) -> Certificate:
    """The certificate with the whole space, the region and the input limits."""
    stability = certificate.stability
    if stability is None:
        missing = Claim("region", False, statements.NO_REGION)
        return replace(certificate, claims=(*certificate.claims, missing))
    reduced, minimum = Potential(potential.design, design.momenta), equilibrium.box
    everywhere = prove_global_stability(reduced, minimum, stability == "asymptotic")
    proof = _region(reduced, minimum, isinstance(everywhere, GlobalClaim))
    claims = []
    if proof is not None:
        solutions = what_follows(design.natural, stability == "asymptotic", minimum, proof.place)
        claims.append(_region_claim(design, proof, solutions))
    elif not isinstance(everywhere, GlobalClaim):
        claims.append(Claim("region", False, _no_region(design)))
    if design.loop.plant.u_limits is not None:
        claims += [_limits_claim(design, proof), _clipping_claim(design, proof)]
    claims.append(_global_claim(everywhere))
    found = replace(
        certificate,
        claims=(*certificate.claims, *claims),
        is_global=isinstance(everywhere, GlobalClaim) and everywhere.follows == "converges",
    )
    if proof is None:
        return found
    energy, limited = design.units.energy, design.loop.plant.u_limits is not None
    level_u = proof.level_u if limited else None
    level_clipped = None if holds_everywhere(design) or not limited else proof.level_clipped
    return replace(
        found,
        level=energy * proof.level,
        level_above_minimum=energy * proof.height(proof.level),
        level_u=None if level_u is None else energy * level_u,
        level_clipped=None if level_clipped is None else energy * level_clipped,
        obstacle=_obstacle(design, proof),
        reach=_reach(design, proof),
        region=proof.region,
    )


def _region(reduced: Potential, minimum: Interval, whole: bool) -> RegionProof | None:
    """Where the whole space is proved, a region still says where bounds and inputs are kept."""
    plant = reduced.design.loop.plant
    if not whole or plant.domain:
        return prove_region(reduced, minimum)
    return None if plant.u_limits is None else prove_region_within_limits(reduced, minimum)


def _obstacle(design: Design, proof: RegionProof) -> Obstacle:
    found, states = proof.obstacle, design.loop.states
    still = np.where(np.abs(found.z) < _NOTHING, 0.0, found.z)
    place = units_of(design).place(range(len(still)), map(float, still))
    height = design.units.energy * (found.level - proof.bottom)
    kind, box = found.kind, proof.place.box
    if kind == "singularity":  # where the model was not proved to be smooth, it may still be
        natural, beside = design.natural, _BESIDE * (box.hi - box.lo)
        if not ends_at(written(natural), natural.loop.z, still, beside):
            kind = "arithmetic"
    return Obstacle(kind, dict(zip(states[: len(place)], place, strict=True)), height)


def _reach(design: Design, proof: RegionProof) -> dict[str, Side | None]:
    box, states = proof.place.box, design.loop.states
    lo, hi = (
        units_of(design).place(range(len(states)), map(float, ends)) for ends in (box.lo, box.hi)
    )
    return {name: None if i in proof.angles else (lo[i], hi[i]) for i, name in enumerate(states)}


def _global_claim(found: GlobalClaim | statements.Missing) -> Claim:
    if not isinstance(found, GlobalClaim):
        return Claim("global", False, statements.not_global(found))
    return Claim("global", True, statements.GLOBAL[found.follows], found.data)


def _region_claim(design: Design, proof: RegionProof, solutions: Solutions) -> Claim:
    height = design.units.energy * proof.height(proof.level)
    text = statements.region(height, _obstacle(design, proof), solutions.follows)
    return Claim("region", True, text, solutions.data)


def _no_region(design: Design) -> str:
    left = design.loop.n - len(design.momenta)
    return statements.TOO_MANY if left > MOST_KEPT else statements.NO_NEIGHBOURHOOD


def _limits_claim(design: Design, proof: RegionProof | None) -> Claim:
    limits, energy = design.loop.plant.u_limits or (), design.units.energy
    if proof is None or proof.level_u is None:
        return Claim("input_limits", False, statements.no_limits(limits))
    height = energy * proof.height(proof.level_u)
    whole = proof.level_u == proof.level
    text = statements.input_limits(limits, height, whole)
    return Claim("input_limits", True, text, {"level_above_minimum": height})


def _clipping_claim(design: Design, proof: RegionProof | None) -> Claim:
    limits, energy = design.loop.plant.u_limits or (), design.units.energy
    scaled = design.scales_damping
    if holds_everywhere(design):
        text = statements.clipped_everywhere(scaled)
        return Claim("clipping", True, text, {"everywhere": True})
    if proof is None or proof.level_clipped is None:
        return Claim("clipping", False, statements.no_clipping(limits))
    height, whole = energy * proof.height(proof.level_clipped), proof.level_clipped == proof.level
    text = statements.clipping(limits, height, whole, scaled)
    return Claim("clipping", True, text, {"level_above_minimum": height})


def _equilibrium_claim(found: Equilibrium) -> Claim:
    data = {"gradient_norm": found.gradient_norm}
    if found.mu is None or found.radius is None or found.bound is None:
        text = "no ball around z* is proved to hold exactly one critical point of V"
        return Claim("equilibrium", False, text, data)
    text = statements.equilibrium(found.radius, found.mu, found.bound)
    return Claim("equilibrium", True, text, data)


def _collect(
    design: Design, claims: tuple[Claim, ...], found: Equilibrium, stability: Stability | None
) -> Certificate:
    units = units_of(design)
    return Certificate(
        design_hash=design.hash,
        claims=claims,
        units=units,
        z_bar=tuple(units.place(range(len(found.z_bar)), map(float, found.z_bar))),
        enclosure=found.enclosure,
        mu=found.mu,
        radius=found.radius,
        bound_rigorous=None if found.bound is None else units.largest * found.bound,
        stability=stability,
    )
