"""The loop as it is built: the plant gets u within its limits, the controller moves by x alone."""

from __future__ import annotations

from functools import lru_cache

import casadi as ca

from necc_casadi.designs.design import Design
from necc_casadi.lyapunov.lyapunov import state_rate

__all__ = ["disturbed_field", "integrators", "saturated_field"]


def integrators(design: Design) -> int:
    """Entries of ζ."""
    return 0 if design.integral is None else design.loop.plant.m


@lru_cache(maxsize=4)
def saturated_field(design: Design) -> ca.Function:
    """(z, ζ) -> (ż, ζ̇) with u limited; without limits and ζ the loop that proofs of V are about."""
    if design.loop.plant.u_limits is None and design.integral is None:
        return design.lyapunov.vector_field_function
    w = ca.MX.sym("z", len(design.loop.z) + integrators(design))
    rate = disturbed_field(design)(w, ca.DM(design.loop.plant.m, 1))
    return ca.Function("saturated", [w], [rate], ["z"], ["z_dot"])


@lru_cache(maxsize=4)
def disturbed_field(design: Design) -> ca.Function:
    """(z, ζ), d -> (ż, ζ̇) with u limited and a constant d (m,) added to what the plant gets."""
    V = design.lyapunov
    terms, N = V.terms, V.terms.n + V.terms.nc
    w, d = ca.MX.sym("w", N + integrators(design)), ca.MX.sym("d", terms.m)
    x, s = w[: terms.n], w[terms.n : N] - terms.gamma(w[: terms.n])
    zeta = [w[N:]] if design.integral is not None else []
    u, kept_dot, _ = design.limited_controller.call([x, ca.vertcat(s, *zeta)])
    s_dot = kept_dot[: terms.nc]
    zeta_dot = [_projected(design, v, kept_dot[terms.nc :]) for v in zeta]
    x_dot = terms.drift(x) + terms.directions(x) @ (u + d)
    rate = state_rate(terms, x, x_dot, s_dot)
    return ca.Function("loop", [w, d], [ca.vertcat(rate, *zeta_dot)], ["w", "d"], ["rate"])


def _projected(design: Design, zeta: ca.MX, rate: ca.MX) -> ca.MX:
    """The rate, without what leads out of |ζᵢ| ≤ bᵢ."""
    if design.integral is None:
        return rate
    b = ca.DM(design.integral.limit)
    none = ca.DM(*rate.shape)
    up = ca.if_else(zeta >= b, ca.fmin(rate, none), rate)
    return ca.if_else(zeta <= -b, ca.fmax(up, none), up)
