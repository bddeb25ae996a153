"""What every part of the checker works with: the model, the certificate's data, and V in balls."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from flint import arb

from necc_casadi.certificate.checker.arithmetic.balls import Box, ball, ends
from necc_casadi.certificate.checker.arithmetic.potential import Energy
from necc_casadi.certificate.checker.model import StoredDesign
from necc_casadi.certificate.claims.certificate import Certificate
from necc_casadi.certificate.claims.fields import Fields

__all__ = ["Checked", "Evidence", "Obligation"]


#: What has to be proved, in words, and the proof, which is tried when its turn comes.
Obligation = tuple[str, Callable[[], bool]]


@dataclass(frozen=True)
class Checked:
    """A claim after checking."""

    name: str
    holds: bool
    statement: str  # worded by what the checker proved, or would have to

    @classmethod
    def by(cls, name: str, statement: str, obligations: Iterable[Obligation]) -> Checked:
        """Held where every obligation is proved, in order; otherwise the first that is not."""
        missing = next((what for what, proved in obligations if not proved()), None)
        if missing is None:
            return cls(name, True, statement)
        return cls(name, False, f"{statement}; not proved: {missing}")


class Evidence:
    """A design and the numbers of its certificate, which are hints until they are proved again."""

    def __init__(self, model: StoredDesign, stored: Fields) -> None:
        self.model, self.stored = model, stored
        self.certificate = Certificate.read(stored)
        self.claims = {claim.name: claim for claim in self.certificate.claims}
        self.full = Energy(model, range(len(model.z)))
        self._reduced: dict[tuple[int, ...], Energy] = {}
        if self.certificate.units != model.units:
            raise ValueError("the certificate is in other units than the design")
        #: The claimed z̄ in natural units, as everything that is proved.
        self.minimum = [
            v / u for v, u in zip(self.certificate.z_bar, model.units.state, strict=True)
        ]

    def claimed(self, name: str) -> bool:
        """Whether a claim is listed and held."""
        return name in self.claims and self.claims[name].holds

    def number(self, name: str, key: str) -> float:
        """A number that a claim names.

        Raises
        ------
        KeyError, ValueError
            When it names none; a truth value is none.
        """
        value = self.claims[name].data[key]
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise ValueError(f"{name}: {key} is no number")
        return float(value)

    def reduced(self, active: Sequence[int]) -> Energy:
        """V in some of the states, the others at rest; one object, which keeps its results."""
        key = tuple(active)
        if key not in self._reduced:
            self._reduced[key] = Energy(self.model, active)
        return self._reduced[key]

    def z_bar(self, active: Sequence[int]) -> Box:
        """A box that holds z̄, in some of the states.

        Raises
        ------
        ValueError
            When the certificate does not say how near z̄ is.
        """
        radius, z = self.certificate.enclosure, self.minimum
        if radius is None:
            raise ValueError("no enclosure of z̄")
        return tuple(ends(arb(z[i]) + ball(-radius, radius)) for i in active)
