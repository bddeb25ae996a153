"""What every part of the checker works with: the model, the certificate's data, and V in balls."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from flint import arb

from necc_casadi.certificate.checker.arithmetic.balls import Box, ball, ends
from necc_casadi.certificate.checker.arithmetic.potential import Energy
from necc_casadi.certificate.checker.model import StoredDesign
from necc_casadi.certificate.claims.fields import Fields

__all__ = ["Checked", "Evidence"]


@dataclass(frozen=True)
class Checked:
    """A claim after checking."""

    name: str
    holds: bool
    statement: str  # worded by what the checker proved, or would have to


class Evidence:
    """A design and the numbers of its certificate, which are hints until they are proved again."""

    def __init__(self, model: StoredDesign, certificate: Fields) -> None:
        self.model, self.certificate = model, certificate
        self.listed = [Fields(claim, f"{claim['name']}: ") for claim in certificate["claims"]]
        self.claims = {str(claim["name"]): claim for claim in self.listed}
        self.full = Energy(model, range(len(model.z)))
        self._reduced: dict[tuple[int, ...], Energy] = {}

    def claimed(self, name: str) -> bool:
        """Whether a claim is listed and held."""
        return name in self.claims and self.claims[name]["holds"] is True

    def reduced(self, active: Sequence[int]) -> Energy:
        """V in some of the states, the others at rest; one object, which keeps its results."""
        key = tuple(active)
        if key not in self._reduced:
            self._reduced[key] = Energy(self.model, active)
        return self._reduced[key]

    def z_bar(self, active: Sequence[int]) -> Box:
        """A box that holds z̄, in some of the states."""
        radius, z = float(self.certificate["enclosure"]), self.certificate["z_bar"]
        return tuple(ends(arb(float(z[i])) + ball(-radius, radius)) for i in active)
