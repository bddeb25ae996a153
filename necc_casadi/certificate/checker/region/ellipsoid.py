"""A region in an ellipsoid around z̄: V climbs along every ray, by its curvature on shells."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from typing import Any

from flint import arb, arb_mat

from necc_casadi.certificate.checker.arithmetic.balls import Box, ball, by_bisection, ends
from necc_casadi.certificate.checker.arithmetic.definite import norm, positive
from necc_casadi.certificate.checker.arithmetic.potential import Energy
from necc_casadi.certificate.checker.evidence import Evidence
from necc_casadi.certificate.checker.region.sizes import ball_volume, sides_of, sizes_hold

__all__ = ["EllipsoidProof"]


class EllipsoidProof:
    """Shells ‖Lᵀe‖ ≤ rⱼ with ∇²V ⪰ νⱼLLᵀ, integrated twice along rays from the centre."""

    def __init__(
        self, checker: Evidence, energy: Energy, region: Mapping[str, Any], z_bar: Box
    ) -> None:
        self.checker, self.energy, self.z_bar = checker, energy, z_bar
        self.level, self.above = float(region["level"]), float(region["above"])
        self.center = [float(v) for v in region["center"]]
        L = [[float(v) for v in row] for row in region["L"]]
        self.d = len(self.center)
        self.Lt = arb_mat(L).transpose()
        self.P = arb_mat(L) * self.Lt
        self.inverse = self.Lt.inv()
        self.radii, self.nu, self.step = (
            [float(v) for v in region[key]] for key in ("radii", "nu", "step")
        )

    def hull(self) -> Box:
        """A box that holds the region."""
        half = self._half(self.radii[-1])
        return tuple(ends(c + h * ball(-1.0, 1.0)) for c, h in zip(self.center, half, strict=True))

    def holds(self, data: Mapping[str, Any], share: float) -> bool:
        """Whether the region and the size that is claimed of it are proved again."""
        increasing = all(a < b for a, b in zip([0.0, *self.radii], self.radii, strict=False))
        sound = increasing and all(h > 0 for h in self.step) and len(self.nu) == len(self.radii)
        return (
            sound
            and self._in_domain()
            and bool(self._length(self.z_bar) < self.radii[0])
            and self._climbs()
            and all(self._curved(box) for box in self._cells())
            and self._covers(data, share)
        )

    def _half(self, radius: float | arb) -> list[arb]:
        rows = self.inverse.tolist()
        return [arb(radius) * norm(row) for row in rows]

    def _in_domain(self) -> bool:
        bounds = self.checker.model.bounds()
        return all(
            bool(bounds[i][0] <= c - h) and bool(c + h <= bounds[i][1])
            for i, c, h in zip(
                self.energy.active, self.center, self._half(self.radii[-1]), strict=True
            )
        )

    def _length(self, box: Box) -> arb:
        """‖Lᵀe‖ over a box."""
        e = arb_mat([[ball(*b) - c] for b, c in zip(box, self.center, strict=True)])
        return norm([row[0] for row in (self.Lt * e).tolist()])

    def _climbs(self) -> bool:
        at: Box = tuple((c, c) for c in self.center)
        g = arb_mat([[v] for v in self.energy.gradient(at)])
        slope = -norm([row[0] for row in (self.inverse.transpose() * g).tolist()])
        height, inner = self.energy.value(at), arb(0)
        for outer, nu in zip(self.radii, self.nu, strict=True):
            width = outer - inner
            end = slope + nu * width
            if not end > 0:
                return False
            height, slope, inner = height + width * (slope + end) / 2, end, arb(outer)
        return bool(height > self.level)

    def boxes(self) -> list[Box]:
        """Boxes that cover the region."""
        return self._cells()

    def _cells(self) -> list[Box]:
        """Cells at multiples of the step that may meet the ellipsoid."""
        axes = []
        for c, h, s in zip(self.center, self._half(self.radii[-1]), self.step, strict=True):
            first = math.floor(float((c - h).lower()) / s) - 1
            last = math.floor(float((c + h).upper()) / s) + 1
            axes.append([(k * s, (k + 1) * s) for k in range(first, last + 1)])
        boxes = itertools.product(*axes)
        return [box for box in boxes if not self._length(box) > self.radii[-1]]

    def _curved(self, box: Box) -> bool:
        def test(piece: Box) -> bool:
            length = self._length(piece)
            if length > self.radii[-1]:
                return True
            inner = [0.0, *self.radii[:-1]]
            met = [
                nu
                for a, b, nu in zip(inner, self.radii, self.nu, strict=True)
                if not (length < a or length > b)
            ]
            return positive(self.energy.hessian(piece) - self.P * arb(max(met)), 0)

        return by_bisection(box, test, 10)

    def _covers(self, data: Mapping[str, Any], share: float) -> bool:
        """The ellipsoid ½ above |y − z̄|² ≤ height is in the region; its size is as claimed."""
        bottom, near = self.energy.value(self.z_bar), self._length(self.z_bar)
        room = arb(self.radii[-1]) - near.upper()
        radius = (2 * (self.level - bottom) / self.above).sqrt().min(room)
        return sizes_hold(self._sizes(radius), data, share) and all(
            self._flat(box, radius + near.upper()) for box in self._cells()
        )

    def _sizes(self, radius: arb) -> dict[str, arb]:
        """Sizes of the ellipsoid ‖Lᵀ(y − z̄)‖ ≤ radius, of its slice and of its shadow."""
        model, active, L = self.checker.model, self.energy.active, self.Lt.transpose().tolist()
        n, d = self.d - model.nc, self.d
        whole, plant = sides_of(model, active), sides_of(model, active[:n])
        offset = [[v - ball(*z)] for v, z in zip(model.xi_star, self.z_bar[n:], strict=True)]
        tail = arb_mat([row[n:] for row in L[n:]]).transpose() * arb_mat(offset)
        shift = norm([row[0] for row in tail.tolist()])
        within = (radius * radius - shift * shift).max(arb(0)).sqrt()
        volume = ball_volume(d) * radius**d / abs(self.Lt.det())
        covered = arb_mat([row[:n] for row in L[:n]]).det()  # of the plant's block of P, rooted
        inverse = self.P.inv().tolist()
        shadow = arb_mat([row[:n] for row in inverse[:n]]).det().max(arb(0)).sqrt()
        half = zip(active, self._half(radius), strict=True)
        return {
            "volume": volume,
            "domain_share": volume / whole,
            "slice_share": ball_volume(n) * within**n / abs(covered) / plant,
            "plant_share": ball_volume(n) * radius**n * shadow / plant,
            **{f"reach_{model.states[i]}": h for i, h in half},
        }

    def _flat(self, box: Box, radius: arb) -> bool:
        def test(piece: Box) -> bool:
            if self._length(piece) > radius:
                return True
            return positive(self.P * arb(self.above) - self.energy.hessian(piece, -1), 0)

        return by_bisection(box, test, 10)
