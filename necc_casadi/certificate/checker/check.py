"""The independent checker: re-proves each claim from design.json and certificate.json in Arb.

Nothing of the maker's arithmetic is used. A number in the certificate is a hint: it is accepted
only where it is proved again, and a claim that cannot be re-proved does not hold.
"""

from __future__ import annotations

import binascii
import hashlib
import zlib
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from necc_casadi.certificate.checker.attraction import check_attraction, check_only_stable
from necc_casadi.certificate.checker.code import check_code
from necc_casadi.certificate.checker.contents import check_contents
from necc_casadi.certificate.checker.decrease import check_decrease
from necc_casadi.certificate.checker.equilibrium import check_equilibrium
from necc_casadi.certificate.checker.everywhere import check_everywhere
from necc_casadi.certificate.checker.evidence import Checked, Evidence
from necc_casadi.certificate.checker.family import StoredMembers, check_family
from necc_casadi.certificate.checker.fed_momenta import check_momenta
from necc_casadi.certificate.checker.global_stability import check_global
from necc_casadi.certificate.checker.input_limits import check_clipping, check_input_limits
from necc_casadi.certificate.checker.integral import check_integral
from necc_casadi.certificate.checker.local_integral import check_local_integral
from necc_casadi.certificate.checker.measurement import check_measurement
from necc_casadi.certificate.checker.members import check_members
from necc_casadi.certificate.checker.model import StoredDesign
from necc_casadi.certificate.checker.reading import (
    check_design,
    model_hash,
    read_folder,
    read_plant,
    unreadable,
)
from necc_casadi.certificate.checker.region.region import check_region, region_proof
from necc_casadi.certificate.checker.sampled.disturbed import check_disturbed
from necc_casadi.certificate.checker.sampled.sampled import check_sampled
from necc_casadi.certificate.checker.setpoints import check_setpoints

__all__ = ["check"]


#: What anybody's files can raise in what reads and proves them; a fault of ours is none of these.
_UNREADABLE = (
    ArithmeticError,
    AttributeError,
    LookupError,
    MemoryError,
    NotImplementedError,
    RecursionError,
    TypeError,
    ValueError,
    OSError,
    binascii.Error,
    zlib.error,
)


def check(folder: Path) -> tuple[Checked, ...]:
    """Re-prove the certificate in a folder of necc-design.

    Raises
    ------
    OutputError
        When design.json or certificate.json is missing or unreadable.
    """
    try:
        design_text, stored, design = read_folder(folder)
        check_design(design)
        evidence = Evidence(StoredDesign(design), stored)
        plant = partial(read_plant, folder, design_text)
        found = _everything(evidence, plant)
        own = hashlib.sha256(design_text.encode()).hexdigest()
        found += _of_family(evidence, folder, own, plant, found)
        results = [_as_worded(evidence, result) for result in found]
        contents = check_contents(evidence, results)
        near = evidence.certificate.disturbed
    except _UNREADABLE as problem:
        raise unreadable(folder, problem) from None
    same = evidence.certificate.design_hash == own
    whole = design.get("model_hash") == model_hash(design)
    text = "the certificate is about this design.json, and its model is the one that was judged"
    if not (same and whole):
        text = "design.json has changed" if not same else "the model in design.json was edited"
    first = Checked("design", same and whole, text)
    return (
        first,
        *results,
        contents,
        *check_code(folder, design_text, None if near is None else near.precision),
    )


def _of_family(
    evidence: Evidence,
    folder: Path,
    own: str,
    plant: Callable[[], str | None],
    found: Sequence[Checked],
) -> list[Checked]:
    """The claims about all of family.json, which falls as the design does."""
    proofs = {"family": check_family, "everywhere": check_everywhere, "members": check_members}
    claimed = [name for name in proofs if evidence.claimed(name)]
    if not claimed:
        return []
    falls = any(result.name == "decrease" and result.holds for result in found)
    stored = StoredMembers(evidence, folder, own, plant, falls)
    return [proofs[name](evidence, stored) for name in claimed]


def _as_worded(evidence: Evidence, result: Checked) -> Checked:
    """The result, if the certificate says of it what was proved, word for word."""
    claim = evidence.claims.get(result.name)
    if claim is None or not result.holds:
        return result
    if claim.holds and claim.statement == result.statement:
        return result
    return Checked(result.name, False, f"claimed in other words than proved: {result.statement}")


def _settled(evidence: Evidence, sound: bool) -> Checked:
    """The kind of stability that is claimed, if one is."""
    stability = evidence.certificate.stability
    if stability is None:
        return Checked("stability", False, "no stability is claimed")
    name = "attraction" if stability == "asymptotic" else "stability"
    if not evidence.claimed(name):
        return Checked(name, False, f"{name} is not claimed, though the certificate calls it so")
    return (check_attraction if name == "attraction" else check_only_stable)(evidence, sound)


def _everything(evidence: Evidence, plant_file: Callable[[], str | None]) -> list[Checked]:
    """Each claim, given those that it rests on."""
    certificate = evidence.certificate
    equilibrium, decrease = check_equilibrium(evidence), check_decrease(evidence)
    sound = equilibrium.holds and all(part.holds for part in decrease)
    settled = _settled(evidence, sound)
    measured = check_measurement(evidence)
    results = [equilibrium, *decrease, *(() if measured is None else (measured,)), settled]
    region = certificate.region
    proof, region_holds = None if region is None else region_proof(evidence, region), False
    if "region" in evidence.claims or certificate.region is not None:
        checked = check_region(evidence, proof, settled.holds)
        region_holds = checked.holds
        results.append(checked)
    if evidence.claimed("input_limits") or certificate.level_u is not None:
        results.append(check_input_limits(evidence, proof, region_holds))
    if evidence.claimed("clipping") or certificate.level_clipped is not None:
        anywhere = region_holds or certificate.region is None
        results.append(check_clipping(evidence, proof, anywhere and settled.holds))
    if evidence.claimed("global") or certificate.is_global:
        results.append(check_global(evidence, settled.holds))
    plain = all(part.holds for part in decrease) and measured is not None and measured.holds
    integral = check_integral(evidence, plain, plant_file)
    if evidence.claimed("local_integral"):
        results.append(check_local_integral(evidence, plain, plant_file))
    moving = check_setpoints(evidence, plain and sound)
    fed = check_momenta(evidence, all(part.holds for part in decrease), plant_file)
    results += [claim for claim in (integral, moving, fed) if claim is not None]
    if evidence.claimed("sampled"):
        sampled = check_sampled(evidence, sound)
        results.append(sampled)
        if evidence.claimed("disturbed"):
            results.append(check_disturbed(evidence, sampled.holds))
    return results
