"""Where responses that are measured start, and how long they last."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from necc_casadi.arrays import Vector
from necc_casadi.designs.design import Design
from necc_casadi.simulation.responses import slowest_decay

__all__ = ["decay_time", "random_starts", "settled_in"]


#: The slowest mode has this many time constants to settle.
_CONSTANTS = 10.0


def random_starts(design: Design, count: int, seed: int) -> list[Vector]:
    """Plant states drawn uniformly from the domain, (n,) each, in the units of the model."""
    n, rng = design.loop.plant.n, np.random.default_rng(seed)
    lo, hi = design.domain.lo[:n], design.domain.hi[:n]
    return list(rng.uniform(lo, hi, (count, n)))


def decay_time(design: Design) -> float:
    """Long enough for the slowest mode of a design, in natural time."""
    return settled_in(design.spectrum * design.units.time)


def settled_in(spectrum: npt.NDArray[np.complex128] | Vector) -> float:
    """Long enough for the slowest of these modes."""
    pace = slowest_decay(spectrum)
    return _CONSTANTS / pace if pace else _CONSTANTS
