"""The region around z̄, proved again, and what follows for solutions from it.

With V̇ ≤ 0, a compact component of {V ≤ c} is invariant; LaSalle's principle takes its solutions to
the largest invariant set where V̇ = 0, which is z̄ where that set holds critical points only.
"""

from __future__ import annotations

from functools import cached_property, partial

import sympy as sp
from flint import arb

from necc_casadi.certificate.checker.arithmetic.balls import Box, ball
from necc_casadi.certificate.checker.evidence import Checked, Evidence, Obligation
from necc_casadi.certificate.checker.invariant_sets import OverBox, loop_is_defined
from necc_casadi.certificate.checker.region.bounds import BoundProof, stays_positive
from necc_casadi.certificate.checker.region.cells import CellsProof
from necc_casadi.certificate.checker.region.curved import PERIOD, CurvedProof
from necc_casadi.certificate.checker.region.floor import FloorProof
from necc_casadi.certificate.checker.region.obstacle import ObstacleProof
from necc_casadi.certificate.checker.region.poles import BetweenFaces
from necc_casadi.certificate.checker.region.proof import RegionProof
from necc_casadi.certificate.checker.region.reduced import Reduced
from necc_casadi.certificate.checker.region.shape import check_region_shape
from necc_casadi.certificate.claims import statements
from necc_casadi.certificate.claims.curved import CurvedRegion
from necc_casadi.certificate.claims.fields import read_as
from necc_casadi.certificate.claims.motions import Solutions
from necc_casadi.certificate.claims.regions import Region, Side

__all__ = ["check_region", "region_proof"]


def region_proof(evidence: Evidence, region: Region | CurvedRegion) -> RegionProof:
    """The proof that a region asks for.

    Raises
    ------
    ValueError
        When the region is not of its form.
    """
    if region.method == "curved":
        return CurvedRegionProof(evidence, region)
    return ComponentProof(evidence, region)


class ComponentProof(RegionProof):
    """A component over marked cells.

    Raises
    ------
    ValueError
        When the region is not of its form.
    """

    def __init__(self, evidence: Evidence, region: Region) -> None:
        check_region_shape(region, len(evidence.model.z))
        super().__init__(evidence, region.level, region.active)
        self.region = region

    @cached_property
    def cells(self) -> CellsProof:
        """The marked cells, w found from z̄ on."""
        start = [self.evidence.minimum[i] for i in self.region.active]
        region = self.region
        reduced = Reduced(self.energy, region.kept, region.floor, start, region.tube)
        return CellsProof(reduced, region)

    @cached_property
    def _inertia(self) -> sp.Matrix:
        momenta = [self.model.z[i] for i in self.resting]
        return sp.hessian(self.model.H, momenta) if momenta else sp.zeros(0)

    @cached_property
    def _bounds(self) -> BoundProof:
        return BoundProof(self.cells, self._inertia, self.resting)

    @cached_property
    def reach(self) -> tuple[Side, ...]:
        """The claimed sides of all states.

        Raises
        ------
        ValueError
            When a state is said to take every value.
        """
        sides = tuple(side for side in self.claimed_reach if side is not None)
        if len(sides) < len(self.claimed_reach):
            raise ValueError("a state is not bounded on the region")
        return sides

    @property
    def place(self) -> OverBox:
        """The claimed sides."""
        return OverBox(self.model.z, self.reach)

    def boxes(self, level: float) -> list[Box]:
        """Small boxes of the active states that hold {V ≤ c} over the marked cells."""
        return [box for _, box in self.cells.fibres(level)]

    def obligations(self) -> list[Obligation]:
        """What has to be proved of the component itself."""
        region, kept = self.region, self.region.kept
        floor = FloorProof(self.energy, kept, region.floor, region.bends)
        s_bar = tuple(self.z_bar[i] for i in kept)
        return [
            ("V(z̄) < c", lambda: bool(self.bottom < region.level)),
            *self._is_convex(floor),
            ("the cells are apart", lambda: self.cells.are_apart()),
            ("z̄ is over the core, in marked cells", lambda: self.cells.hold_minimum(s_bar)),
            ("∇²w ≻ 0 on the core", lambda: self.cells.core_is_convex()),
            ("∇w ≠ 0 on the other cells", lambda: self.cells.cells_are_settled()),
            ("w > c around the marked cells", lambda: self.cells.faces_are_above()),
            ("∂²H/∂p² ≻ 0 over the cells", self._has_inertia),
            *self._bounds_are_kept(),
            (
                "every state is within its reach",
                lambda: self._bounds.reach(dict(enumerate(self.reach))),
            ),
            ("everything is smooth there", lambda: loop_is_defined(self.model, self.reach)),
        ]

    def _is_convex(self, floor: FloorProof) -> list[Obligation]:
        """V_ee ⪰ F for every e; or in the tube, on whose sides V > c, with z̄ inside."""
        whole, tube = self.region.box.whole, self.region.tube
        if not tube:
            return [("V_ee ⪰ F for every e", lambda: floor.holds(whole))]
        e = [i for i in range(self.energy.d) if i not in self.region.kept]
        at = [ball(*self.z_bar[i]) for i in e]
        return [
            ("V_ee ⪰ F in the tube", lambda: floor.holds_on(whole, tube)),
            ("z̄ is in the tube", lambda: self.cells.reduced.within_tube(at)),
            (
                "V > c on the sides of the tube",
                lambda: all(
                    self._bounds.state_stays(i, end)
                    for i, side in zip(e, tube, strict=True)
                    for end in side
                ),
            ),
        ]

    def _has_inertia(self) -> bool:
        boxes = self.boxes(self.region.level)
        return not self.resting or stays_positive(self._inertia, self.energy.variables, boxes)

    def _bounds_are_kept(self) -> list[Obligation]:
        """One for every bound that the model names."""
        result: list[Obligation] = []
        for i, name in enumerate(self.model.states):
            if name in self.model.domain:
                result.append((f"{name} keeps its bounds", partial(self._is_kept, i)))
        return result

    def _is_kept(self, i: int) -> bool:
        active, (lo, hi) = self.region.active, self.model.named_bounds[i]
        if i in self.resting:
            reach = min(-lo, hi)
            return reach > 0 and self._bounds.momentum_stays(i, arb(reach))
        position = active.index(i)
        at = self.z_bar[position]
        if not (lo < at[0] and at[1] < hi):
            return False
        if position in self.region.kept:
            a, b = self.region.box.whole[self.region.kept.index(position)]
            return lo <= a and b <= hi
        if self.region.tube:
            e = [k for k in range(self.energy.d) if k not in self.region.kept]
            least, most = self.region.tube[e.index(position)]
            return lo <= least and most <= hi
        return all(self._bounds.state_stays(position, end) for end in (lo, hi))


class CurvedRegionProof(RegionProof):
    """A component that curved Casimirs shape.

    Raises
    ------
    ValueError
        When the region is not of its form.
    """

    def __init__(self, evidence: Evidence, region: CurvedRegion) -> None:
        super().__init__(evidence, region.level, region.active)
        self.proof = CurvedProof(self.energy, region, self.z_bar)

    def obligations(self) -> list[Obligation]:
        """What has to be proved of Ω itself."""
        return [
            *self.proof.obligations(),
            ("every state is within its reach", lambda: self.proof.reaches(self.claimed_reach)),
        ]

    @property
    def place(self) -> OverBox:
        """The claimed sides, q strictly between its faces, a period of each angle."""
        sides = [PERIOD if side is None else side for side in self.claimed_reach]
        return BetweenFaces(self.model.z, tuple(sides), self.proof.surroundings)

    def boxes(self, level: float) -> list[Box]:
        """One box, with a period of each angle.

        Raises
        ------
        ValueError
            When the ports do not repeat with the angles, so that it says nothing of u.
        """
        if not self.proof.ports_repeat():
            raise ValueError("the ports do not repeat in a state that may take every value")
        return [self.proof.hull()]

    def follows(self, claimed: Solutions) -> Obligation:
        """What is claimed of solutions; rules for motions need ranges, which angles lack."""
        what, proved = super().follows(claimed)
        return what, lambda: not claimed.motion and proved()


def check_region(evidence: Evidence, proof: RegionProof | None, sound: bool) -> Checked:
    """The component of {V ≤ c} around z̄ is compact, and only z̄ is critical in it."""
    certificate = evidence.certificate
    height, obstacle = certificate.level_above_minimum, certificate.obstacle
    claimed = evidence.claimed("region") and height is not None and obstacle is not None
    if proof is None or height is None or obstacle is None or not (claimed and sound):
        missing = "the stability of z̄" if claimed else "that one is claimed"
        return Checked("region", False, f"no region is proved, for want of {missing}")
    solutions = read_as(Solutions, evidence.claims["region"].data)
    energy = evidence.model.units.energy
    told = ObstacleProof(evidence, proof.level, proof.active, obstacle, proof.claimed_reach)
    return Checked.by(
        "region",
        statements.region(height, obstacle, solutions.follows),
        [
            ("the resting states are momenta", proof.rests),
            (
                "the level is that of the region",
                lambda: proof.level * energy == certificate.level,
            ),
            (
                "the level is as high above V(z̄)",
                lambda: height > 0 and bool(proof.bottom + height / energy <= proof.level),
            ),
            *proof.obligations(),
            *told.obligations(proof.bottom),
            proof.follows(solutions),
        ],
    )
