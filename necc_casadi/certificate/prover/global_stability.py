"""The global certificate: one critical point in a box that holds them all, V radially unbounded.

All solutions are then bounded and tend to the largest invariant set of E; where that is the
critical points, every solution tends to z̄ (docs/theory.md#the-whole-space).

For Φ = H + Hc + C, linear Casimirs and a plant of constant structure, whose energy is quadratic
and periodic in every state that does not enter it as a square.
"""

from __future__ import annotations

from itertools import islice

import numpy as np
import sympy as sp

from necc_casadi.certificate.claims.regions import GlobalClaim, rows
from necc_casadi.certificate.claims.statements import Missing
from necc_casadi.certificate.prover.arithmetic.boxes import matrix_enclosure
from necc_casadi.certificate.prover.arithmetic.definite import positive_definite
from necc_casadi.certificate.prover.arithmetic.intervals import Interval
from necc_casadi.certificate.prover.arithmetic.potential import Potential
from necc_casadi.certificate.prover.arithmetic.smooth import is_smooth_everywhere, written
from necc_casadi.certificate.prover.region.critical_box import critical_box, is_periodic, periods
from necc_casadi.certificate.prover.region.leaves import Base, prove_unique
from necc_casadi.certificate.prover.region.obstacle import search
from necc_casadi.certificate.prover.region.partial import sides
from necc_casadi.certificate.prover.region.reduced import Reduced
from necc_casadi.certificate.prover.region.split import Splits
from necc_casadi.certificate.prover.solutions import what_follows
from necc_casadi.designs.design import Design

__all__ = ["prove_global_stability"]


#: Ways to split the states that are tried.
_SPLITS = 3


#: Room around the box of the critical points, as a share of its sides.
_ROOM = 0.02


def prove_global_stability(
    potential: Potential, minimum: Interval, attracts: bool
) -> GlobalClaim | Missing:
    """One critical point, V radially unbounded, and what follows; or what is missing.

    `potential` has the momenta at rest; `minimum` (N,) holds z̄.
    """
    design, z_bar = potential.design, minimum[list(potential.active)]
    missing = _beyond_scope(design)
    if missing is not None:
        return missing
    if not _stays_positive(design, potential.resting):
        return "the inertia is not proved positive definite for every state"
    box = critical_box(potential)
    if box is None:
        return "V is not proved to be radially unbounded"
    splits = Splits(potential)
    others: Missing = "V is not proved to have no other critical point"
    for reduced in islice(splits.candidates(box), _SPLITS):
        if _has_others(reduced, box, z_bar):
            return others
        core = _core_of_the_one(reduced, box, z_bar)
        if core is not None:
            found = what_follows(design, attracts, minimum, None)
            return GlobalClaim(
                potential.active, reduced.kept, rows(reduced.floor), splits.bends, sides(core),
                found.follows, found.motion,
            )  # fmt: skip
    return others


def _beyond_scope(design: Design) -> Missing | None:
    """What the structure of the loop lacks for a global claim."""
    loop, form = design.loop, design.form
    if form.phi is not None or form.betas:
        return "only Φ = H + Hc + C with C = K(c) is covered"
    if not is_smooth_everywhere(written(design), loop.z):
        return "energy, structure and Casimirs are not proved to be smooth for all states"
    if loop.M.free_symbols:
        return "J, R or G depend on the state"
    return None


def _stays_positive(design: Design, resting: tuple[int, ...]) -> bool:
    """Whether the inertia of the momenta is ≻ 0 for all states, in each of which it repeats."""
    if not resting:
        return True
    A = sp.hessian(design.loop.plant.H, [design.loop.z[i] for i in resting])
    symbols = sorted(A.free_symbols, key=str)
    if not all(is_periodic([e for e in set(A) if e.has(s)], s) for s in symbols):
        return False
    with np.errstate(all="ignore"):
        return bool(positive_definite(matrix_enclosure(A, symbols, periods(len(symbols)))).all())


def _has_others(reduced: Reduced, box: Interval, z_bar: Interval) -> bool:
    """Whether w seems to have several critical points: a proof would be in vain."""
    s = box[list(reduced.kept)]
    if not reduced.kept:
        return False
    s_bar = z_bar[list(reduced.kept)].mid
    found = search(reduced.landscape, s.lo, s.hi, s_bar)
    far = [(np.abs(p[0] - s_bar) > found.step).any() for p in found.points]
    return any(far)


def _core_of_the_one(reduced: Reduced, box: Interval, z_bar: Interval) -> Interval | None:
    """A box of s around s̄ with ∇²w ≻ 0, where w has no critical point outside of it."""
    kept = list(reduced.kept)
    if not kept:
        return Interval(np.zeros(0), np.zeros(0))
    s = box[kept]
    room = _ROOM * (s.hi - s.lo)
    leaves = prove_unique(reduced, Base.of(s.lo - room, s.hi - s.lo + 2 * room), z_bar[kept])
    return None if leaves is None else leaves.core
