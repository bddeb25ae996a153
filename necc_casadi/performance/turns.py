"""Angles that come back to themselves."""

from __future__ import annotations

import numpy as np
import sympy as sp

from necc_casadi.arrays import Vector
from necc_casadi.certificate.prover.region.critical_box import is_periodic
from necc_casadi.designs.design import Design

__all__ = ["turns_of"]


def turns_of(design: Design) -> Vector:
    """A turn of each state in natural units, (n + nc,); 0 where turning it is another state.

    An angle comes back to itself where the loop has its period and no Casimir counts its turns.
    """
    loop, seen = design.loop, set().union(*(c.free_symbols for c in design.casimirs.functions))
    entries = [sp.sympify(e) for e in (loop.plant.H, *loop.M, *loop.ports)]
    turns = np.zeros(loop.n)
    for index, symbol in enumerate(loop.plant.x):
        used = [e for e in entries if e.has(symbol)]
        if symbol not in seen and used and is_periodic(used, symbol):
            turns[index] = 2 * np.pi / design.units.state[index]
    return turns
