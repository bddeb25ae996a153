"""What follows for solutions from a set in which V never increases (LaSalle's principle)."""

from __future__ import annotations

from necc_casadi.certificate.claims.motions import Solutions
from necc_casadi.certificate.prover.arithmetic.intervals import Interval
from necc_casadi.certificate.prover.invariant_sets import (
    OverBox,
    largest_invariant_set_is_critical,
)
from necc_casadi.certificate.prover.motions import no_motion_without_loss
from necc_casadi.designs.design import Design

__all__ = ["what_follows"]


def what_follows(
    design: Design, attracts: bool, z_bar: Interval, place: OverBox | None
) -> Solutions:
    """Where all solutions go that stay in a compact set whose one critical point of V is z̄.

    Parameters
    ----------
    attracts
        Whether z̄ is locally asymptotically stable.
    z_bar
        Holds z̄, (N,).
    place
        Holds the set; None for the whole space, where every solution is bounded.
    """
    if not attracts:
        return Solutions("stable")
    if largest_invariant_set_is_critical(design, design.momenta, place):
        return Solutions("converges")
    box = None if place is None else place.box
    steps = no_motion_without_loss(design, design.momenta, z_bar, box)
    return Solutions("invariant") if steps is None else Solutions("converges", steps)
