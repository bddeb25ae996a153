"""Integral action on the position of a fully actuated mechanical plant.

    u = −Gcᵀ∇Hc(ξ) + v − ζ,   ζ̇ = Kᵢ(s + τy),   s = Gᵀ of q − q*,   |ζᵢ| ≤ bᵢ by projection

∫y would be a spring, which ξ is already; what removes an offset is the integral of the position
error, and τy keeps it from swinging (docs/theory.md#integral-action).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from necc_casadi.arrays import Vector
from necc_casadi.lyapunov.lyapunov import LyapunovFunction
from necc_casadi.model.sizes import Sizes

__all__ = ["Integral", "integral_of", "integral_rate", "integral_text", "with_integrators"]


@dataclass(frozen=True, eq=False)
class Integral:
    """ζ̇ = gain ∘ (s + τy), kept within ±limit entry by entry; s = Bᵀ(q − q*), y = Bᵀq̇."""

    tau: float  # s
    gain: Vector  # (m,), above 0: input per (output times time) and time
    limit: Vector  # (m,), above 0: input

    def measured_in(self, units: Sizes) -> Integral:
        """The same in other units."""
        position = units.energy / units.input  # of s: y times a time
        gain = self.gain * position * units.time / units.input
        return replace(self, tau=self.tau / units.time, gain=gain, limit=self.limit / units.input)


def with_integrators(
    V: LyapunovFunction, integral: Integral | None, q_star: Vector, *, measured: bool = False
) -> ca.Function:
    """(x, (s, ζ)) -> (u, (ṡ, ζ̇)) of the controller, ζ not held within its limits.

    Without integral action it is the law itself, (x, s) -> (u, ṡ). With `measured` x is what the
    controller takes, else the state.

    Parameters
    ----------
    V
        Of the design.
    integral
        What is added to its law.
    q_star
        Coordinates of the target, (n/2,).
    """
    terms = V.terms
    law = V.measured_law_function if measured else V.control_law_function
    if integral is None:
        return law
    nc = terms.nc
    x, kept = ca.MX.sym("x", terms.n), ca.MX.sym("kept", nc + terms.m)
    u, s_dot = law.call([x, kept[:nc]])
    rate = integral_rate(V, integral, q_star, measured=measured)(x)
    return ca.Function(
        "integral",
        [x, kept],
        [u - kept[nc:], ca.vertcat(s_dot, rate)],
        ["x", "kept"],
        ["u", "rate"],
    )


def integral_rate(
    V: LyapunovFunction, integral: Integral, q_star: Vector, *, measured: bool
) -> ca.Function:
    """X -> Kᵢ(s + τy), (m,), of a state or of what is measured of it."""
    terms, k = V.terms, len(q_star)
    x = ca.SX.sym("x", terms.n)
    state = terms.measured.state(x) if measured else x
    slope = terms.measured.grad_H(x) if measured else terms.grad_H(x)
    inputs = terms.directions(state)
    s = inputs[k:, :].T @ (x[:k] - ca.DM(q_star))  # the rows of p in G are B
    rate = ca.DM(integral.gain) * (s + integral.tau * (inputs.T @ slope))
    return ca.Function("integral_rate", [x], [rate], ["x"], ["rate"])


def integral_text(integral: Integral) -> dict[str, Any]:
    """What design.json says of it."""
    return {
        "tau": float(integral.tau).hex(),
        "gain": [float(v).hex() for v in integral.gain],
        "limit": [float(v).hex() for v in integral.limit],
    }


def integral_of(data: Mapping[str, Any]) -> Integral:
    """The value of that text.

    Raises
    ------
    ValueError
        Where a number is not positive and finite.
    """
    gain, limit = (np.array([float.fromhex(v) for v in data[key]]) for key in ("gain", "limit"))
    found = Integral(float.fromhex(data["tau"]), gain, limit)
    numbers = np.concatenate([[found.tau], gain, limit])
    if len(gain) != len(limit) or not np.all(np.isfinite(numbers) & (numbers > 0)):
        raise ValueError("an integral action needs positive numbers, one for each input")
    return found
