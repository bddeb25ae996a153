"""Candidates: how they respond, and what is proved of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from necc_casadi.arrays import Vector
from necc_casadi.certificate.claims.certificate import Certificate
from necc_casadi.designs.design import Design
from necc_casadi.designs.error_bound import ACCEPTED_LOSS, natural_loss
from necc_casadi.performance.saturated import Saturated
from necc_casadi.synthesis.asked import Asked
from necc_casadi.synthesis.options import Options

__all__ = ["Judged", "Name", "Trial", "cost_ratio"]


#: How a candidate is made: V with one critical point, least cost, the same with the damping alone,
#: neither, shaped for a higher level, or as the options say; or one of these improved on responses.
Name = Literal[
    "whole space", "least cost", "damping alone", "default", "shaped", "as asked", "polished"
]


@dataclass(frozen=True, eq=False)
class Trial:
    """A candidate that was followed from the starts, and of which nothing is proved yet."""

    name: Name
    options: Options
    design: Design
    asked: Asked | None  # how far the response is what was asked; None: nothing was
    response: Saturated
    cost_to_lqr: float | None  # geometric mean over the starts from which both arrive, clipped

    @property
    def arrivals(self) -> int:
        """How many starts arrive."""
        return int(self.response.arrived.sum())


@dataclass(frozen=True, eq=False)
class Judged(Trial):
    """A candidate with what is proved of it."""

    certificate: Certificate
    plant_share: float  # of the plant's states at rest that the proved region holds
    unclipped_share: float | None  # where inputs keep their limits too; None: they have none

    @property
    def proved(self) -> bool:
        """Whether every claim that exit code 0 rests on is proved."""
        return self.certificate.certified and natural_loss(self.design) <= ACCEPTED_LOSS

    @property
    def whole(self) -> bool:
        """Whether something is proved of the whole space."""
        return any(claim.name == "global" and claim.holds for claim in self.certificate.claims)

    @property
    def converges(self) -> bool:
        """Whether all solutions from where something is proved go to the target."""
        return any(
            claim.holds and claim.data.get("follows") == "converges"
            for claim in self.certificate.claims
            if claim.name in ("region", "global")
        )

    @property
    def clips_freely(self) -> bool:
        """Whether everything that is claimed holds with clipped inputs, from the same states."""
        return any(
            claim.holds and claim.data.get("everywhere") is True
            for claim in self.certificate.claims
            if claim.name == "clipping"
        )

    @property
    def fits_limits(self) -> bool:
        """Whether no start asks for more than the inputs' limits, or it is proved from where."""
        names = ("input_limits", "clipping")
        claims = (claim for claim in self.certificate.claims if claim.name in names)
        return self.response.keeps_limits or any(claim.holds for claim in claims)


def cost_ratio(costs: Vector, others: Vector | None) -> float | None:
    """Geometric mean of ratios of finite costs (N,); None where there are none."""
    if others is None:
        return None
    both = np.isfinite(costs) & np.isfinite(others) & (costs > 0) & (others > 0)
    return float(np.exp(np.mean(np.log(costs[both] / others[both])))) if both.any() else None
