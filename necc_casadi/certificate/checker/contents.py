"""Nothing is left in certificate.json that was not proved: no claim, no number, no word."""

from __future__ import annotations

from collections.abc import Sequence

from necc_casadi.certificate.checker.evidence import Checked, Evidence
from necc_casadi.certificate.claims.statements import unproved
from necc_casadi.texts import escaped

__all__ = ["check_contents"]


#: Fields that say something only beside a held claim.
_BESIDE = {
    "region": ("level", "level_above_minimum", "obstacle", "reach", "region"),
    "input_limits": ("level_u",),
    "clipping": ("level_clipped",),
}


#: Names that are shown, and letters of each.
_NAMED, _SHOWN = 10, 60


def check_contents(evidence: Evidence, results: Sequence[Checked]) -> Checked:
    """Whether the certificate claims what was checked, once each, and says nothing beside it."""
    checked = {result.name for result in results}
    left = [name for name in evidence.claims if _count(evidence, name) > 1]
    left += [f"claim {name}" for name in evidence.claims if not _known(evidence, name, checked)]
    left += _stray(evidence)
    left += evidence.stored.unread()
    if left:
        shown = ", ".join(escaped(name)[:_SHOWN] for name in left[:_NAMED])
        more = f" and {len(left) - _NAMED} more" if len(left) > _NAMED else ""
        return Checked("contents", False, f"not proved, but in the file: {shown}{more}")
    return Checked("contents", True, "the certificate says nothing else")


def _count(evidence: Evidence, name: str) -> int:
    return sum(claim.name == name for claim in evidence.certificate.claims)


def _known(evidence: Evidence, name: str, checked: set[str]) -> bool:
    """Whether a held claim was checked, or one that is not held says no more than that."""
    claim = evidence.claims[name]
    if claim.holds:
        return name in checked
    model = evidence.model
    said = unproved(model.stated_limits or ()).get(name, frozenset())
    return claim.statement in said and not claim.data


def _stray(evidence: Evidence) -> list[str]:
    """Fields that are at odds with the claims."""
    certificate = evidence.certificate
    left = []
    everywhere = evidence.claimed("global")
    converges = everywhere and evidence.claims["global"].data["follows"] == "converges"
    if certificate.is_global is not converges:
        left.append("is_global")
    for name, fields in _BESIDE.items():
        if not evidence.claimed(name):
            left += [field for field in fields if getattr(certificate, field) is not None]
    return left
