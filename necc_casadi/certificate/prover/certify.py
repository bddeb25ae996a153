"""certify(design): run the proofs and collect what holds."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

from necc_casadi.certificate.claims import statements
from necc_casadi.certificate.claims.certificate import Certificate
from necc_casadi.certificate.claims.claim import Claim
from necc_casadi.certificate.claims.regions import Follows, Stability
from necc_casadi.certificate.claims.units import Units
from necc_casadi.certificate.prover.arithmetic.intervals import self_test
from necc_casadi.certificate.prover.arithmetic.potential import Potential
from necc_casadi.certificate.prover.attraction import prove_attraction, prove_only_stable
from necc_casadi.certificate.prover.decrease import prove_decrease
from necc_casadi.certificate.prover.equilibrium import Equilibrium, prove_equilibrium
from necc_casadi.certificate.prover.global_stability import GlobalStability, prove_global_stability
from necc_casadi.certificate.prover.input_limits import input_level
from necc_casadi.certificate.prover.invariant_sets import largest_invariant_set_is_critical
from necc_casadi.certificate.prover.region.region import RegionProof, prove_region, surroundings
from necc_casadi.designs.design import Design

__all__ = ["certify"]


Report = Callable[[str, float], None]


def certify(design: Design, *, region: bool = True, report: Report | None = None) -> Certificate:
    """Prove what can be proved about a design.

    Parameters
    ----------
    design
        The finished design.
    region
        Whether to look for a region, input limits and the whole space, which takes longest.
    report
        Called with the stage at hand and the share that is done.

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
    >>> certificate.bound_rigorous < 1e-9, certificate.domain_share > 0.2
    (True, True)
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
    if not region:
        return certificate
    told("region", 0.0)
    certificate = _extended(certificate, design, potential, equilibrium)
    told("region", 1.0)
    return certificate


def _local(
    design: Design, potential: Potential, equilibrium: Equilibrium
) -> tuple[tuple[Claim, ...], Stability | None]:
    """What holds near z̄, and the kind of stability that follows."""
    decrease = prove_decrease(design)
    claims = (_equilibrium_claim(equilibrium), *decrease.claims)
    attraction = prove_attraction(potential, equilibrium, decrease.casimir, design.units.time)
    if not (equilibrium.proved and decrease.decrease.holds):
        return (*claims, attraction), None
    if attraction.holds:
        return (*claims, attraction), "asymptotic"
    only_stable = prove_only_stable(design)
    if only_stable is None:
        return (*claims, attraction), None
    return (*claims, only_stable), "stable"


def _extended(
    certificate: Certificate, design: Design, potential: Potential, equilibrium: Equilibrium
) -> Certificate:
    """The certificate with the region, the input limits and the whole space."""
    stability, energy = certificate.stability, design.units.energy
    if stability is None:
        missing = Claim("region", False, statements.NO_REGION)
        return replace(certificate, claims=(*certificate.claims, missing))
    proof = prove_region(potential, equilibrium)
    everywhere = _global_claim(design.natural, stability)
    # the whole space is a region: where it is proved, a level set in the domain may be missing
    needed = proof.region is not None or not everywhere.holds
    claims = [_region_claim(design, proof, stability)] if needed else []
    level_u = None
    if design.loop.plant.u_limits is not None:
        level_u = _input_level(potential.design, proof, equilibrium)
        claims.append(_limits_claim(design, proof, level_u))
    found = replace(
        certificate,
        claims=(*certificate.claims, *claims, everywhere),
        is_global=everywhere.holds,
    )
    if proof.region is None:
        return found
    return replace(
        found,
        level=energy * proof.region.level,
        level_u=None if level_u is None else energy * level_u,
        limited_by=proof.limited_by(design.loop.states, units_of(design)),
        domain_share=proof.shares["domain_share"],
        region=proof.region,
    )


def units_of(design: Design) -> Units:
    """The natural units of a design."""
    units = design.units
    return Units(tuple(map(float, units.state)), float(units.energy), float(units.time))


def _global_claim(design: Design, stability: Stability) -> Claim:
    found = GlobalStability("z̄ is not proved to attract")
    if stability == "asymptotic":
        found = prove_global_stability(design, design.momenta)
    if found.missing is not None:
        return Claim("global", False, statements.not_global(found.missing))
    data = {"resting": list(found.resting), "bends": list(found.bends)}
    return Claim("global", True, statements.GLOBAL, data)


def _region_claim(design: Design, proof: RegionProof, stability: Stability) -> Claim:
    states, units = design.loop.states, units_of(design)
    limit = proof.limited_by(states, units)
    if proof.region is None or proof.limit is None:
        return Claim("region", False, statements.no_region(limit))
    follows = _follows(design.natural, proof, stability)
    level = units.energy * proof.region.level
    text = statements.region(level, proof.shares["domain_share"], limit, follows)
    sizes = {k: v * units.size(k, states, proof.region.active) for k, v in proof.shares.items()}
    data = {**sizes, "limit": proof.limit.data, "follows": follows}
    return Claim("region", True, text, data)


def _follows(design: Design, proof: RegionProof, stability: Stability) -> Follows:
    """What follows for solutions from the region (LaSalle's invariance principle)."""
    around = surroundings(design, proof)
    if stability != "asymptotic" or proof.region is None or around is None:
        return "stable"
    resting = [i for i in range(design.loop.n) if i not in proof.region.active]
    every = largest_invariant_set_is_critical(design, resting, around)
    return "converges" if every else "invariant"


def _input_level(design: Design, proof: RegionProof, equilibrium: Equilibrium) -> float | None:
    boxes = proof.boxes()
    if proof.region is None or boxes is None:
        return None
    active = proof.region.active
    reduced = Potential(design, tuple(i for i in range(design.loop.n) if i not in active))
    bottom = reduced.jet(equilibrium.box[list(active)][None, :]).value.hi[0]
    return input_level(reduced, boxes, proof.region.level, float(bottom))


def _limits_claim(design: Design, proof: RegionProof, level_u: float | None) -> Claim:
    limits = design.loop.plant.u_limits or ()
    if proof.region is None or level_u is None:
        return Claim("input_limits", False, statements.no_limits(limits))
    energy = design.units.energy
    text = statements.input_limits(limits, energy * level_u, energy * proof.region.level)
    return Claim("input_limits", True, text)


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
