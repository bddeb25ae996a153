"""The region around z̄ in the domain, and where in it the inputs stay within their limits."""

from __future__ import annotations

from collections.abc import Sequence

from flint import arb

from necc_casadi.certificate.checker.arithmetic.balls import Box, ends
from necc_casadi.certificate.checker.evidence import Checked, Evidence
from necc_casadi.certificate.checker.invariant_sets import (
    largest_invariant_set_is_critical,
    loop_is_defined,
)
from necc_casadi.certificate.checker.model import StoredDesign
from necc_casadi.certificate.checker.momenta import at_rest, momentum_inside
from necc_casadi.certificate.checker.region.chart import ChartProof
from necc_casadi.certificate.checker.region.ellipsoid import EllipsoidProof
from necc_casadi.certificate.checker.region.grid import GridProof
from necc_casadi.certificate.claims import statements
from necc_casadi.certificate.claims.fields import Fields
from necc_casadi.certificate.claims.regions import LimitedBy

__all__ = ["_PROOFS", "check_region"]


_PROOFS: dict[str, type[GridProof] | type[EllipsoidProof] | type[ChartProof]] = {
    "grid": GridProof,
    "core": EllipsoidProof,
    "chart": ChartProof,
}


_SIZES = ("volume", "domain_share", "slice_share", "plant_share")


#: A momentum limits c where it could leave the domain this much higher above V(z̄): the maker may
#: claim as little as a fifth of its least stiffness.
_HIGHER = 6.0


def check_region(evidence: Evidence, sound: bool) -> Checked:
    """The component of {V ≤ c} around z̄ lies in the domain, and only z̄ is critical in it."""
    region, model = evidence.certificate["region"], evidence.model
    if region is None or not sound or not evidence.claimed("region"):
        return Checked("region", False, "no region is proved")
    level, active = float(region["level"]), [int(i) for i in region["active"]]
    resting = [i for i in range(len(model.z)) if i not in active]
    data, share = evidence.claims["region"]["data"], evidence.certificate["domain_share"]
    energy, z_bar = evidence.reduced(active), evidence.z_bar(active)
    bottom = energy.value(z_bar)
    limit = LimitedBy.read(data["limit"])
    holds = level == evidence.certificate["level"] and bool(bottom < level)
    holds = holds and at_rest(model, resting)
    holds = holds and all(
        momentum_inside(model, i, resting, active, level, bottom) for i in resting
    )
    proof = _PROOFS[region["method"]](evidence, energy, region, z_bar)
    holds = holds and _only_sizes(evidence, region, data) and proof.holds(data, share)
    holds = holds and loop_is_defined(model, _surroundings(model, active, proof))
    if not (holds and _stops(evidence, proof, limit, bottom)):
        text = f"a component of {{V ≤ {level:.6g}}} around z̄ in the domain, as it is described"
        return Checked("region", False, text)
    place: Sequence[float] = ()
    if isinstance(proof, GridProof) and limit.names_a_cell:
        place = limit.place(proof.first, proof.step)
    reason = statements.limited_by(limit, region["method"], model.states, active, place)
    texts = [
        statements.region(level, float(share), reason, follows)
        for follows in _consequences(evidence, resting, _surroundings(model, active, proof))
    ]
    said = evidence.claims["region"]["statement"]
    holds = evidence.certificate["limited_by"] == reason
    return Checked("region", holds, said if said in texts else texts[0])


def _only_sizes(evidence: Evidence, region: Fields, data: Fields) -> bool:
    """Whether no size of the region is claimed but those that its proof looks at."""
    reach = {f"reach_{evidence.model.states[int(i)]}" for i in region["active"]}
    return set(data) <= {"limit", *_SIZES} | reach


def _consequences(evidence: Evidence, resting: Sequence[int], box: Box) -> list[str]:
    """What follows for solutions from the region, the most first."""
    if evidence.certificate["stability"] != "asymptotic":
        return [statements.STABLE]
    if largest_invariant_set_is_critical(evidence.model, resting, box):
        return [statements.CONVERGES, statements.INVARIANT]
    return [statements.INVARIANT]


def _stops(
    evidence: Evidence,
    proof: GridProof | EllipsoidProof | ChartProof,
    limit: LimitedBy,
    bottom: arb,
) -> bool:
    """Whether the region ends where it is said to: at the border, a momentum, a critical point."""
    energy, model = proof.energy, evidence.model
    if limit.kind == "method":
        return not limit.at
    if limit.kind == "momentum":
        base = float(bottom.mid())
        level = base + _HIGHER * (proof.level - base)
        resting = [i for i in range(model.n) if i not in energy.active]
        return all(i in resting for i in limit.at) and not all(
            momentum_inside(model, i, resting, energy.active, level, bottom) for i in limit.at
        )
    if not (isinstance(proof, GridProof) and limit.names_a_cell):
        return False
    border = limit.kind != "critical"
    named = not border or proof.at_domain(limit.at) == (limit.kind == "border")
    return named and proof.touches(limit.at, border)


def _surroundings(
    model: StoredDesign, active: Sequence[int], proof: GridProof | EllipsoidProof | ChartProof
) -> Box:
    """A box of all states that holds the region; resting states are in the domain."""
    box = [(ends(lo)[0], ends(hi)[1]) for lo, hi in model.bounds()]
    hull = proof.hull()
    for i, side in zip(active, hull, strict=True):
        box[i] = side
    return tuple(box)
