"""What every region is asked for: its obligations, how far it reaches, where its solutions go."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from functools import cached_property

from flint import arb

from necc_casadi.certificate.checker.arithmetic.balls import Box
from necc_casadi.certificate.checker.evidence import Evidence, Obligation
from necc_casadi.certificate.checker.invariant_sets import OverBox
from necc_casadi.certificate.checker.momenta import are_momenta
from necc_casadi.certificate.checker.solutions import what_follows
from necc_casadi.certificate.claims.motions import Solutions
from necc_casadi.certificate.claims.regions import Side

__all__ = ["RegionProof"]


class RegionProof(ABC):
    """The component Ω of {V ≤ c} around z̄, in natural units."""

    def __init__(self, evidence: Evidence, level: float, active: Sequence[int]) -> None:
        self.evidence, self.model = evidence, evidence.model
        self.level, self.active = level, tuple(active)
        self.energy, self.z_bar = evidence.reduced(active), evidence.z_bar(active)
        self.bottom: arb = self.energy.value(self.z_bar)
        self.resting = [i for i in range(len(self.model.z)) if i not in active]

    @cached_property
    def claimed_reach(self) -> tuple[Side | None, ...]:
        """The claimed sides of all states; None for one that may take every value.

        Raises
        ------
        ValueError
            When there are none, or not one for every state.
        """
        claimed, units = self.evidence.certificate.reach, self.model.units
        if claimed is None or list(claimed) != self.model.states:
            raise ValueError("the region's reach is not told of every state in order")
        pairs = zip(claimed.values(), units.state, strict=True)
        return tuple(None if s is None else (s[0] / u, s[1] / u) for s, u in pairs)

    def rests(self) -> bool:
        """Whether the states that are not in y are momenta."""
        return are_momenta(self.model, self.resting)

    @abstractmethod
    def obligations(self) -> list[Obligation]:
        """What has to be proved of Ω itself, its reach among it."""

    @property
    @abstractmethod
    def place(self) -> OverBox:
        """A box of all states that holds Ω."""

    @abstractmethod
    def boxes(self, level: float) -> list[Box]:
        """Small boxes of the active states that hold the part of Ω below a level."""

    def follows(self, claimed: Solutions) -> Obligation:
        """What is claimed of solutions from Ω."""
        return what_follows(self.evidence, claimed, self.resting, self.place)
