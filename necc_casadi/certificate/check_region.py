"""The region around z̄ in the domain, and where in it the inputs stay within their limits."""

from __future__ import annotations

from collections.abc import Sequence

from necc_casadi.certificate.balls import Box, ball, ends
from necc_casadi.certificate.check_chart import ChartProof
from necc_casadi.certificate.check_core import CoreProof
from necc_casadi.certificate.check_evidence import Checked, Evidence
from necc_casadi.certificate.check_grid import GridProof
from necc_casadi.certificate.check_inputs import InputProof
from necc_casadi.certificate.check_model import Model
from necc_casadi.certificate.check_motion import at_rest, invariant_points, momenta_inside

__all__ = ["check_input_limits", "check_region"]

_PROOFS: dict[str, type[GridProof] | type[CoreProof] | type[ChartProof]] = {
    "grid": GridProof,
    "core": CoreProof,
    "chart": ChartProof,
}


def check_region(evidence: Evidence, sound: bool, stability: str | None) -> Checked:
    """The component of {V ≤ c} around z̄ lies in the domain, and only z̄ is critical in it."""
    region = evidence.certificate["region"]
    if region is None or not sound:
        return Checked("region", False, "no region is proved")
    level, active = float(region["level"]), [int(i) for i in region["active"]]
    resting = [i for i in range(len(evidence.model.z)) if i not in active]
    text = f"the component of {{V ≤ {level:.6g}}} around z̄ is invariant and in the domain"
    energy = evidence.reduced(active)
    z_bar = evidence.z_bar(active)
    bottom = energy.value(z_bar)
    holds = level == evidence.certificate["level"] and bool(bottom < level)
    holds = (
        holds
        and at_rest(evidence.model, resting)
        and momenta_inside(evidence.model, resting, active, level, bottom)
    )
    proof = _PROOFS[region["method"]](evidence, energy, region, z_bar)
    holds = holds and proof.holds(
        evidence.claimed["region"]["data"], evidence.certificate["domain_share"]
    )
    converges = (
        holds
        and stability == "asymptotic"
        and invariant_points(evidence.model, resting, _surroundings(evidence.model, active, proof))
    )
    said = "converges" in evidence.claimed["region"]["statement"]
    if said and not converges:
        return Checked("region", False, "convergence from all of the region is not re-proved")
    if converges:
        text += "; every solution from it converges to z̄"
    elif stability == "asymptotic":
        text += "; z̄ is locally asymptotically stable"
    return Checked("region", holds, text)


def _surroundings(
    model: Model, active: Sequence[int], proof: GridProof | CoreProof | ChartProof
) -> Box:
    """A box of all states that holds the region; resting states are in the domain."""
    box = [(ends(lo)[0], ends(hi)[1]) for lo, hi in model.bounds()]
    if isinstance(proof, ChartProof):
        pairs = zip(proof.center, proof.half, strict=True)
        hull = tuple(ends(c + h * ball(-1.0, 1.0)) for c, h in pairs)
    else:
        hull = proof.hull()
    for i, side in zip(active, hull, strict=True):
        box[i] = side
    return tuple(box)


def check_input_limits(evidence: Evidence, sound: bool) -> Checked:
    """U stays within the model's limits wherever V ≤ c_u on the cells of the region."""
    level, region = evidence.certificate["level_u"], evidence.certificate["region"]
    if level is None or evidence.model.u_limits is None or not sound:
        return Checked("input_limits", False, "no input limits are proved to be kept")
    active = [int(i) for i in region["active"]]
    energy, z_bar = evidence.reduced(active), evidence.z_bar(active)
    proof = _PROOFS[region["method"]](evidence, energy, region, z_bar)
    if isinstance(proof, ChartProof):
        return Checked("input_limits", False, "no input limits in the coordinates (c, ξ)")
    inputs = InputProof(evidence.model, energy, float(level))
    holds = bool(energy.value(z_bar) < float(level)) and float(level) <= float(region["level"])
    holds = holds and inputs.covered() and all(inputs.kept(box) for box in proof.boxes())
    text = f"u stays within its limits on {{V ≤ {float(level):.6g}}} around z̄"
    return Checked("input_limits", holds, text)
