"""What a region is said to end at, proved to be that."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from flint import arb, arb_mat

from necc_casadi.certificate.checker.arithmetic.balls import Box, ball, ends
from necc_casadi.certificate.checker.arithmetic.definite import middle_of
from necc_casadi.certificate.checker.arithmetic.potential import Energy, hessian_hull
from necc_casadi.certificate.checker.arithmetic.smooth import ends_within
from necc_casadi.certificate.checker.evidence import Evidence, Obligation
from necc_casadi.certificate.claims.regions import Obstacle, Side

__all__ = ["ObstacleProof"]

#: The height that is told may be off by this share; a place by this much of its magnitude, in
#: natural units; a critical point is proved in a box of this half-width; a pole within this share
#: of the region's reach.
_ABOUT, _CLOSE, _TIGHT, _BESIDE = 1e-5, 1e-9, 1e-8, 0.1


class ObstacleProof:
    """The place and the height of an obstacle, in natural units."""

    def __init__(
        self,
        evidence: Evidence,
        level: float,
        active: Sequence[int],
        obstacle: Obstacle,
        reach: Sequence[Side | None],
    ) -> None:
        self.evidence, self.obstacle, self.reach = evidence, obstacle, reach
        self.level, self.active = level, tuple(active)
        self.model = evidence.model
        units = self.model.units
        self.height = obstacle.level_above_minimum / units.energy
        self.at = [
            obstacle.at[name] / unit
            for name, unit in zip(self.model.states, units.state, strict=True)
            if name in obstacle.at
        ]

    def obligations(self, bottom: arb) -> list[Obligation]:
        """That the obstacle is what it is said to be, at that height, above the region."""
        kinds = {
            "critical_point": self._is_critical,
            "singularity": self._is_singular,
            "domain": self._is_at_a_bound,
            "input_limits": self._ends_at_the_inputs,
            "arithmetic": lambda: True,
        }
        return [
            ("the obstacle has a place", self._is_placed),
            ("the obstacle is at that height", lambda: self._is_at_height(bottom)),
            ("the obstacle is what it is said to be", kinds[self.obstacle.kind]),
        ]

    def _is_placed(self) -> bool:
        states = [] if self.obstacle.kind == "input_limits" else self.model.states
        return list(self.obstacle.at) == list(states)

    def _is_at_height(self, bottom: arb) -> bool:
        """The height told is that of V, and the region's level is not above it."""
        level = arb(self.level)
        if self.obstacle.kind != "input_limits":
            level = self.evidence.full.value(tuple((v, v) for v in self.at))
        off = abs(level - bottom - self.height)
        return bool(off <= _ABOUT * self.height) and bool(level >= self.level)

    def _is_critical(self) -> bool:
        """Krawczyk's test around the place, the momenta at rest."""
        active = self.active
        if any(v != 0 for i, v in enumerate(self.at) if i not in active):
            return False
        y = [self.at[i] for i in active]
        half = [_TIGHT * (1 + abs(v)) for v in y]
        box: Box = tuple(ends(arb(v) + ball(-h, h)) for v, h in zip(y, half, strict=True))
        return _holds_a_zero(self.evidence.reduced(active), y, half, box)

    def _is_singular(self) -> bool:
        """Whether the loop is proved to have a pole or a kink in the neighbourhood."""
        around: Box = tuple(
            ends(arb(v) + _length(side) * _BESIDE * ball(-1.0, 1.0))
            for v, side in zip(self.at, self.reach, strict=True)
        )
        return ends_within(self.model.written, self.model.z, around)

    def _is_at_a_bound(self) -> bool:
        return any(
            any(
                math.isfinite(end) and abs(v - end) <= _CLOSE * (1 + abs(end))
                for end in self.model.named_bounds[i]
            )
            for i, v in enumerate(self.at)
        )

    def _ends_at_the_inputs(self) -> bool:
        certificate = self.evidence.certificate
        bound = {"input_limits": certificate.level_u, "clipping": certificate.level_clipped}
        return any(
            self.evidence.claimed(name) and level == certificate.level
            for name, level in bound.items()
        )


def _length(side: Side | None) -> arb:
    """How far a state reaches; a period of one that may take every value."""
    return 2 * arb.pi() if side is None else arb(side[1]) - side[0]


def _holds_a_zero(energy: Energy, y: list[float], half: list[float], box: Box) -> bool:
    """Whether ∇V has a zero in a box around y."""
    H, slope = hessian_hull(energy, box), energy.gradient(tuple((v, v) for v in y))
    middle = middle_of(H)
    if not np.isfinite(middle).all() or np.linalg.matrix_rank(middle) < len(y):
        return False
    T = arb_mat(np.linalg.inv(middle).tolist())
    steps = (T * arb_mat([[g] for g in slope])).tolist()
    excess = T * H
    for i in range(len(y)):
        excess[i, i] = excess[i, i] - 1
    spread = (excess * arb_mat([[ball(-h, h)] for h in half])).tolist()
    return all(bool(abs(a[0] + b[0]) < h) for a, b, h in zip(steps, spread, half, strict=True))
