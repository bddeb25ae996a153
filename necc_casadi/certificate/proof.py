"""certify(design): run the proofs and collect what holds."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import asdict, dataclass, fields, replace
from typing import Any

import necc_casadi.certificate.statements as statements
from necc_casadi.artifact import Design
from necc_casadi.certificate.chart import ChartRegion
from necc_casadi.certificate.claim import FORMAT, Claim
from necc_casadi.certificate.decrease import prove_attraction, prove_decrease, prove_only_stable
from necc_casadi.certificate.enclosures import Potential
from necc_casadi.certificate.equilibrium import Equilibrium, prove_equilibrium
from necc_casadi.certificate.everywhere import Everywhere, prove_everywhere
from necc_casadi.certificate.intervals import self_test
from necc_casadi.certificate.limits import input_level
from necc_casadi.certificate.motion import critical_points_are_invariant
from necc_casadi.certificate.region import (
    CoreRegion,
    GridRegion,
    Proof,
    Region,
    prove_region,
    surroundings,
)
from necc_casadi.certificate.structure import quadratic_states
from necc_casadi.errors import OutputError

__all__ = ["Certificate", "certify"]

Report = Callable[[str, float], None]


@dataclass(frozen=True)
class Certificate:
    """What is proved about a design, for the continuous-time, unsaturated loop.

    Every claim is about the V of the stored weights, read as exact binary numbers.
    """

    design_hash: str  # SHA-256 of design.json
    claims: tuple[Claim, ...]
    z_bar: tuple[float, ...]  # (N,)
    enclosure: float | None  # the minimum of V is this close to z_bar
    mu: float | None  # ∇²V ⪰ μI on the ball around z*
    radius: float | None  # of that ball
    bound_rigorous: float | None  # ‖z̄ − z*‖ ≤ g/μ
    stability: str | None  # "asymptotic", "stable" or None
    level: float | None = None  # c of the region {V ≤ c}
    level_u: float | None = None  # c_u ≤ c with u within its limits on {V ≤ c_u}
    limited_by: str | None = None
    domain_share: float | None = None  # of the domain, momenta at rest: a lower bound
    is_global: bool = False
    region: Region | None = None

    @property
    def certified(self) -> bool:
        """Whether every claim that exit code 0 rests on holds."""
        made = {claim.name for claim in self.claims}
        held = {claim.name for claim in self.claims if claim.holds}
        needed = {"equilibrium", "decrease"} | (made & {"region"})
        return needed <= held and self.stability is not None

    def to_json(self) -> str:
        """The content of certificate.json."""
        data = {"format": FORMAT, **asdict(self)}
        return json.dumps(_finite(data), indent=1, ensure_ascii=False, allow_nan=False) + "\n"

    @classmethod
    def from_json(cls, text: str, label: str = "certificate.json") -> Certificate:
        """Read what :meth:`to_json` wrote.

        Raises
        ------
        OutputError
            When it is not a certificate of this format.
        """
        remedy = f"Design it again; this version reads format {FORMAT}."
        try:
            data = json.loads(text)
            if data.pop("format") != FORMAT:
                raise OutputError("output", f"{label} has another format", remedy)
            data["claims"] = tuple(Claim(**claim) for claim in data["claims"])
            data["z_bar"] = tuple(float(v) for v in data["z_bar"])
            if data["region"] is not None:
                data["region"] = _region(data["region"])
            return cls(**{f.name: data[f.name] for f in fields(cls)})
        except (KeyError, TypeError, ValueError, AttributeError) as problem:
            raise OutputError(
                "output", f"{label} is not a certificate: {problem!r}", remedy
            ) from None


def _region(data: dict[str, Any]) -> Region:
    def tuples(value: Any) -> Any:
        return tuple(tuples(v) for v in value) if isinstance(value, list) else value

    kinds: dict[str, type[Region]] = {
        "grid": GridRegion,
        "core": CoreRegion,
        "chart": ChartRegion,
    }
    kind = kinds[data["method"]]
    return kind(**{key: tuples(value) for key, value in data.items()})


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _finite(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def certify(design: Design, *, region: bool = True, report: Report | None = None) -> Certificate:
    """Prove what can be proved about a design; `report` hears (stage, share done)."""
    told = report or (lambda stage, share: None)
    if not self_test():
        claim = Claim("arithmetic", False, "this machine does not round as IEEE 754 says")
        return _collect(design, (claim,), Equilibrium(design.z_bar, math.inf), None)
    told("equilibrium", 0.0)
    potential = Potential(design)
    equilibrium = prove_equilibrium(potential)
    told("decrease", 0.5)
    claims, stability = _local(potential, equilibrium)
    certificate = _collect(design, claims, equilibrium, stability)
    if not region:
        return certificate
    told("region", 0.0)
    certificate = _extended(certificate, potential, equilibrium)
    told("region", 1.0)
    return certificate


def _local(potential: Potential, equilibrium: Equilibrium) -> tuple[tuple[Claim, ...], str | None]:
    """What holds near z̄, and the kind of stability that follows."""
    design = potential.design
    claims = (_equilibrium_claim(equilibrium), *prove_decrease(design))
    attraction = prove_attraction(potential, equilibrium, claims)
    if not (equilibrium.proved and claims[-1].holds):
        return (*claims, attraction), None
    if attraction.holds:
        return (*claims, attraction), "asymptotic"
    only_stable = prove_only_stable(design)
    if only_stable is None:
        return (*claims, attraction), None
    return (*claims, only_stable), "stable"


def _extended(
    certificate: Certificate, potential: Potential, equilibrium: Equilibrium
) -> Certificate:
    """The certificate with the region, the input limits and the whole space."""
    design, stability = potential.design, certificate.stability
    if stability is None:
        missing = Claim("region", False, "no region without a proof of stability")
        return replace(certificate, claims=(*certificate.claims, missing))
    proof = prove_region(potential, equilibrium)
    everywhere = _global_claim(design, stability)
    # the whole space is a region: where it is proved, a level set in the domain may be missing
    needed = proof.region is not None or not everywhere.holds
    claims = [_region_claim(design, proof, stability)] if needed else []
    level_u = None
    if design.loop.plant.u_limits is not None:
        level_u = _input_level(design, proof, equilibrium)
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
        level=proof.region.level,
        level_u=level_u,
        limited_by=proof.limited_by(design.loop.states),
        domain_share=proof.shares["domain_share"],
        region=proof.region,
    )


def _global_claim(design: Design, stability: str) -> Claim:
    found = Everywhere("z̄ is not proved to attract")
    if stability == "asymptotic":
        found = prove_everywhere(design, quadratic_states(design))
    if found.missing is not None:
        return Claim("global", False, f"{statements.UNPROVED['global']}{found.missing}")
    data = {"resting": list(found.resting), "bends": list(found.bends)}
    return Claim("global", True, statements.GLOBAL, data)


def _region_claim(design: Design, proof: Proof, stability: str) -> Claim:
    limit = proof.limited_by(design.loop.states)
    if proof.region is None or proof.limit is None:
        return Claim("region", False, f"{statements.UNPROVED['region']} is proved: {limit}")
    follows = statements.STABLE
    if stability == "asymptotic":
        resting = [i for i in range(design.loop.n) if i not in proof.region.active]
        every = critical_points_are_invariant(design, resting, surroundings(design, proof.region))
        follows = statements.CONVERGES if every else statements.INVARIANT
    text = statements.region(proof.region.level, proof.shares["domain_share"], limit, follows)
    return Claim("region", True, text, {**proof.shares, "limit": proof.limit.data})


def _input_level(design: Design, proof: Proof, equilibrium: Equilibrium) -> float | None:
    if proof.region is None:
        return None
    active = proof.region.active
    reduced = Potential(design, tuple(i for i in range(design.loop.n) if i not in active))
    bottom = reduced.jet(equilibrium.box[list(active)][None, :]).value.hi[0]
    return input_level(reduced, proof.region, float(bottom))


def _limits_claim(design: Design, proof: Proof, level_u: float | None) -> Claim:
    limits = design.loop.plant.u_limits or ()
    if proof.region is None or level_u is None:
        text = f"{statements.UNPROVED['input_limits']}{statements.ranges(limits)}"
        return Claim("input_limits", False, text)
    text = statements.input_limits(limits, level_u, proof.region.level)
    return Claim("input_limits", True, text)


def _equilibrium_claim(found: Equilibrium) -> Claim:
    data = {"gradient_norm": found.gradient_norm}
    if found.mu is None or found.radius is None or found.bound is None:
        text = "no ball around z* is proved to hold exactly one critical point of V"
        return Claim("equilibrium", False, text, data)
    text = statements.equilibrium(found.radius, found.mu, found.bound)
    return Claim("equilibrium", True, text, data)


def _collect(
    design: Design, claims: tuple[Claim, ...], found: Equilibrium, stability: str | None
) -> Certificate:
    return Certificate(
        design_hash=design.hash,
        claims=claims,
        z_bar=tuple(float(v) for v in found.z_bar),
        enclosure=found.enclosure,
        mu=found.mu,
        radius=found.radius,
        bound_rigorous=found.bound,
        stability=stability,
    )
