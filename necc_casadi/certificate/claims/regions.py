"""Regions as data: what maker and checker both read.

How a region is cut into boxes, and what its box is, each side works out for itself.
"""

from __future__ import annotations

import base64
import math
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, Protocol

import numpy as np

from necc_casadi.arrays import Truth, Vector
from necc_casadi.certificate.claims.fields import read_as

__all__ = [
    "Block",
    "ChartRegion",
    "EllipsoidRegion",
    "Follows",
    "Grid",
    "GridRegion",
    "Kind",
    "LimitedBy",
    "Lyapunov",
    "Method",
    "RegionClaim",
    "Rows",
    "Stability",
    "numbers",
    "read_region",
    "rows",
]


Rows = tuple[tuple[float, ...], ...]
#: First and last cell of a block, ends included.
Block = tuple[tuple[int, ...], tuple[int, ...]]
#: V as a function of all states.
Lyapunov = Callable[[Sequence[float]], float]

#: What is proved of z̄.
Stability = Literal["asymptotic", "stable"]
#: What is proved of solutions from a region: all go to z̄, some do, or they stay.
Follows = Literal["converges", "invariant", "stable"]
#: How a region is described and proved.
Method = Literal["grid", "ellipsoid", "chart"]
#: What stops a search: a momentum, the border of the domain or of the cells, a possible critical
#: point, a pole of the loop, or nothing but the method itself.
Kind = Literal["momentum", "border", "cells", "critical", "undefined", "method"]

#: Cells of a grid that is read: far more than any search makes.
_MOST_CELLS = 1 << 24


#: What stops a flood of cells at one of them.
_AT_A_CELL: frozenset[Kind] = frozenset({"border", "cells", "critical"})


@dataclass(frozen=True)
class LimitedBy:
    """What stopped the search for a larger region."""

    kind: Kind
    at: tuple[int, ...] = ()  # index of the momentum in z, or of the cell in the grid

    @property
    def names_a_cell(self) -> bool:
        """Whether `at` is a cell."""
        return self.kind in _AT_A_CELL

    @property
    def data(self) -> dict[str, Any]:
        """The entry of certificate.json."""
        return {"kind": self.kind, "at": list(self.at)}


class RegionClaim(Protocol):
    """What every region says: Ω is a component of {V ≤ c}, described in the active states."""

    @property
    def method(self) -> Method:
        """How it is described."""
        ...

    @property
    def level(self) -> float:
        """The level c."""
        ...

    @property
    def active(self) -> tuple[int, ...]:
        """The states y; the others are momenta."""
        ...

    def contains(self, V: Lyapunov, z: Sequence[float]) -> bool:
        """Whether z is in Ω, by plain evaluation of V."""
        ...

    def place(self, limit: LimitedBy) -> list[float]:
        """Where in the active states a limit is; empty where it is no place."""
        ...


@dataclass(frozen=True, eq=False)
class Grid:
    """Cells [kᵢhᵢ, (kᵢ+1)hᵢ] with first ≤ k < first + shape; hᵢ are powers of two, so exact."""

    first: tuple[int, ...]  # (d,)
    shape: tuple[int, ...]  # (d,)
    step: tuple[float, ...]  # (d,)

    @property
    def size(self) -> int:
        """Number of cells."""
        return math.prod(self.shape)

    def cell_of(self, y: Vector) -> tuple[int, ...] | None:
        """The cell that holds a point (d,), by plain division; None outside of the grid."""
        index = np.floor(np.asarray(y, float) / np.array(self.step)).astype(int) - self.first
        inside = bool(np.all(index >= 0) and np.all(index < np.array(self.shape)))
        return tuple(map(int, index)) if inside else None


@dataclass(frozen=True)
class GridRegion:
    """Ω as a level and the grid cells that hold the component of {V(y, 0) ≤ c}."""

    level: float  # c
    active: tuple[int, ...]  # the states y
    first: tuple[int, ...]  # grid, see Grid
    shape: tuple[int, ...]
    step: tuple[float, ...]
    convex_block: Block  # of cells around z̄ with ∇²V ≻ 0
    cells: str  # bits of the component, compressed, base 64
    method: Literal["grid"] = "grid"

    @property
    def grid(self) -> Grid:
        """The cells."""
        return Grid(self.first, self.shape, self.step)

    @property
    def mask(self) -> Truth:
        """The cells of the component, in the shape of the grid."""
        count = math.prod(self.shape)
        if min(self.shape, default=0) < 1 or count > _MOST_CELLS:
            raise ValueError(f"a grid of {count} cells")
        unpacked = zlib.decompressobj().decompress(
            base64.b64decode(self.cells, validate=True), count // 8 + 2
        )
        bits = np.frombuffer(unpacked, dtype=np.uint8)
        if bits.size != -(-count // 8):
            raise ValueError("the grid has more or fewer cells than its shape")
        return np.unpackbits(bits, count=count).astype(bool).reshape(self.shape)

    def contains(self, V: Lyapunov, z: Sequence[float]) -> bool:
        """Whether z is in Ω, by plain evaluation of V."""
        cell = self.grid.cell_of(np.asarray(z, float)[list(self.active)])
        return cell is not None and bool(self.mask[cell]) and V(z) <= self.level

    def place(self, limit: LimitedBy) -> list[float]:
        """Middle of the cell of a limit, exact where the steps are powers of two."""
        if not limit.names_a_cell:
            return []
        parts = zip(self.first, limit.at, self.step, strict=True)
        return [(f + k + 0.5) * h for f, k, h in parts]


@dataclass(frozen=True)
class EllipsoidRegion:
    """Ω as a level and the ellipsoid that holds the component of {V(y, 0) ≤ c}, by shells of it."""

    level: float  # c
    active: tuple[int, ...]  # the states y
    center: tuple[float, ...]  # ȳ
    L: Rows  # lower triangular; |e| = ‖Lᵀe‖ for e = y − ȳ
    radii: tuple[float, ...]  # outer radius of each shell
    nu: tuple[float, ...]  # ∇²V ⪰ νLLᵀ on each shell
    step: tuple[float, ...]  # sides of the cells that cover it
    above: float  # ∇²V ⪯ above·LLᵀ on the ellipsoid
    method: Literal["ellipsoid"] = "ellipsoid"

    def contains(self, V: Lyapunov, z: Sequence[float]) -> bool:
        """Whether z is in Ω, by plain evaluation of V."""
        e = np.asarray(z, float)[list(self.active)] - np.array(self.center)
        inside = np.linalg.norm(np.array(self.L).T @ e) <= self.radii[-1]
        return bool(inside and V(z) <= self.level)

    def place(self, limit: LimitedBy) -> list[float]:
        """No limit of an ellipsoid is a place."""
        return []


@dataclass(frozen=True)
class ChartRegion:
    """Ω as a level and what proves it: scales, shells, and the box of the fibre."""

    level: float  # c
    active: tuple[int, ...]  # the states y = (q, ξ)
    center: tuple[float, ...]  # ȳ
    middle: tuple[float, ...]  # c̄
    scale_k: Rows  # A_K, r × r
    scale_h: Rows  # A_H, nc × nc
    radii_k: tuple[float, ...]  # shells of K in |α|
    nu_k: tuple[float, ...]  # ∇²K ⪰ ν A_KᵀA_K on them
    radii_h: tuple[float, ...]  # shells of Hc in |η|
    nu_h: tuple[float, ...]
    above: float  # ∇²K ⪯ above·A_KᵀA_K and ∇²Hc ⪯ above·A_HᵀA_H on the shells
    a: float  # |α| ≤ a and
    b: float  # |η| ≤ b in Ω
    fibre: Rows  # (lo, hi) of the box around |α| ≤ a at ξ̄
    method: Literal["chart"] = "chart"

    def contains(self, V: Lyapunov, z: Sequence[float]) -> bool:
        """Whether V ≤ c on the straight way to z, by plain evaluation; sufficient for z in Ω."""
        end, r = np.asarray(z, float), len(self.middle)
        start = end.copy()
        start[list(self.active)] = self.center
        path = start + np.linspace(0.0, 1.0, 65)[:, None] * (end - start)
        eta = (path[:, list(self.active[r:])] - self.center[r:]) @ np.array(self.scale_h).T
        near = bool((np.linalg.norm(eta, axis=1) <= self.b).all())
        return near and all(V(way) <= self.level for way in path)

    def place(self, limit: LimitedBy) -> list[float]:
        """No limit of a region in the coordinates (c, ξ) is a place."""
        return []


def numbers(v: Vector) -> tuple[float, ...]:
    """A vector as data."""
    return tuple(map(float, v))


def rows(A: Vector) -> Rows:
    """A matrix as data, row by row."""
    return tuple(numbers(row) for row in A)


_KINDS: dict[str, type[GridRegion] | type[EllipsoidRegion] | type[ChartRegion]] = {
    "grid": GridRegion,
    "ellipsoid": EllipsoidRegion,
    "chart": ChartRegion,
}


def read_region(data: Mapping[str, Any]) -> RegionClaim:
    """A region from its entry of certificate.json.

    Raises
    ------
    KeyError, ValueError
        When an entry is missing or has another type.
    """
    if data["method"] not in _KINDS:
        raise ValueError(f"no region of the method {data['method']!r:.20}")
    return read_as(_KINDS[data["method"]], data)
