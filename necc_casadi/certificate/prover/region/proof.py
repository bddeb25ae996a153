"""What every proved region says of itself."""

from __future__ import annotations

from abc import ABC, abstractmethod

from necc_casadi.certificate.claims.curved import CurvedRegion
from necc_casadi.certificate.claims.regions import Region
from necc_casadi.certificate.prover.invariant_sets import OverBox
from necc_casadi.certificate.prover.region.obstacle import Obstacle

__all__ = ["RegionProof"]

#: The share of a height above V(z̄) that is given away, for other arithmetic.
_EASED = 1e-6


class RegionProof(ABC):
    """The component Ω of {V ≤ c} around z̄, and what ends it; natural units."""

    @property
    @abstractmethod
    def region(self) -> Region | CurvedRegion:
        """Ω as data."""

    @property
    @abstractmethod
    def obstacle(self) -> Obstacle:
        """What Ω stays just below."""

    @property
    @abstractmethod
    def bottom(self) -> float:
        """An upper bound of V(z̄)."""

    @property
    @abstractmethod
    def place(self) -> OverBox:
        """A box (N,) of all states that holds Ω, with room for other arithmetic."""

    @property
    def angles(self) -> tuple[int, ...]:
        """States that may take every value; the box holds one period of each."""
        return ()

    @property
    def level_u(self) -> float | None:
        """The largest level that was found at which u keeps its limits; None: none was."""
        return None

    @property
    def level_clipped(self) -> float | None:
        """The largest level that was found at which clipped inputs do no harm; None: none was."""
        return None

    @property
    def level(self) -> float:
        """The level c."""
        return self.region.level

    def height(self, level: float) -> float:
        """Less than a level above V(z̄), by what other arithmetic may need."""
        return (1 - _EASED) * (level - self.bottom)
