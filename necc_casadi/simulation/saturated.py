"""The loop as it is built: the plant gets u within its limits, the controller moves by x alone."""

from __future__ import annotations

from functools import lru_cache

import casadi as ca
import numpy as np

from necc_casadi.arrays import Vector
from necc_casadi.designs.design import Design
from necc_casadi.lyapunov.lyapunov import state_rate

__all__ = ["applied", "saturated_field"]


def applied(design: Design, u: Vector) -> Vector:
    """Inputs (…, m) within the limits of the model, in its units."""
    limits = design.loop.plant.u_limits
    if limits is None:
        return u
    low, high = np.array(limits, float).T
    return np.asarray(np.clip(u, low, high), float)


@lru_cache(maxsize=4)
def saturated_field(design: Design) -> ca.Function:
    """Z -> ż with u clipped; where the model has no limits, the loop that the proofs are about."""
    V, limits = design.lyapunov, design.loop.plant.u_limits
    if limits is None:
        return V.vector_field_function
    terms, (low, high) = V.terms, np.array(limits, float).T
    z = ca.MX.sym("z", terms.n + terms.nc)
    x, xi = z[: terms.n], z[terms.n :]
    u, s_dot = V.control_law_function.call([x, xi - terms.gamma(x)])
    held = ca.fmin(ca.fmax(u, ca.DM(low)), ca.DM(high))
    x_dot = terms.drift(x) + terms.directions(x) @ held
    rate = state_rate(terms, x, x_dot, s_dot)
    return ca.Function("saturated", [z], [rate], ["z"], ["z_dot"])
