"""What the controller measures in place of the momenta, and for which masses that is enough.

V̇ ≤ 0 rests on ∇CᵀM = 0, on Rcl ⪰ 0 and on the ports alone. Where no momentum stands in c and G,
none of these contains an inertia, a potential or a friction of the momenta; the published law with
Φ = H + Hc + C feeds back Gᵀ∇H = Bᵀq̇ and c(q, ξ), which contain none of them either.
"""

from __future__ import annotations

import sympy as sp

from necc_casadi.certificate.claims import statements
from necc_casadi.certificate.claims.claim import Claim
from necc_casadi.designs.design import Design
from necc_casadi.model.shaped_loop import ShapedLoop
from necc_casadi.symbolic.zero import is_zero

__all__ = ["prove_measurement"]


def prove_measurement(design: Design) -> Claim | None:
    """That p = M q̇, and whether the law needs M; None where the states are measured."""
    known = design.measurement
    if not known.of_velocities:
        return None
    plant = design.loop.plant
    k, there = plant.n // 2, dict(zip(plant.x, known.state, strict=True))
    rates = (plant.drift[i, 0].xreplace(there) - known.y[k + i] for i in range(k))
    if not all(is_zero(entry) is True for entry in (*rates, *plant.directions[:k, :])):
        return Claim("measurement", False, statements.NOT_MEASURED)
    if _needs_no_mass(design):
        return Claim("measurement", True, statements.MEASURED_OF_ANY_MASS)
    return Claim("measurement", True, statements.MEASURED_OF_THIS_MASS)


def _needs_no_mass(design: Design) -> bool:
    loop, plant = design.loop, design.loop.plant
    if isinstance(loop, ShapedLoop) or plant.preliminary is not None or design.form.phi is not None:
        return False
    k = plant.n // 2
    momenta = set(plant.x[k:])
    free = not any(momenta & e.free_symbols for e in (*design.casimirs.functions, *plant.G))
    canonical = plant.J[:k, :] - sp.Matrix.hstack(sp.zeros(k, k), sp.eye(k))
    return free and not any((*canonical, *plant.R[:k, :]))
