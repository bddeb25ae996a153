"""The units of a proof: numbers of order one are proved, and stated in the units of the model."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

__all__ = ["Units"]


@dataclass(frozen=True)
class Units:
    """What 1 in a proof is in the model; powers of two, so that nothing is rounded."""

    state: tuple[float, ...]  # (N,)
    energy: float
    time: float

    @property
    def exact(self) -> bool:
        """Whether all are positive powers of two."""
        return all(u > 0 and math.frexp(u)[0] == 0.5 for u in (*self.state, self.energy, self.time))

    @property
    def largest(self) -> float:
        """The largest unit of a state: a distance in the model is at most this per natural one."""
        return max(self.state)

    def measured(self, n: int, velocities: bool) -> tuple[float, ...]:
        """Of what is measured of n states of the plant: of these, or of (q, q̇)."""
        q = self.state[: n // 2]
        return (*q, *(size / self.time for size in q)) if velocities else self.state[:n]

    def place(self, states: Iterable[int], at: Iterable[float]) -> list[float]:
        """A point in some of the states, in the units of the model."""
        return [self.state[i] * v for i, v in zip(states, at, strict=True)]
