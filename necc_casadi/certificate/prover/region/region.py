"""The region certificate: the component Ω of {V ≤ c} around z̄ lies in the domain, and what follows.

With y the states that are not momenta of :func:`find_momenta`, Ω is over the component of
{V(y, 0) ≤ c}; there the momenta satisfy ½ δ tᵢ sᵢ² ≤ c − V(z̄), which keeps them in the domain.
"""

from __future__ import annotations

import base64
import math
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from necc_casadi.arrays import Truth
from necc_casadi.certificate.claims.regions import (
    ChartRegion,
    EllipsoidRegion,
    Grid,
    GridRegion,
    LimitedBy,
    Region,
)
from necc_casadi.certificate.claims.statements import limited_by
from necc_casadi.certificate.prover.arithmetic.intervals import Interval
from necc_casadi.certificate.prover.arithmetic.potential import Potential
from necc_casadi.certificate.prover.equilibrium import Equilibrium
from necc_casadi.certificate.prover.invariant_sets import loop_is_defined
from necc_casadi.certificate.prover.momenta import momentum_ceiling
from necc_casadi.certificate.prover.region.chart import widest_chart
from necc_casadi.certificate.prover.region.ellipsoid import widest_ellipsoid
from necc_casadi.certificate.prover.region.grid import Flood, boxes_of
from necc_casadi.certificate.prover.region.grid_search import GRID_CELLS, widest_grid
from necc_casadi.certificate.prover.region.shells import half_axes
from necc_casadi.certificate.prover.region.sizes import ellipsoid_sizes, grid_sizes
from necc_casadi.designs.design import Design
from necc_casadi.model.domain import Domain

__all__ = ["RegionProof", "prove_region", "surroundings"]


#: A cell that stops a flood is this near to the region; the checker looks as far.
_BESIDE = 3


@dataclass(frozen=True, eq=False)
class RegionProof:
    """A region, what limits it, and what it covers; `region` is None where nothing is proved."""

    region: Region | None
    limit: LimitedBy | None  # None where nothing that could be named stopped the search
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
    domain, y = design.domain, list(region.active)
    lo, hi = domain.lo.copy(), domain.hi.copy()
    if isinstance(region, GridRegion):
        boxes = boxes_of(region.grid, np.flatnonzero(region.mask.ravel()))
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


def prove_region(potential: Potential, equilibrium: Equilibrium) -> RegionProof:
    """The largest level that can be proved in the model's domain."""
    design = potential.design
    resting = design.momenta
    reduced = Potential(design, resting)
    domain = design.domain
    z_bar = equilibrium.box[list(reduced.active)]
    bottom = reduced.jet(z_bar[None, :]).value
    ceiling, state = momentum_ceiling(design, resting, domain, float(bottom.lo[0]))
    if not ceiling > bottom.hi[0]:
        return RegionProof(None, LimitedBy("momentum", (state,)), {})
    limit = (ceiling, LimitedBy("momentum", (state,)))
    inner = domain.of(reduced.active)
    proof = None
    if len(reduced.active) in GRID_CELLS:
        proof = _on_grid(reduced, inner, z_bar, limit)
    if proof is None:
        proof = _in_chart(reduced, inner, z_bar, limit)
    if proof is None:
        proof = _in_ellipsoid(reduced, inner, z_bar, limit)
    if proof is None or proof.region is None:
        return RegionProof(None, None, {})
    defined = loop_is_defined(design, surroundings(design, proof.region))
    return proof if defined else RegionProof(None, LimitedBy("undefined"), {})


def _on_grid(
    potential: Potential, domain: Domain, z_bar: Interval, limit: tuple[float, LimitedBy]
) -> RegionProof | None:
    """The region on a grid; None where none is fine enough for the surroundings of z̄."""
    found = widest_grid(potential, Interval(domain.lo, domain.hi), z_bar, limit[0])
    if found is None:
        return None
    cells, grid = found.flood, found.grid
    at = tuple(int(k) for k in np.unravel_index(cells.limiting, grid.shape))
    stopped = limit[1] if found.level >= limit[0] else LimitedBy("method")
    if stopped.kind == "method" and _touches(found.mask, at):
        stopped = LimitedBy(_kind(grid, cells, domain), at)
    region = GridRegion(
        found.level, potential.active, grid.first, grid.shape, grid.step, cells.core,
        _packed(found.mask),
    )  # fmt: skip
    box = Interval(domain.lo, domain.hi)
    return RegionProof(region, stopped, grid_sizes(potential, found, box, z_bar))


def _touches(mask: Truth, cell: tuple[int, ...]) -> bool:
    """Whether a cell is marked or near one that is."""
    around = tuple(slice(max(0, k - _BESIDE), k + _BESIDE + 1) for k in cell)
    return bool(mask[around].any())


def _in_chart(
    potential: Potential, domain: Domain, z_bar: Interval, limit: tuple[float, LimitedBy]
) -> RegionProof | None:
    """The region in the coordinates (c, ξ), with a lower bound of its volume and half-widths."""
    center = z_bar.mid
    center[-potential.design.loop.controller.nc :] = potential.design.xi_star
    found = widest_chart(potential, center, domain.lo, domain.hi, limit[0])
    if found is None or not found[0].level > potential.jet(z_bar[None, :]).value.hi[0]:
        return None
    region, sizes = found
    stopped = limit[1] if region.level >= (1 - 1e-4) * limit[0] else LimitedBy("method")
    return RegionProof(region, stopped, sizes)


def _in_ellipsoid(
    potential: Potential, domain: Domain, z_bar: Interval, limit: tuple[float, LimitedBy]
) -> RegionProof | None:
    """The region in an ellipsoid around z̄, with a lower bound of its volume and half-widths."""
    with np.errstate(all="ignore"):
        core = widest_ellipsoid(potential, z_bar.mid, domain.lo, domain.hi)
    if core is None:
        return None
    level, stopped = min(limit, (core.level, LimitedBy("method")))
    height = level - float(potential.jet(z_bar[None, :]).value.hi[0])
    if not height > 0:
        return None
    region = EllipsoidRegion(
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
    return RegionProof(region, stopped, ellipsoid_sizes(potential, core.L, radius, box, z_bar))


def _kind(grid: Grid, found: Flood, domain: Domain) -> str:
    """What stops the level of a flood: the domain, a smaller grid's end, or a critical point."""
    if not found.at_boundary:
        return "critical"
    box = boxes_of(grid, np.array([found.limiting]))[0]
    step = np.array(grid.step)
    outside = (box.lo - step < domain.lo) | (box.hi + step > domain.hi)
    return "border" if outside.any() else "cells"


def _packed(mask: Truth) -> str:
    return base64.b64encode(zlib.compress(np.packbits(mask.ravel()).tobytes(), 9)).decode()
