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
from necc_casadi.certificate.grid import Flood, Grid, flood, make_grid
from necc_casadi.certificate.intervals import Interval
from necc_casadi.certificate.statements import Limit, limited_by
from necc_casadi.certificate.structure import quadratic_states, stiffness
from necc_casadi.networks import Vector

__all__ = ["CoreRegion", "Domain", "GridRegion", "Proof", "Region", "domain_of", "prove_region"]

#: Cells of the grid, by dimension; more dimensions are the business of the convex core.
_CELLS = {1: 4096, 2: 128**2, 3: 40**3}

#: Share of the height of a level on the grid that is given up, so that other arithmetic, which
#: rounds otherwise and halves faces a few times only, can confirm it.
_EASED = 1e-6


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
        if isinstance(region, GridRegion) and self.limit.kind in ("border", "critical"):
            place = self.limit.place(region.first, region.step)
            return limited_by(self.limit, region.method, states, region.active, place)
        return limited_by(self.limit, "" if region is None else region.method, states)


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
    if len(reduced.active) in _CELLS:
        proof = _on_grid(reduced, inner, z_bar, limit)
    if proof is None:
        proof = _in_chart(reduced, inner, z_bar, limit)
    if proof is None:
        proof = _in_ellipsoid(reduced, inner, z_bar, limit)
    return proof or Proof(None, None, {})


def _on_grid(
    potential: Potential, domain: Domain, z_bar: Interval, limit: tuple[float, Limit]
) -> Proof | None:
    """The region on a grid; None where the grid is too coarse for the surroundings of z̄."""
    grid = make_grid(domain.lo, domain.hi, _CELLS[len(potential.active)])
    found = flood(potential, grid, z_bar)
    bottom = float(potential.jet(z_bar[None, :]).value.hi[0])
    if found is None or not found.level > bottom:
        return None
    eased = bottom + (1 - _EASED) * (found.level - bottom)
    level, stopped = min(limit, (eased, Limit("method")))
    mask: Truth = np.asarray(found.levels <= level)
    cell = tuple(int(k) for k in np.unravel_index(found.limiting, grid.shape))
    if stopped.kind == "method" and _touches(mask, cell):
        stopped = Limit("border" if found.at_boundary else "critical", cell)
    region = GridRegion(
        level, potential.active, grid.first, grid.shape, grid.step, found.core, _packed(mask)
    )
    return Proof(region, stopped, _shares(potential.design, region, found, mask, domain))


def _touches(mask: Truth, cell: tuple[int, ...]) -> bool:
    """Whether a cell or one that shares a face with it is marked."""
    unit = np.eye(len(cell), dtype=int)
    near = np.array(cell) + np.concatenate([0 * unit[:1], unit, -unit])
    near = near[((near >= 0) & (near < mask.shape)).all(1)]
    return bool(mask[tuple(near.T)].any())


def _in_chart(
    potential: Potential, domain: Domain, z_bar: Interval, limit: tuple[float, Limit]
) -> Proof | None:
    """The region in the coordinates (c, ξ), with a lower bound of its volume and half-widths."""
    region = widest_chart(potential, z_bar.mid, domain.lo, domain.hi, limit[0])
    if region is None or not region.level > potential.jet(z_bar[None, :]).value.hi[0]:
        return None
    stopped = limit[1] if region.level >= limit[0] else Limit("method")
    B, d, states = np.array(region.basis), len(region.active), potential.design.loop.states
    ball = math.pi ** (d / 2) / math.gamma(d / 2 + 1) * region.inner**d
    half = 0.999 * region.inner * np.sqrt((B**2).sum(1))
    shares = {"domain_share": 0.999 * ball * abs(float(np.linalg.det(B))) / domain.volume}
    reach = zip(region.active, half, strict=True)
    shares |= {f"reach_{states[i]}": float(v) for i, v in reach}
    return Proof(region, stopped, shares)


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
    return Proof(region, stopped, _ellipsoid_shares(potential, region, height, domain))


def _ellipsoid_shares(
    potential: Potential, region: CoreRegion, height: float, domain: Domain
) -> dict[str, float]:
    """What the ellipsoid ½ above |e|² ≤ 0.999 height, part of Ω, covers."""
    L, d = np.array(region.L), len(region.active)
    radius = min(math.sqrt(2 * 0.999 * height / region.above), region.radii[-1])
    ball = math.pi ** (d / 2) / math.gamma(d / 2 + 1) * radius**d
    half = 0.999 * half_axes(L, radius)
    states = [potential.design.loop.states[i] for i in potential.active]
    shares = {"domain_share": 0.999 * ball / float(np.prod(np.diagonal(L))) / domain.volume}
    return shares | {f"reach_{s}": float(v) for s, v in zip(states, half, strict=True)}


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


def _packed(mask: Truth) -> str:
    return base64.b64encode(zlib.compress(np.packbits(mask.ravel()).tobytes(), 9)).decode()


def _shares(
    design: Design, region: GridRegion, found: Flood, mask: Truth, domain: Domain
) -> dict[str, float]:
    """Lower bounds of shares of the domain, momenta at rest: of all states, and of the plant's."""
    inside = mask & (found.upper <= region.level)
    cell = float(np.prod(region.step))
    plant = [k for k, i in enumerate(region.active) if i < design.loop.plant.n]
    controller = tuple(k for k in range(len(region.active)) if k not in plant)
    side = float(np.prod([region.step[k] for k in plant]))
    seen = inside.any(axis=controller)
    return {
        "domain_share": float(inside.sum()) * cell / domain.volume,
        "plant_share": float(seen.sum()) * side / domain.of(plant).volume,
    }
