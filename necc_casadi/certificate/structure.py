"""What the structure of the model says about V before any number is computed.

Momenta that enter H as ½ sᵀA(y)s, and no Casimir, can be minimised out: with y the other states,
V(y, s) ≥ V(y, 0) + ½ δ sᵀA(y)s where Φ₁ ≥ δ, so critical points have s = 0 and the region needs a
search over y alone.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import sympy as sp

from necc_casadi import exact as ex
from necc_casadi.artifact import Design
from necc_casadi.certificate.definite import positive_definite
from necc_casadi.certificate.enclosures import matrix_enclosure
from necc_casadi.certificate.intervals import Interval
from necc_casadi.networks import Vector

#: Shares of the stiffness at the middles of the boxes that are tried, in this order.
_SHARES = (0.999999, 0.99, 0.95, 0.9, 0.8, 0.6, 0.4, 0.2)

__all__ = ["quadratic_states", "stiffness", "subdivide"]


def quadratic_states(design: Design) -> tuple[int, ...]:
    """Indices of plant states s with H = ½ sᵀA(y)s + U(y), target 0, that no Casimir contains."""
    plant = design.loop.plant
    used = set().union(*(c.free_symbols for c in design.casimirs.functions))
    resting = [
        s for s, target in zip(plant.x, design.x_star, strict=True) if s not in used and target == 0
    ]
    while resting:
        A = sp.hessian(plant.H, resting).applyfunc(sp.simplify)
        faults = [sum(entry.has(s) for entry in A) for s in resting]
        if not any(faults):
            at_rest = dict.fromkeys(resting, 0)
            faults = [not ex.is_zero(sp.diff(plant.H, s).subs(at_rest)) for s in resting]
        if not any(faults):
            break
        resting.pop(int(np.argmax(faults)))  # the others are judged again without it
    return tuple(plant.x.index(s) for s in resting)


def stiffness(design: Design, resting: Sequence[int], box: Interval) -> Vector | None:
    """Numbers tᵢ > 0 with A(y) ⪰ tᵢ eᵢeᵢᵀ for every y in a box of the other states, (resting,).

    None where A(y) ≻ 0 is not proved on the box.
    """
    loop = design.loop
    A = sp.hessian(loop.plant.H, [loop.z[i] for i in resting])
    others = [s for i, s in enumerate(loop.z) if i not in resting]
    used = [i for i, s in enumerate(others) if A.has(s)]
    parts = max(4, round(2048 ** (1 / max(1, len(used)))))
    cells = subdivide(box[np.array(used, dtype=int)], min(parts, 256))
    enclosure = matrix_enclosure(A, [others[i] for i in used], cells)
    if not (np.isfinite(enclosure.lo).all() and np.isfinite(enclosure.hi).all()):
        return None
    inverse = np.linalg.pinv(enclosure.mid)
    ideal = 1 / np.diagonal(inverse, axis1=-2, axis2=-1).max(axis=0)
    result = np.zeros(len(resting))
    for share in _SHARES:
        for i in np.flatnonzero(result == 0):
            unit = np.diag(np.eye(len(resting))[i])
            if positive_definite(enclosure - share * ideal[i] * unit).all():
                result[i] = share * ideal[i]
    return result if (result > 0).all() else None


def subdivide(box: Interval, parts: int) -> Interval:
    """A box (d,) cut into parts^d boxes, (parts^d, d)."""
    d = box.shape[0]
    if d == 0:
        empty = np.zeros((1, 0))
        return Interval(empty, empty)
    edges = [np.linspace(box.lo[i], box.hi[i], parts + 1) for i in range(d)]
    lows = np.meshgrid(*[e[:-1] for e in edges], indexing="ij")
    highs = np.meshgrid(*[e[1:] for e in edges], indexing="ij")
    return Interval(
        np.stack([v.ravel() for v in lows], -1), np.stack([v.ravel() for v in highs], -1)
    )
