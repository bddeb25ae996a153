"""A region on a grid: V > c around the marked cells, and no critical point but z̄ in them."""

from __future__ import annotations

import base64
import itertools
import math
import zlib
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from flint import arb

from necc_casadi.certificate.ball_energy import Energy
from necc_casadi.certificate.ball_matrices import positive
from necc_casadi.certificate.balls import Box, everywhere
from necc_casadi.certificate.check_evidence import Evidence

__all__ = ["GridProof"]


class GridProof:
    """Cells [kh, (k+1)h]: V > c around the marked ones, no critical point but z̄ in them."""

    def __init__(
        self, checker: Evidence, energy: Energy, region: Mapping[str, Any], z_bar: Box
    ) -> None:
        self.checker, self.energy, self.z_bar = checker, energy, z_bar
        self.level = float(region["level"])
        self.first, self.shape = ([int(v) for v in region[key]] for key in ("first", "shape"))
        self.step = [float(v) for v in region["step"]]
        self.low, self.high = ([int(v) for v in ends] for ends in region["core"])
        bits = np.frombuffer(zlib.decompress(base64.b64decode(region["cells"])), dtype=np.uint8)
        count = math.prod(self.shape)
        self.cells = {
            tuple(int(v) for v in np.unravel_index(i, self.shape))
            for i in np.flatnonzero(np.unpackbits(bits, count=count))
        }

    def box(self, cell: Sequence[int]) -> Box:
        """The cell in the active states."""
        return tuple(
            ((f + k) * h, (f + k + 1) * h)
            for f, k, h in zip(self.first, cell, self.step, strict=True)
        )

    def boxes(self) -> list[Box]:
        """Boxes that cover the region."""
        return [self.box(cell) for cell in self.cells]

    def holds(self, data: Mapping[str, Any], share: float) -> bool:
        """Whether the region and the size that is claimed of it are proved again."""
        return (
            all(math.frexp(h)[0] == 0.5 for h in self.step)
            and self._in_domain()
            and self._core()
            and all(self._regular(cell) and self._enclosed(cell) for cell in self.cells)
            and self._covers(data, share)
        )

    def touches(self, cell: tuple[int, ...], border: bool) -> bool:
        """Whether the region reaches a cell of the border, or near a possible critical point."""
        beside = [
            (*cell[:axis], cell[axis] + move, *cell[axis + 1 :])
            for axis in range(len(cell))
            for move in (-1, 1)
        ]
        pairs = list(zip(cell, self.shape, strict=True))
        within = all(0 <= k < n for k, n in pairs)
        if not (within and any(c in self.cells for c in (cell, *beside))):
            return False
        if border:
            return any(k in (0, n - 1) for k, n in pairs)
        sides = zip(self.box(cell), self.step, strict=True)
        around = tuple((lo - h, hi + h) for (lo, hi), h in sides)
        in_core = all(a <= k <= b for a, k, b in zip(self.low, cell, self.high, strict=True))
        return not in_core and not any(
            bool(g > 0) or bool(g < 0) for g in self.energy.gradient(around)
        )

    def _in_domain(self) -> bool:
        bounds = self.checker.model.bounds()
        return all(
            bool(bounds[i][0] <= f * h) and bool((f + n) * h <= bounds[i][1])
            for i, f, n, h in zip(
                self.energy.active, self.first, self.shape, self.step, strict=True
            )
        )

    def _core(self) -> bool:
        """z̄ is inside a block of cells on which V is convex, and in a marked cell."""
        block = [range(a, b + 1) for a, b in zip(self.low, self.high, strict=True)]
        lo, hi = self.box(self.low), self.box(self.high)
        inside = all(
            a[0] <= z[0] and z[1] <= b[1] for a, b, z in zip(lo, hi, self.z_bar, strict=True)
        )
        within = all(
            a >= 0 and b < n for a, b, n in zip(self.low, self.high, self.shape, strict=True)
        )
        cells = list(itertools.product(*block))
        return (
            inside
            and within
            and self._marked()
            and all(
                everywhere(self.box(c), lambda b: positive(self.energy.hessian(b), 0), 6)
                for c in cells
            )
        )

    def _marked(self) -> bool:
        return any(
            all(
                lo <= z[1] and z[0] <= hi
                for (lo, hi), z in zip(self.box(c), self.z_bar, strict=True)
            )
            for c in self.cells
        )

    def _regular(self, cell: tuple[int, ...]) -> bool:
        if all(a <= k <= b for a, k, b in zip(self.low, cell, self.high, strict=True)):
            return True

        def test(box: Box) -> bool:
            gradient = self.energy.gradient(box)
            decided = any(bool(g > 0) or bool(g < 0) for g in gradient)
            finite = all(g.is_finite() for g in gradient)
            return (decided and finite) or bool(self.energy.value(box) > self.level)

        return everywhere(self.box(cell), test, 8)

    def _enclosed(self, cell: tuple[int, ...]) -> bool:
        """V > c on every face of a marked cell that no other marked cell shares."""
        box = self.box(cell)
        for axis, (lo, hi) in enumerate(box):
            for move, end in ((-1, lo), (1, hi)):
                other = (*cell[:axis], cell[axis] + move, *cell[axis + 1 :])
                face = (*box[:axis], (end, end), *box[axis + 1 :])
                if other not in self.cells and not everywhere(
                    face, lambda b: bool(self.energy.value(b) > self.level), 10
                ):
                    return False
        return True

    def _covers(self, data: Mapping[str, Any], share: float) -> bool:
        inside = [c for c in self.cells if self._below(self.box(c))]
        plant = [k for k, i in enumerate(self.energy.active) if i < self.checker.model.n]
        shadows = {tuple(c[k] for k in plant) for c in inside}
        everything = range(len(self.shape))
        return (
            share == data["domain_share"]
            and bool(self._share(len(inside), everything) >= float(share))
            and bool(self._share(len(shadows), plant) >= float(data["plant_share"]))
        )

    def _below(self, box: Box) -> bool:
        return everywhere(box, lambda b: bool(self.energy.value(b) <= self.level), 3)

    def _share(self, count: int, axes: Sequence[int]) -> arb:
        bounds = self.checker.model.bounds()
        result = arb(count) * (1 + arb(2) ** -40)  # the maker divides by a rounded volume
        for k in axes:
            lo, hi = bounds[self.energy.active[k]]
            result = result * self.step[k] / (hi - lo)
        return arb(result.upper())
