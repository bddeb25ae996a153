"""Regions as data: what maker and checker both read."""

from __future__ import annotations

import base64
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from necc_casadi.arrays import Truth, Vector

__all__ = [
    "CELL_LIMITS",
    "ChartRegion",
    "EllipsoidRegion",
    "Grid",
    "GridRegion",
    "LimitedBy",
    "Lyapunov",
    "Region",
    "Rows",
]


Rows = tuple[tuple[float, ...], ...]
#: V as a function of all states.
Lyapunov = Callable[[Sequence[float]], float]

#: What stops a flood of cells at one of them.
CELL_LIMITS = frozenset({"border", "cells", "critical"})


@dataclass(frozen=True, eq=False)
class Grid:
    """Cells [kᵢhᵢ, (kᵢ+1)hᵢ] with first ≤ k < first + shape; hᵢ are powers of two, so exact."""

    first: tuple[int, ...]  # (d,)
    shape: tuple[int, ...]  # (d,)
    step: tuple[float, ...]  # (d,)

    @property
    def size(self) -> int:
        """Number of cells."""
        return int(np.prod(self.shape))

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
    core: tuple[tuple[int, ...], tuple[int, ...]]  # block around z̄ with ∇²V ≻ 0
    cells: str  # bits of the component, compressed, base 64
    method: str = "grid"

    @property
    def grid(self) -> Grid:
        """The cells."""
        return Grid(self.first, self.shape, self.step)

    @property
    def mask(self) -> Truth:
        """The cells of the component, in the shape of the grid."""
        bits = np.frombuffer(zlib.decompress(base64.b64decode(self.cells)), dtype=np.uint8)
        count = int(np.prod(self.shape))
        return np.unpackbits(bits, count=count).astype(bool).reshape(self.shape)

    def contains(self, V: Lyapunov, z: Sequence[float]) -> bool:
        """Whether z is in Ω, by plain evaluation of V."""
        cell = self.grid.cell_of(np.asarray(z, float)[list(self.active)])
        return cell is not None and bool(self.mask[cell]) and V(z) <= self.level


@dataclass(frozen=True)
class EllipsoidRegion:
    """Ω as a level and the ellipsoid that holds the component of {V(y, 0) ≤ c}; see Ellipsoid."""

    level: float  # c
    active: tuple[int, ...]  # the states y
    center: tuple[float, ...]  # ȳ
    L: tuple[tuple[float, ...], ...]
    radii: tuple[float, ...]
    nu: tuple[float, ...]
    step: tuple[float, ...]
    above: float  # ∇²V ⪯ above·LLᵀ on the ellipsoid
    method: str = "core"

    def contains(self, V: Lyapunov, z: Sequence[float]) -> bool:
        """Whether z is in Ω, by plain evaluation of V."""
        e = np.asarray(z, float)[list(self.active)] - np.array(self.center)
        inside = np.linalg.norm(np.array(self.L).T @ e) <= self.radii[-1]
        return bool(inside and V(z) <= self.level)


class LimitedBy(NamedTuple):
    """What stopped the search for a larger region."""

    kind: str  # "momentum"; "border", "cells" or "critical" of a grid; "undefined" or "method"
    at: tuple[int, ...] = ()  # index of the momentum in z, or of the cell in the grid

    @property
    def names_a_cell(self) -> bool:
        """Whether `at` is a cell."""
        return self.kind in CELL_LIMITS

    @property
    def data(self) -> dict[str, Any]:
        """The entry of certificate.json."""
        return {"kind": self.kind, "at": list(self.at)}

    @classmethod
    def read(cls, data: Mapping[str, Any]) -> LimitedBy:
        """The inverse of :attr:`data`."""
        return cls(str(data["kind"]), tuple(int(k) for k in data["at"]))

    def place(self, first: Sequence[int], step: Sequence[float]) -> list[float]:
        """Middle of the cell, exact where the steps are powers of two."""
        return [(f + k + 0.5) * h for f, k, h in zip(first, self.at, step, strict=True)]


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
    method: str = "chart"

    def contains(self, V: Lyapunov, z: Sequence[float]) -> bool:
        """Whether V ≤ c on the straight way to z, by plain evaluation; sufficient for z in Ω."""
        end, r = np.asarray(z, float), len(self.middle)
        start = end.copy()
        start[list(self.active)] = self.center
        path = start + np.linspace(0.0, 1.0, 65)[:, None] * (end - start)
        eta = (path[:, list(self.active[r:])] - self.center[r:]) @ np.array(self.scale_h).T
        near = bool((np.linalg.norm(eta, axis=1) <= self.b).all())
        return near and all(V(way) <= self.level for way in path)


Region = GridRegion | EllipsoidRegion | ChartRegion
