"""What every proof of a region offers, however the region is described."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

from necc_casadi.certificate.checker.arithmetic.balls import Box
from necc_casadi.certificate.checker.arithmetic.potential import Energy
from necc_casadi.certificate.checker.evidence import Obligation
from necc_casadi.certificate.claims.regions import LimitedBy, RegionClaim

__all__ = ["RegionProof"]


class RegionProof(Protocol):
    """The component of {V ≤ c} in the active states, the momenta at rest, proved again."""

    energy: Energy

    @property
    def region(self) -> RegionClaim:
        """The claim."""
        ...

    def hull(self) -> Box:
        """A box of the active states that holds the region."""
        ...

    def boxes(self) -> list[Box] | None:
        """Small boxes that cover the region; None where it has none."""
        ...

    def obligations(self, sizes: Mapping[str, float], share: float) -> list[Obligation]:
        """What has to be proved of the region and the sizes that are claimed of it."""
        ...

    def ends_at(self, limit: LimitedBy) -> bool:
        """Whether the region reaches a cell that is as the limit says."""
        ...
