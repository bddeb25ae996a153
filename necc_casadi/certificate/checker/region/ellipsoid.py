"""A region in an ellipsoid around z̄: V climbs along every ray, by its curvature on shells.

The component of {V ≤ c} cannot leave the ellipsoid |e| ≤ ρ, on whose boundary V exceeds c; along
its rays V rises, so z̄ is its only critical point there. See shells.py for the integral.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping
from functools import cached_property

from flint import arb, arb_mat

from necc_casadi.certificate.checker.arithmetic.balls import Box, ball, by_bisection
from necc_casadi.certificate.checker.arithmetic.definite import norm
from necc_casadi.certificate.checker.arithmetic.potential import Energy
from necc_casadi.certificate.checker.evidence import Evidence, Obligation
from necc_casadi.certificate.checker.region.shells import Shells
from necc_casadi.certificate.checker.region.sizes import ball_volume, sides_of, sizes_hold
from necc_casadi.certificate.claims.regions import EllipsoidRegion, LimitedBy

__all__ = ["EllipsoidProof"]


#: How often a cell may be halved before a test on it counts as failed.
_DEPTH = 10


class EllipsoidProof:
    """Shells ‖Lᵀe‖ ≤ rⱼ with ∇²V ⪰ νⱼLLᵀ, integrated twice along rays from the centre."""

    def __init__(
        self, evidence: Evidence, energy: Energy, region: EllipsoidRegion, z_bar: Box
    ) -> None:
        self.model, self.energy, self.region, self.z_bar = evidence.model, energy, region, z_bar
        Lt = arb_mat([list(row) for row in region.L]).transpose()
        self.shells = Shells(energy, region.center, Lt, region.radii, region.nu, region.above)

    def hull(self) -> Box:
        """A box that holds the region."""
        return self.shells.box(self.region.radii[-1])

    def boxes(self) -> list[Box]:
        """Boxes that cover the region."""
        return self._cells

    def ends_at(self, limit: LimitedBy) -> bool:
        """An ellipsoid names no cell that limits it."""
        return False

    def obligations(self, sizes: Mapping[str, float], share: float) -> list[Obligation]:
        """Shells in the domain that V climbs to above c, their curvature, and the sizes."""
        shells, region = self.shells, self.region
        return [
            ("the shells are in order", shells.increasing),
            ("the cells have sides", lambda: all(h > 0 for h in region.step)),
            ("the ellipsoid lies in the domain", self._in_domain),
            ("z̄ is in the first shell", lambda: bool(shells.length(self.z_bar) < region.radii[0])),
            ("V rises along rays", shells.rises),
            ("V > c around the ellipsoid", self._climbs),
            ("∇²V ⪰ νLLᵀ on the shells", lambda: self._on_cells(shells.bent)),
            ("the sizes claimed", lambda: sizes_hold(self._sizes(self._radius), sizes, share)),
            ("∇²V ⪯ above·LLᵀ on what the sizes are of", self._flat),
        ]

    def _in_domain(self) -> bool:
        half = self.shells.half_axes(self.region.radii[-1])
        pairs = zip(self.region.center, half, strict=True)
        return self.model.in_domain(self.region.active, [(c - h, c + h) for c, h in pairs])

    def _climbs(self) -> bool:
        shells = self.shells
        return bool(shells.bottom + shells.at(arb(self.region.radii[-1])) > self.region.level)

    @cached_property
    def _cells(self) -> list[Box]:
        """Cells at multiples of the step that may meet the ellipsoid."""
        axes, radius = [], self.region.radii[-1]
        half = self.shells.half_axes(radius)
        for c, h, s in zip(self.region.center, half, self.region.step, strict=True):
            first = math.floor(float((c - h).lower()) / s) - 1
            last = math.floor(float((c + h).upper()) / s) + 1
            axes.append([(k * s, (k + 1) * s) for k in range(first, last + 1)])
        return [box for box in itertools.product(*axes) if not self.shells.length(box) > radius]

    def _on_cells(self, test: Callable[[Box], bool]) -> bool:
        return all(by_bisection(cell, test, _DEPTH) for cell in self._cells)

    @property
    def _radius(self) -> arb:
        """The ellipsoid ½ above |y − z̄|² ≤ c − V(z̄) is in the region, as far as the shells go."""
        height = self.region.level - self.energy.value(self.z_bar)
        room = arb(self.region.radii[-1]) - self.shells.length(self.z_bar).upper()
        return arb((2 * height / self.region.above).sqrt().min(room))

    def _flat(self) -> bool:
        reach = self._radius + self.shells.length(self.z_bar).upper()
        return self._on_cells(lambda box: self.shells.flat(box, reach))

    def _sizes(self, radius: arb) -> dict[str, arb]:
        """Sizes of the ellipsoid ‖Lᵀ(y − z̄)‖ ≤ radius, of its slice and of its shadow."""
        model, active, L = self.model, self.region.active, self.region.L
        d = len(active)
        n = d - model.nc
        whole, plant = sides_of(model, active), sides_of(model, active[:n])
        offset = [[v - ball(*z)] for v, z in zip(model.xi_star, self.z_bar[n:], strict=True)]
        tail = arb_mat([row[n:] for row in L[n:]]).transpose() * arb_mat(offset)
        shift = norm([row[0] for row in tail.tolist()])
        within = (radius * radius - shift * shift).max(arb(0)).sqrt()
        volume = ball_volume(d) * radius**d / abs(self.shells.A.det())
        covered = arb_mat([row[:n] for row in L[:n]]).det()  # of the plant's block of P, rooted
        inverse = self.shells.P.inv().tolist()
        shadow = arb_mat([row[:n] for row in inverse[:n]]).det().max(arb(0)).sqrt()
        half = zip(active, self.shells.half_axes(radius), strict=True)
        return {
            "volume": volume,
            "domain_share": volume / whole,
            "slice_share": ball_volume(n) * within**n / abs(covered) / plant,
            "plant_share": ball_volume(n) * radius**n * shadow / plant,
            **{f"reach_{model.states[i]}": h for i, h in half},
        }
