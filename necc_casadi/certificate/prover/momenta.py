"""What the structure of the model says about V before any number is computed.

Momenta that enter H as ½ sᵀA(y)s, and no Casimir, can be minimised out: with y the other states,
V(y, s) ≥ V(y, 0) + ½ δ sᵀA(y)s where Φ₁ ≥ δ, so critical points have s = 0 and the region needs a
search over y alone.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import sympy as sp

from necc_casadi.arrays import Vector
from necc_casadi.certificate.prover.arithmetic.boxes import matrix_enclosure, subdivide
from necc_casadi.certificate.prover.arithmetic.definite import positive_definite
from necc_casadi.certificate.prover.arithmetic.intervals import Interval
from necc_casadi.designs.design import Design
from necc_casadi.model.domain import Domain

__all__ = ["momentum_ceiling", "stiffness"]


#: Shares of the stiffness at the middles of the boxes that are tried, in this order.
_SHARES = (0.999999, 0.99, 0.95, 0.9, 0.8, 0.6, 0.4, 0.2)


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
