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

from necc_casadi.certificate.check_decrease import (
    check_casimir,
    check_damping,
    check_slope,
    check_structure,
)
from necc_casadi.certificate.check_evidence import Checked, Evidence
from necc_casadi.certificate.check_global import check_global
from necc_casadi.certificate.check_local import check_attraction, check_equilibrium
from necc_casadi.certificate.check_model import Model
from necc_casadi.certificate.check_region import check_input_limits, check_region
from necc_casadi.errors import OutputError

__all__ = ["Checked", "check"]


def check(folder: Path) -> tuple[Checked, ...]:
    """Re-prove the certificate in a folder of necc-design.

    Raises
    ------
    OutputError
        When design.json or certificate.json is missing or unreadable.
    """
    design_text, certificate_text = (
        _read(folder / name) for name in ("design.json", "certificate.json")
    )
    remedy = "Run necc-design again."
    try:
        certificate = json.loads(certificate_text)
        model = Model(json.loads(design_text))
        claimed = {claim["name"]: claim for claim in certificate["claims"]}
        same = certificate["design_hash"] == hashlib.sha256(design_text.encode()).hexdigest()
        results = _everything(Evidence(model, certificate, claimed))
    except (
        KeyError, TypeError, ValueError, AttributeError, IndexError, ZeroDivisionError,
        binascii.Error, zlib.error,
    ) as problem:  # fmt: skip
        raise OutputError(
            "output", f"{folder} holds no readable certificate: {problem!r}", remedy
        ) from None
    text = "the certificate is about this design.json" if same else "design.json has changed"
    return Checked("design", same, text), *results


def _read(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as problem:
        raise OutputError(
            "output", f"{path} cannot be read: {problem}", "Name a folder of necc-design."
        ) from None


def _everything(evidence: Evidence) -> list[Checked]:
    model = evidence.model
    results = [
        check_equilibrium(evidence),
        check_casimir(model),
        check_structure(model),
        check_slope(evidence),
        check_damping(model),
    ]
    basis = all(r.holds for r in results[1:])
    results.append(Checked("decrease", basis, "V never increases along the loop"))
    sound = all(r.holds for r in results)
    stability = evidence.certificate["stability"]
    if stability == "asymptotic":
        results.append(check_attraction(evidence, sound))
    else:
        holds = sound and stability == "stable"
        results.append(Checked("stability", holds, "z̄ is stable"))
    settled = results[-1].holds
    if "region" in evidence.claimed or evidence.certificate["region"] is not None:
        results.append(check_region(evidence, settled, stability))
    limits = evidence.claimed.get("input_limits", {"holds": False})["holds"]
    if limits or evidence.certificate["level_u"] is not None:
        results.append(
            check_input_limits(evidence, results[-1].name == "region" and results[-1].holds)
        )
    claimed = evidence.claimed.get("global", {"holds": False})["holds"]
    if claimed or evidence.certificate["is_global"]:
        results.append(check_global(evidence, settled and stability == "asymptotic"))
    return results
