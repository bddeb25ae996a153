"""What is claimed of solutions, proved again (LaSalle's principle)."""

from __future__ import annotations

from collections.abc import Sequence

from necc_casadi.certificate.checker.evidence import Evidence, Obligation
from necc_casadi.certificate.checker.invariant_sets import (
    OverBox,
    largest_invariant_set_is_critical,
)
from necc_casadi.certificate.checker.motions import no_motion_without_loss
from necc_casadi.certificate.claims.motions import Solutions

__all__ = ["what_follows"]


def what_follows(
    evidence: Evidence, claimed: Solutions, resting: Sequence[int], place: OverBox | None
) -> Obligation:
    """Of solutions from a set, None for any; of two truths the weaker may be claimed."""
    attracts, model = evidence.certificate.stability == "asymptotic", evidence.model

    def every() -> bool:
        if not claimed.motion:
            return largest_invariant_set_is_critical(model, resting, place)
        z_bar, box = evidence.z_bar(range(len(model.z))), None if place is None else place.box
        return no_motion_without_loss(evidence.full, resting, claimed.motion, z_bar, box)

    if claimed.follows == "converges":
        return "no motion but rest keeps V constant", lambda: attracts and every()
    if claimed.follows == "invariant":
        return "z̄ is locally asymptotically stable", lambda: attracts and not claimed.motion
    return "no more than stability is proved of z̄", lambda: not (attracts or claimed.motion)
