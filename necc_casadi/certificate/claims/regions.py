"""Regions as data: what maker and checker both read."""

from __future__ import annotations

import base64
import zlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from necc_casadi.arrays import Truth, Vector
from necc_casadi.certificate.claims.fields import Entries
from necc_casadi.certificate.claims.motions import Follows, Step

__all__ = [
    "MOST_CELLS",
    "Bends",
    "CellBox",
    "GlobalClaim",
    "Leaf",
    "Lyapunov",
    "Obstacle",
    "ObstacleKind",
    "Region",
    "Rows",
    "Side",
    "Stability",
    "numbers",
    "packed",
    "rows",
]


Rows = tuple[tuple[float, ...], ...]
Side = tuple[float, float]
#: A cell: its depth, and its index there.
Leaf = tuple[int, tuple[int, ...]]
#: V as a function of all states.
Lyapunov = Callable[[Sequence[float]], float]
#: Numbers below f″ of Hc and of K without their quadratic parts, where the line was searched.
Bends = tuple[float | None, float | None]

#: What is proved of z̄.
Stability = Literal["asymptotic", "stable"]
#: What a region ends at: another critical point of V, a pole of the model, the user's own bounds of
#: states or inputs; or the proof gave up below one of these.
ObstacleKind = Literal["critical_point", "singularity", "domain", "input_limits", "arithmetic"]

#: Cells that a region may have, and how often one of its first cells may be halved.
MOST_CELLS, _DEEPEST = 200_000, 40
#: States that are not minimised out, at most.
MOST_KEPT = 3


@dataclass(frozen=True)
class Obstacle:
    """What the region stays just below, in the units of the model."""

    kind: ObstacleKind
    at: Mapping[str, float]  # state → value; empty where it is no place
    level_above_minimum: float  # V − V(z̄) there


@dataclass(frozen=True)
class CellBox:
    """A box that is cut into n cells a side, and each of them into halves as often as needed.

    The ends of cell i at depth k are lo + i·(side/(n·2ᵏ)), in doubles.
    """

    lo: tuple[float, ...]  # (ds,)
    side: tuple[float, ...]
    parts: int  # n

    def cell(self, leaf: Leaf) -> tuple[Side, ...]:
        """A cell, (ds,)."""
        depth, index = leaf
        count = self.parts * 2.0**depth
        steps = [side / count for side in self.side]
        return tuple(
            (lo + i * step, lo + (i + 1) * step)
            for lo, i, step in zip(self.lo, index, steps, strict=True)
        )

    @property
    def whole(self) -> tuple[Side, ...]:
        """The box, (ds,): first ends of its first cells, last ends of its last."""
        first = self.cell((0, (0,) * len(self.lo)))
        last = self.cell((0, (self.parts - 1,) * len(self.lo)))
        return tuple((lo, hi) for (lo, _), (_, hi) in zip(first, last, strict=True))


@dataclass(frozen=True)
class Region:
    """Ω = {(s, e, p): s in a marked cell, e in E, V ≤ c}; e are minimised out, V_ee ⪰ F on E."""

    level: float  # c
    active: tuple[int, ...]  # the states y = (s, e), indices in z; the others are momenta p
    kept: tuple[int, ...]  # s, positions in `active`
    floor: Rows  # F
    bends: Bends  # what F rests on
    tube: tuple[Side, ...]  # E, a side for each of e; empty: all e
    box: CellBox  # of s
    core: tuple[Side, ...]  # around s̄, with ∇²w ≻ 0
    cells: str  # the marked cells, see `packed`
    method: Literal["cells"] = "cells"

    @cached_property
    def leaves(self) -> tuple[Leaf, ...]:
        """The marked cells.

        Raises
        ------
        ValueError
            When they do not unpack to cells of the box, each named once.
        """
        width = len(self.kept) + 1
        unpacker = zlib.decompressobj()
        most = 4 * width * MOST_CELLS
        data = unpacker.decompress(base64.b64decode(self.cells, validate=True), most + 1)
        if len(data) > most or len(data) % (4 * width) or not data:
            raise ValueError("the cells of the region are not what they should be")
        table = np.frombuffer(data, dtype="<i4").reshape(-1, width).astype(np.int64)
        depth, index = table[:, 0], table[:, 1:]
        sound = (depth >= 0) & (depth <= _DEEPEST) & (index >= 0).all(1)
        count = self.box.parts * 2.0 ** np.clip(depth, 0, _DEEPEST)
        if not (sound & (index < count[:, None]).all(1)).all():
            raise ValueError("the region has a cell outside of its box")
        if len(np.unique(table, axis=0)) < len(table):
            raise ValueError("the region names a cell twice")
        return tuple((int(row[0]), tuple(map(int, row[1:]))) for row in table)

    def contains(self, V: Lyapunov, z: Sequence[float]) -> bool:
        """Whether z is in Ω, by plain evaluation of V."""
        return bool(self.holds(np.array([z], float))[0]) and V(z) <= self.level

    def holds(self, z: Vector) -> Truth:
        """Whether states (B, N) are over marked cells and in the tube, (B,)."""
        s = z[:, [self.active[i] for i in self.kept]]
        gone = [i for k, i in enumerate(self.active) if k not in self.kept]
        inside = self.covers(s)
        for i, (lo, hi) in zip(gone, self.tube, strict=False):
            inside &= (lo <= z[:, i]) & (z[:, i] <= hi)
        return inside

    def covers(self, s: Vector) -> Truth:
        """Whether points (B, ds) are in marked cells, (B,)."""
        shares = (s - np.array(self.box.lo)) / np.array(self.box.side)
        inside: Truth = ((shares >= 0) & (shares <= 1)).all(1)
        found = np.zeros(len(s), dtype=bool)
        for depth, marked in self._by_depth.items():
            count = self.box.parts * 2**depth
            index = np.clip((shares * count), 0, count - 1).astype(np.int64)
            found |= np.array([tuple(row) in marked for row in index.tolist()], dtype=bool)
        return inside & found

    @cached_property
    def _by_depth(self) -> dict[int, set[tuple[int, ...]]]:
        result: dict[int, set[tuple[int, ...]]] = {}
        for depth, index in self.leaves:
            result.setdefault(depth, set()).add(index)
        return result


@dataclass(frozen=True)
class GlobalClaim(Entries):
    """V is radially unbounded and has one critical point; V_ee ⪰ F ≻ 0 for every e."""

    active: tuple[int, ...]  # the states y = (s, e); the others are momenta
    kept: tuple[int, ...]  # s, positions in `active`
    floor: Rows  # F
    bends: Bends  # what F rests on
    core: tuple[Side, ...]  # around s̄, with ∇²w ≻ 0
    follows: Follows
    motion: tuple[Step, ...] = ()  # what that rests on, if on anything


def packed(leaves: Iterable[Leaf]) -> str:
    """Cells as text: depth and index in 32-bit integers, sorted, compressed, base 64."""
    table = [[depth, *index] for depth, index in sorted(leaves)]
    return base64.b64encode(zlib.compress(np.array(table, dtype="<i4").tobytes(), 9)).decode()


def numbers(v: Vector) -> tuple[float, ...]:
    """A vector as data."""
    return tuple(map(float, v))


def rows(A: Vector) -> Rows:
    """A matrix as data, row by row."""
    return tuple(numbers(row) for row in A)
