"""The global claim: V is radially unbounded, with one critical point in a box that holds them all.

All solutions are then bounded, and LaSalle's principle takes them to the largest invariant set
where V̇ = 0.
"""

from __future__ import annotations

import sympy as sp

from necc_casadi.certificate.checker.arithmetic.balls import Box
from necc_casadi.certificate.checker.arithmetic.potential import Energy
from necc_casadi.certificate.checker.arithmetic.smooth import is_smooth_everywhere
from necc_casadi.certificate.checker.evidence import Checked, Evidence, Obligation
from necc_casadi.certificate.checker.momenta import are_momenta
from necc_casadi.certificate.checker.region.floor import FloorProof
from necc_casadi.certificate.checker.region.reduced import Reduced
from necc_casadi.certificate.checker.region.shape import check_split_shape
from necc_casadi.certificate.checker.region.whole import (
    critical_box,
    is_unique,
    repeats_positively,
)
from necc_casadi.certificate.checker.solutions import what_follows
from necc_casadi.certificate.claims import statements
from necc_casadi.certificate.claims.motions import Solutions
from necc_casadi.certificate.claims.regions import GlobalClaim

__all__ = ["check_global"]


def check_global(evidence: Evidence, sound: bool) -> Checked:
    """V has one critical point and is radially unbounded, and what follows for all solutions."""
    if not evidence.claimed("global"):
        return Checked("global", False, "no global claim is held")
    claim = GlobalClaim.read(evidence.claims["global"].data)
    check_split_shape(claim, len(evidence.model.z))
    proof, solutions = _WholeSpace(evidence, claim), Solutions(claim.follows, claim.motion)
    stable = ("z̄ is stable", lambda: sound)
    return Checked.by(
        "global",
        statements.GLOBAL[claim.follows],
        [stable, *proof.obligations(), what_follows(evidence, solutions, proof.resting, None)],
    )


class _WholeSpace:
    """What has to be proved of the whole space."""

    def __init__(self, evidence: Evidence, claim: GlobalClaim) -> None:
        self.evidence, self.claim, self.model = evidence, claim, evidence.model
        self.energy: Energy = evidence.reduced(claim.active)
        self.resting = [i for i in range(len(self.model.z)) if i not in claim.active]

    def obligations(self) -> list[Obligation]:
        """One critical point, all solutions bounded."""
        model, form = self.model, self.model.form
        return [
            ("the loop is of constant structure", lambda: not self._varying()),
            (
                "everything is smooth for all states",
                lambda: is_smooth_everywhere(model.written, model.z),
            ),
            ("Φ is the sum H + Hc + K(c)", lambda: form["phi"] is None and not form["betas"]),
            ("the resting states are momenta", lambda: are_momenta(model, self.resting)),
            ("∂²H/∂p² ≻ 0 for all states", self._has_inertia),
            ("V is radially unbounded with one critical point", self._is_unique),
        ]

    def _varying(self) -> set[sp.Symbol]:
        free: set[sp.Symbol] = (self.model.Jcl - self.model.Rcl).free_symbols
        return free

    def _has_inertia(self) -> bool:
        momenta = [self.model.z[i] for i in self.resting]
        return not momenta or repeats_positively(sp.hessian(self.model.H, momenta))

    def _is_unique(self) -> bool:
        """One critical point of w in the part of s of a box that holds all those of V."""
        claim, box = self.claim, critical_box(self.energy)
        if box is None:
            return False
        s: Box = tuple(box[i] for i in claim.kept)
        floor = FloorProof(self.energy, claim.kept, claim.floor, claim.bends)
        if not floor.holds(tuple(_joined(a, b) for a, b in zip(s, claim.core, strict=True))):
            return False
        start = [self.evidence.minimum[i] for i in claim.active]
        reduced = Reduced(self.energy, claim.kept, claim.floor, start)  # F ≻ 0, or it raises
        if not claim.kept:
            return True
        s_bar = [self.evidence.z_bar(claim.active)[i] for i in claim.kept]
        home = all(a < lo and hi < b for (a, b), (lo, hi) in zip(claim.core, s_bar, strict=True))
        return home and is_unique(reduced, s, claim.core)


def _joined(a: tuple[float, float], b: tuple[float, float]) -> tuple[float, float]:
    """The smallest side that holds both."""
    return min(a[0], b[0]), max(a[1], b[1])
