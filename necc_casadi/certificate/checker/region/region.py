"""The region around z̄ in the domain, proved again, and what follows for solutions from it.

With V̇ ≤ 0, a compact component of {V ≤ c} is invariant; LaSalle's principle takes its solutions to
the largest invariant set where V̇ = 0, which is z̄ where that set holds critical points only.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, partial
from typing import Any

from flint import arb

from necc_casadi.certificate.checker.arithmetic.balls import Box, ends
from necc_casadi.certificate.checker.arithmetic.potential import Energy
from necc_casadi.certificate.checker.evidence import Checked, Evidence, Obligation
from necc_casadi.certificate.checker.invariant_sets import (
    largest_invariant_set_is_critical,
    loop_is_defined,
)
from necc_casadi.certificate.checker.model import StoredDesign
from necc_casadi.certificate.checker.momenta import are_momenta, momentum_inside
from necc_casadi.certificate.checker.region.chart import ChartProof
from necc_casadi.certificate.checker.region.ellipsoid import EllipsoidProof
from necc_casadi.certificate.checker.region.grid import GridProof
from necc_casadi.certificate.checker.region.proof import RegionProof
from necc_casadi.certificate.claims import statements
from necc_casadi.certificate.claims.fields import read_as
from necc_casadi.certificate.claims.regions import Follows, LimitedBy, Method, RegionClaim

__all__ = ["check_region", "region_proof"]


#: A momentum limits c where it could leave the domain this much higher above V(z̄): the maker may
#: claim as little as a fifth of its least stiffness.
_HIGHER = 6.0


_PROOFS: dict[Method, Callable[[Evidence, Energy, Any, Box], RegionProof]] = {
    "grid": GridProof,
    "ellipsoid": EllipsoidProof,
    "chart": ChartProof,
}


#: Entries of the claim that are no sizes.
_NO_SIZES = {"limit", "follows"}


def region_proof(evidence: Evidence) -> RegionProof | None:
    """The proof of the region that is claimed; None where none is."""
    region = evidence.certificate.region
    if region is None:
        return None
    energy, z_bar = evidence.reduced(region.active), evidence.z_bar(region.active)
    return _PROOFS[region.method](evidence, energy, region, z_bar)


def check_region(evidence: Evidence, proof: RegionProof | None, sound: bool) -> Checked:
    """The component of {V ≤ c} around z̄ lies in the domain, and only z̄ is critical in it."""
    share, said = evidence.certificate.domain_share, evidence.certificate.limited_by
    claimed = proof is not None and share is not None and evidence.claimed("region")
    if proof is None or share is None or not (claimed and sound):
        missing = "the stability of z̄" if claimed else "that one is claimed"
        return Checked("region", False, f"no region is proved, for want of {missing}")
    region, data, states = proof.region, evidence.claims["region"].data, evidence.model.states
    units, level = evidence.model.units, evidence.certificate.level
    limit, follows = read_as(LimitedBy, data["limit"]), data["follows"]
    sizes = {
        key: float(data[key]) / units.size(key, tuple(states), region.active)
        for key in data
        if key not in _NO_SIZES
    }
    bottom = proof.energy.value(evidence.z_bar(region.active))
    surroundings = cache(partial(_surroundings, evidence.model, proof))
    top = region.level * units.energy
    text = f"a component of {{V ≤ {top:.6g}}} around z̄ in the domain, as it is described"
    checked = Checked.by(
        "region",
        text,
        [
            ("the level is that of the region", lambda: top == level),
            ("V(z̄) < c", lambda: bool(bottom < region.level)),
            *_momenta_stay(evidence.model, region, bottom),
            *proof.obligations(sizes, share),
            ("everything is smooth there", lambda: loop_is_defined(evidence.model, surroundings())),
            ("it ends where it is said to", lambda: _stops(evidence.model, proof, limit, bottom)),
            _solutions(evidence, region, follows, surroundings),
        ],
    )
    if not checked.holds:
        return checked
    reason = statements.limited_by(limit, states, region, units)
    statement = statements.region(top, share, reason, follows)
    limited = (f"it is limited by {reason}", lambda: said == reason)
    return Checked.by("region", statement, [limited])


def _momenta_stay(model: StoredDesign, region: RegionClaim, bottom: arb) -> list[Obligation]:
    """½ δ sᵀA(y)s ≤ c − V(z̄) keeps the momenta in the domain."""
    active, level = region.active, region.level
    resting = [i for i in range(len(model.z)) if i not in active]
    inside = partial(
        momentum_inside, model, resting=resting, active=active, level=level, bottom=bottom
    )
    return [
        ("the resting states are momenta", lambda: are_momenta(model, resting)),
        *((f"{model.states[i]} stays in the domain", partial(inside, i=i)) for i in resting),
    ]


def _solutions(
    evidence: Evidence, region: RegionClaim, follows: Follows, surroundings: Callable[[], Box]
) -> Obligation:
    """What follows for solutions from the region: of two truths the weaker may be claimed."""
    attracts = evidence.certificate.stability == "asymptotic"
    resting = [i for i in range(len(evidence.model.z)) if i not in region.active]

    def every() -> bool:
        return largest_invariant_set_is_critical(evidence.model, resting, surroundings())

    obligations: dict[Follows, Obligation] = {
        "converges": ("every solution from Ω converges to z̄", lambda: attracts and every()),
        "invariant": ("z̄ is locally asymptotically stable", lambda: attracts),
        "stable": ("no more than stability is proved of z̄", lambda: not attracts),
    }
    return obligations[follows]


def _stops(model: StoredDesign, proof: RegionProof, limit: LimitedBy, bottom: arb) -> bool:
    """Whether the region ends where it is said to: at the border, a momentum, a critical point."""
    if limit.kind == "method":
        return not limit.at
    if limit.kind != "momentum":
        return proof.ends_at(limit)
    active, base = proof.region.active, float(bottom.mid())
    level = base + _HIGHER * (proof.region.level - base)
    resting = [i for i in range(model.n) if i not in active]
    return all(i in resting for i in limit.at) and not all(
        momentum_inside(model, i, resting, active, level, bottom) for i in limit.at
    )


def _surroundings(model: StoredDesign, proof: RegionProof) -> Box:
    """A box of all states that holds the region; resting states are in the domain."""
    box = [(ends(lo)[0], ends(hi)[1]) for lo, hi in model.bounds]
    for i, side in zip(proof.region.active, proof.hull(), strict=True):
        box[i] = side
    return tuple(box)
