"""Which states are momenta: they enter H as a quadratic form, and no Casimir."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import sympy as sp

from necc_casadi.casimirs.casimirs import Casimirs
from necc_casadi.model.closed_loop import ClosedLoop
from necc_casadi.symbolic.zero import is_zero

__all__ = ["find_momenta"]


def find_momenta(
    loop: ClosedLoop, casimirs: Casimirs, x_star: Sequence[sp.Expr]
) -> tuple[int, ...]:
    """Indices of plant states s with H = ½ sᵀA(y)s + U(y), target 0, that no Casimir contains."""
    plant = loop.plant
    used = set().union(*(c.free_symbols for c in casimirs.functions))
    resting = [
        s for s, target in zip(plant.x, x_star, strict=True) if s not in used and target == 0
    ]
    while resting:
        # simplifying is slow, and multiple angles of rational ratio make it explode
        A = [sp.simplify(e) if e.has(*resting) else e for e in sp.hessian(plant.H, resting)]
        faults = [sum(entry.has(s) for entry in A) for s in resting]
        if not any(faults):
            at_rest = dict.fromkeys(resting, 0)
            faults = [not is_zero(sp.diff(plant.H, s).subs(at_rest)) for s in resting]
        if not any(faults):
            break
        resting.pop(int(np.argmax(faults)))  # the others are judged again without it
    return tuple(plant.x.index(s) for s in resting)
