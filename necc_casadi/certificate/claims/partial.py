"""Regions by partial minimisation as data: cells of the states that are kept, and a level."""

from __future__ import annotations

import base64
import zlib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

__all__ = ["Leaf", "PartialRegion", "WholeSpace", "packed"]

Rows = tuple[tuple[float, ...], ...]
#: A cell: its depth, and its index there.
Leaf = tuple[int, tuple[int, ...]]
Side = tuple[float, float]

#: Bytes that a region's cells may take, unpacked.
_MOST_BYTES = 8_000_000


@dataclass(frozen=True)
class PartialRegion:
    """Ω = {(s, e, p): s in a marked cell, V ≤ c}; the states e are minimised out, V_ee ⪰ F."""

    level: float  # c
    active: tuple[int, ...]  # the states y = (s, e), indices in z; the others are momenta
    kept: tuple[int, ...]  # s, positions in `active`
    floor: Rows  # F
    lo: tuple[float, ...]  # of the box that is cut into cells
    side: tuple[float, ...]
    parts: int  # cells per axis at depth 0
    core: tuple[Side, ...]  # around s̄, with ∇²w ≻ 0
    cells: str  # the marked cells, see `packed`
    method: Literal["partial"] = "partial"

    @cached_property
    def leaves(self) -> tuple[Leaf, ...]:
        """The marked cells.

        Raises
        ------
        ValueError
            When they do not unpack to cells of this many states.
        """
        unpacker = zlib.decompressobj()
        data = unpacker.decompress(base64.b64decode(self.cells, validate=True), _MOST_BYTES)
        width = len(self.kept) + 1
        if unpacker.unconsumed_tail or len(data) % (4 * width):
            raise ValueError("the cells of the region are not what they should be")
        rows = np.frombuffer(data, dtype="<i4").reshape(-1, width)
        return tuple((int(row[0]), tuple(map(int, row[1:]))) for row in rows)

    def box(self, leaf: Leaf, parts: int | None = None) -> tuple[Side, ...]:
        """A cell, (ds,): ends lo + i·(side/(parts·2ᵏ)), in doubles."""
        depth, index = leaf
        count = (self.parts if parts is None else parts) * 2.0**depth
        steps = [side / count for side in self.side]
        return tuple(
            (lo + i * step, lo + (i + 1) * step)
            for lo, i, step in zip(self.lo, index, steps, strict=True)
        )

    def contains(self, V: Callable[[Sequence[float]], float], z: Sequence[float]) -> bool:
        """Whether z is in Ω, by plain evaluation of V."""
        s = [float(z[self.active[i]]) for i in self.kept]
        return self._is_marked(s) and V(z) <= self.level

    def _is_marked(self, s: Sequence[float]) -> bool:
        deepest = max((depth for depth, _ in self.leaves), default=0)
        shares = [(v - lo) / side for v, lo, side in zip(s, self.lo, self.side, strict=True)]
        if not all(0 <= share <= 1 for share in shares):
            return False
        for depth in range(deepest + 1):
            count = self.parts * 2**depth
            index = tuple(min(int(share * count), count - 1) for share in shares)
            if (depth, index) in self._marked:
                return True
        return False

    @cached_property
    def _marked(self) -> frozenset[Leaf]:
        return frozenset(self.leaves)


@dataclass(frozen=True)
class WholeSpace:
    """V has one critical point and is radially unbounded; V_ee ⪰ F ≻ 0 for every s and e."""

    active: tuple[int, ...]
    kept: tuple[int, ...]
    floor: Rows
    core: tuple[Side, ...]  # around s̄, with ∇²w ≻ 0; empty where nothing is kept


def packed(leaves: Iterable[Leaf]) -> str:
    """Cells as text: depth and index in 32-bit integers, sorted, compressed, base 64."""
    rows = [[depth, *index] for depth, index in sorted(leaves)]
    return base64.b64encode(zlib.compress(np.array(rows, dtype="<i4").tobytes(), 9)).decode()
