"""The region certificate: the component Ω of {V ≤ c} around z̄ lies in the domain, and what follows.

With y the states that are not momenta of :func:`quadratic_states`, Ω is over the component of
{V(y, 0) ≤ c}; there the momenta satisfy ½ δ tᵢ sᵢ² ≤ c − V(z̄), which keeps them in the domain.
"""

from __future__ import annotations

import base64
import math
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from necc_casadi.artifact import Design
from necc_casadi.certificate.chart import ChartRegion, widest_chart
from necc_casadi.certificate.core import half_axes, widest_core
from necc_casadi.certificate.definite import Truth
from necc_casadi.certificate.enclosures import Potential
from necc_casadi.certificate.equilibrium import Equilibrium
from necc_casadi.certificate.grid import Flood, Grid
from necc_casadi.certificate.intervals import Interval
from necc_casadi.certificate.motion import loop_is_defined
from necc_casadi.certificate.search import GRID_CELLS, widest_grid
from necc_casadi.certificate.sizes import ellipsoid_sizes, grid_sizes
from necc_casadi.certificate.statements import Limit, limited_by
from necc_casadi.certificate.structure import quadratic_states, stiffness
from necc_casadi.networks import Vector

__all__ = [
    "CoreRegion",
    "Domain",
    "GridRegion",
    "Proof",
    "Region",
    "domain_of",
    "prove_region",
    "surroundings",
]


#: A cell that stops a flood is this near to the region; the checker looks as far.
_BESIDE = 3


@dataclass(frozen=True, eq=False)
class Domain:
    """The box of interest."""

    lo: Vector  # (N,)
    hi: Vector  # (N,)

    def of(self, states: Sequence[int]) -> Domain:
        """The box of some of the states."""
        chosen = list(states)
        return Domain(self.lo[chosen], self.hi[chosen])

    @property
    def volume(self) -> float:
        """Product of the sides."""
        return float(np.prod(self.hi - self.lo))


def domain_of(design: Design) -> Domain:
    """The model's domain; where it names no bounds, target ± 2 and ξ* ± 2."""
    named = {str(name): bounds for name, bounds in design.loop.plant.domain.items()}
    pairs = [
        tuple(float(b) for b in named[state]) if state in named else (z - 2.0, z + 2.0)
        for state, z in zip(design.loop.states, design.z_star, strict=True)
    ]
    lo, hi = np.array(pairs, dtype=float).T
    return Domain(lo, hi)


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

    def contains(self, design: Design, z: Sequence[float]) -> bool:
        """Whether z is in Ω, by plain evaluation of V."""
        y = np.asarray(z, float)[list(self.active)]
        cells = self.grid.locate(Interval(y, y))
        return bool(cells.size and self.mask.ravel()[cells[0]] and design.V(z) <= self.level)


@dataclass(frozen=True)
class CoreRegion:
    """Ω as a level and the ellipsoid that holds the component of {V(y, 0) ≤ c}; see Core."""

    level: float  # c
    active: tuple[int, ...]  # the states y
    center: tuple[float, ...]  # ȳ
    L: tuple[tuple[float, ...], ...]
    radii: tuple[float, ...]
    nu: tuple[float, ...]
    step: tuple[float, ...]
    above: float  # ∇²V ⪯ above·LLᵀ on the ellipsoid
    method: str = "core"

    def contains(self, design: Design, z: Sequence[float]) -> bool:
        """Whether z is in Ω, by plain evaluation of V."""
        e = np.asarray(z, float)[list(self.active)] - np.array(self.center)
        inside = np.linalg.norm(np.array(self.L).T @ e) <= self.radii[-1]
        return bool(inside and design.V(z) <= self.level)


Region = GridRegion | CoreRegion | ChartRegion


@dataclass(frozen=True, eq=False)
class Proof:
    """A region, what limits it, and what it covers; `region` is None where nothing is proved."""

    region: Region | None
    limit: Limit | None  # None where nothing that could be named stopped the search
    shares: Mapping[str, float]

    def limited_by(self, states: Sequence[str]) -> str:
        """What limits the region, in words."""
        if self.limit is None:
            return "no neighbourhood of z̄ is proved free of other critical points"
        region = self.region
        if isinstance(region, GridRegion) and self.limit.names_a_cell:
            place = self.limit.place(region.first, region.step)
            return limited_by(self.limit, region.method, states, region.active, place)
        return limited_by(self.limit, "" if region is None else region.method, states)


def surroundings(design: Design, region: Region) -> Interval:
    """A box of all states (N,) that holds Ω: the momenta are in the domain."""
    domain, y = domain_of(design), list(region.active)
    lo, hi = domain.lo.copy(), domain.hi.copy()
    if isinstance(region, GridRegion):
        boxes = region.grid.boxes(np.flatnonzero(region.mask.ravel()))
        lo[y], hi[y] = boxes.lo.min(0), boxes.hi.max(0)
        return Interval(lo, hi)
    center = np.array(region.center)
    if isinstance(region, ChartRegion):  # q is somewhere in the domain
        r = len(region.middle)
        y, center = y[r:], center[r:]
        half = half_axes(np.array(region.scale_h).T, region.b)
    else:
        half = half_axes(np.array(region.L), region.radii[-1])
    lo[y], hi[y] = np.nextafter(center - half, -np.inf), np.nextafter(center + half, np.inf)
    return Interval(lo, hi)


def prove_region(potential: Potential, equilibrium: Equilibrium) -> Proof:
    """The largest level that can be proved in the model's domain."""
    design = potential.design
    resting = quadratic_states(design)
    reduced = Potential(design, resting)
    domain = domain_of(design)
    z_bar = equilibrium.box[list(reduced.active)]
    bottom = reduced.jet(z_bar[None, :]).value
    ceiling, state = momentum_ceiling(design, resting, domain, float(bottom.lo[0]))
    if not ceiling > bottom.hi[0]:
        return Proof(None, Limit("momentum", (state,)), {})
    limit = (ceiling, Limit("momentum", (state,)))
    inner = domain.of(reduced.active)
    proof = None
    if len(reduced.active) in GRID_CELLS:
        proof = _on_grid(reduced, inner, z_bar, limit)
    if proof is None:
        proof = _in_chart(reduced, inner, z_bar, limit)
    if proof is None:
        proof = _in_ellipsoid(reduced, inner, z_bar, limit)
    if proof is None or proof.region is None:
        return Proof(None, None, {})
    defined = loop_is_defined(design, surroundings(design, proof.region))
    return proof if defined else Proof(None, Limit("undefined"), {})


def _on_grid(
    potential: Potential, domain: Domain, z_bar: Interval, limit: tuple[float, Limit]
) -> Proof | None:
    """The region on a grid; None where none is fine enough for the surroundings of z̄."""
    found = widest_grid(potential, Interval(domain.lo, domain.hi), z_bar, limit[0])
    if found is None:
        return None
    cells, grid = found.flood, found.grid
    at = tuple(int(k) for k in np.unravel_index(cells.limiting, grid.shape))
    stopped = limit[1] if found.level >= limit[0] else Limit("method")
    if stopped.kind == "method" and _touches(found.mask, at):
        stopped = Limit(_kind(grid, cells, domain), at)
    region = GridRegion(
        found.level, potential.active, grid.first, grid.shape, grid.step, cells.core,
        _packed(found.mask),
    )  # fmt: skip
    box = Interval(domain.lo, domain.hi)
    return Proof(region, stopped, grid_sizes(potential, found, box, z_bar))


def _touches(mask: Truth, cell: tuple[int, ...]) -> bool:
    """Whether a cell is marked or near one that is."""
    around = tuple(slice(max(0, k - _BESIDE), k + _BESIDE + 1) for k in cell)
    return bool(mask[around].any())


def _in_chart(
    potential: Potential, domain: Domain, z_bar: Interval, limit: tuple[float, Limit]
) -> Proof | None:
    """The region in the coordinates (c, ξ), with a lower bound of its volume and half-widths."""
    center = z_bar.mid
    center[-potential.design.loop.controller.nc :] = potential.design.xi_star
    found = widest_chart(potential, center, domain.lo, domain.hi, limit[0])
    if found is None or not found[0].level > potential.jet(z_bar[None, :]).value.hi[0]:
        return None
    region, sizes = found
    stopped = limit[1] if region.level >= (1 - 1e-4) * limit[0] else Limit("method")
    return Proof(region, stopped, sizes)


def _in_ellipsoid(
    potential: Potential, domain: Domain, z_bar: Interval, limit: tuple[float, Limit]
) -> Proof | None:
    """The region in an ellipsoid around z̄, with a lower bound of its volume and half-widths."""
    with np.errstate(all="ignore"):
        core = widest_core(potential, z_bar.mid, domain.lo, domain.hi)
    if core is None:
        return None
    level, stopped = min(limit, (core.level, Limit("method")))
    height = level - float(potential.jet(z_bar[None, :]).value.hi[0])
    if not height > 0:
        return None
    region = CoreRegion(
        level,
        potential.active,
        tuple(map(float, core.center)),
        tuple(tuple(map(float, row)) for row in core.L),
        tuple(map(float, core.radii)),
        tuple(map(float, core.nu)),
        tuple(map(float, core.step)),
        core.above,
    )
    # ½ above |e|² ≤ 0.999 height is part of Ω
    radius = min(math.sqrt(2 * 0.999 * height / core.above), core.radius)
    box = Interval(domain.lo, domain.hi)
    return Proof(region, stopped, ellipsoid_sizes(potential, core.L, radius, box, z_bar))


def momentum_ceiling(
    design: Design, resting: Sequence[int], domain: Domain, bottom: float
) -> tuple[float, int]:
    """Level below which the momenta stay in the domain, and the momentum that binds."""
    if not resting:
        return np.inf, -1
    active = [i for i in range(design.loop.n) if i not in resting]
    y, s = domain.of(active), domain.of(resting)
    reach = np.minimum(-s.lo, s.hi)
    t = stiffness(design, resting, Interval(y.lo, y.hi))
    if t is None or (reach <= 0).any():
        return -np.inf, resting[int(np.argmin(reach))]
    delta = 1.0 if design.form.phi is None else float(design.form.phi.delta)
    ceilings = bottom + 0.5 * delta * t * reach**2 * (1 - 1e-12)
    tightest = int(np.argmin(ceilings))
    return float(np.nextafter(ceilings[tightest], -np.inf)), resting[tightest]


def _kind(grid: Grid, found: Flood, domain: Domain) -> str:
    """What stops the level of a flood: the domain, a smaller grid's end, or a critical point."""
    if not found.at_boundary:
        return "critical"
    box = grid.boxes(np.array([found.limiting]))[0]
    step = np.array(grid.step)
    outside = (box.lo - step < domain.lo) | (box.hi + step > domain.hi)
    return "border" if outside.any() else "cells"


def _packed(mask: Truth) -> str:
    return base64.b64encode(zlib.compress(np.packbits(mask.ravel()).tobytes(), 9)).decode()
