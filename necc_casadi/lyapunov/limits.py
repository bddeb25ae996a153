"""Inputs within their limits: clipped one by one, or the damping injection scaled.

The law is ũ = −y_c + v with y_c = A∇Hc. Where 𝒟 is diagonal in v, clipping u leaves of each vᵢ a
share in [0, 1], and V̇ ≤ 0 stays. Any other 𝒟 needs one share τ of all of v, and of the v_c that is
coupled with it: wᵀ(τv) = −τ wᵀDw, w = Gᵀ∂V/∂x. It is the largest with which u keeps to its limits.
A limit that −y_c is beyond itself has no say in τ, and clips.

References
----------
docs/theory.md#clipped-inputs.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from necc_casadi.arrays import Vector
from necc_casadi.lyapunov.damping import acts_alone
from necc_casadi.model.plant import Plant

__all__ = ["clipped", "limited_law", "scaled", "scales_damping", "share"]


def scales_damping(plant: Plant, damping: Vector) -> bool:
    """Whether limits of u scale this damping injection; else they clip each input by itself."""
    ahead = plant.preliminary
    alone = acts_alone(damping, plant.m) and (ahead is None or ahead.acts_alone)
    return plant.u_limits is not None and not alone


def limited_law(
    law: ca.Function, resting: ca.Function | None, low: Vector | None, high: Vector | None
) -> ca.Function:
    """(x, kept) -> (u, rate, what u would be without limits).

    Parameters
    ----------
    law
        (x, kept) -> (u, rate), without limits.
    resting
        The same without the damping that limits scale; None: they clip each input.
    low, high
        Limits, (m,); None: there are none.
    """
    x, kept = (ca.MX.sym(name, law.size_in(i)[0]) for i, name in enumerate(("x", "kept")))
    asked, rate = law.call([x, kept])
    u = asked
    if low is not None and high is not None:
        if resting is None:
            u = clipped(asked, ca.DM(low), ca.DM(high))
        else:
            without = resting.call([x, kept])
            u, rate = scaled(asked, rate, without[0], without[1], ca.DM(low), ca.DM(high))
    return ca.Function(
        "limited", [x, kept], [u, rate, asked], ["x", "kept"], ["u", "rate", "asked"]
    )


def clipped(u: ca.MX, low: ca.DM, high: ca.DM) -> ca.MX:
    """Each input within its limits, (m,)."""
    return ca.fmin(ca.fmax(u, low), high)


def scaled(
    u: ca.MX, rate: ca.MX, resting: ca.MX, resting_rate: ca.MX, low: ca.DM, high: ca.DM
) -> tuple[ca.MX, ca.MX]:
    """(u, ṡ) with the largest share of damping that the limits leave.

    Of the law with damping, and without what is scaled (``damping.without_inputs``).
    """
    lost = 1 - share(resting, u - resting, low, high)
    return clipped(u - lost * (u - resting), low, high), rate - lost * (rate - resting_rate)


def share(resting: ca.MX, v: ca.MX, low: ca.DM, high: ca.DM) -> ca.MX:
    """τ ∈ [0, 1] for u = resting + τv, a scalar; limits may be ∞."""
    parts = [ca.MX(1)]
    ends = (np.asarray(side, float).ravel() for side in (low, high))
    for i, (lo, hi) in enumerate(zip(*ends, strict=True)):
        parts += [_fitting(hi - resting[i], v[i])] * bool(np.isfinite(hi))
        parts += [_fitting(resting[i] - lo, -v[i])] * bool(np.isfinite(lo))
    return ca.mmin(ca.vertcat(*parts))


def _fitting(room: ca.MX, v: ca.MX) -> ca.MX:
    """The share of v that fits into the room, at most 1, and 1 where there is none."""
    none, one = ca.DM(1, 1), ca.MX(1)
    some = ca.if_else(room > none, room, one)  # never divides by 0
    return ca.if_else(room > none, some / ca.fmax(v, some), one)
