"""The independent checker: re-proves each claim from design.json and certificate.json in Arb.

Nothing of the maker's arithmetic is used. A number in the certificate is a hint: it is accepted
only where it is proved again, and a claim that cannot be re-proved does not hold.
"""

from __future__ import annotations

import binascii
import hashlib
import json
import zlib
from pathlib import Path

from necc_casadi.certificate.checker.attraction import check_attraction, check_only_stable
from necc_casadi.certificate.checker.contents import check_contents
from necc_casadi.certificate.checker.decrease import check_decrease
from necc_casadi.certificate.checker.equilibrium import check_equilibrium
from necc_casadi.certificate.checker.evidence import Checked, Evidence
from necc_casadi.certificate.checker.global_stability import check_global
from necc_casadi.certificate.checker.input_limits import check_input_limits
from necc_casadi.certificate.checker.model import StoredDesign
from necc_casadi.certificate.checker.region.region import RegionProof, check_region
from necc_casadi.certificate.claims.claim import CERTIFICATE_FILE, DESIGN_FILE
from necc_casadi.certificate.claims.fields import read_fields
from necc_casadi.errors import OutputError

__all__ = ["check"]


def check(folder: Path) -> tuple[Checked, ...]:
    """Re-prove the certificate in a folder of necc-design.

    Raises
    ------
    OutputError
        When design.json or certificate.json is missing or unreadable.
    """
    design_text, certificate_text = (
        _read(folder / name) for name in (DESIGN_FILE, CERTIFICATE_FILE)
    )
    try:
        stored = read_fields(certificate_text)
        evidence = Evidence(StoredDesign(json.loads(design_text)), stored)
        results = [_as_worded(evidence, result) for result in _everything(evidence)]
        contents = check_contents(evidence, results)
    except (
        KeyError, TypeError, ValueError, AttributeError, IndexError, ArithmeticError,
        binascii.Error, zlib.error,
    ) as problem:  # fmt: skip
        raise OutputError(
            "output",
            f"{folder} holds no readable certificate: {problem!r}",
            "Run necc-design again.",
        ) from None
    same = evidence.certificate.design_hash == hashlib.sha256(design_text.encode()).hexdigest()
    text = "the certificate is about this design.json" if same else "design.json has changed"
    return Checked("design", same, text), *results, contents


def _read(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as problem:
        raise OutputError(
            "output", f"{path} cannot be read: {problem}", "Name a folder of necc-design."
        ) from None


def _as_worded(evidence: Evidence, result: Checked) -> Checked:
    """The result, if the certificate says of it what was proved, word for word."""
    claim = evidence.claims.get(result.name)
    if claim is None or not result.holds:
        return result
    if claim.holds and claim.statement == result.statement:
        return result
    return Checked(result.name, False, f"claimed in other words than proved: {result.statement}")


def _everything(evidence: Evidence) -> list[Checked]:
    """Each claim, given those that it rests on."""
    certificate = evidence.certificate
    equilibrium, decrease = check_equilibrium(evidence), check_decrease(evidence)
    sound = equilibrium.holds and all(part.holds for part in decrease)
    attracts = certificate.stability == "asymptotic"
    settled = (check_attraction if attracts else check_only_stable)(evidence, sound)
    results = [equilibrium, *decrease, settled]
    region = certificate.region
    proof, region_holds = None if region is None else RegionProof(evidence, region), False
    if "region" in evidence.claims or certificate.region is not None:
        checked = check_region(evidence, proof, settled.holds)
        region_holds = checked.holds
        results.append(checked)
    if evidence.claimed("input_limits") or certificate.level_u is not None:
        results.append(check_input_limits(evidence, proof, region_holds))
    if evidence.claimed("global") or certificate.is_global:
        results.append(check_global(evidence, settled.holds))
    return results
