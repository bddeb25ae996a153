"""Quadratic parts stiff enough for V to be convex everywhere, where the plant allows it."""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import numpy as np
import sympy as sp

from necc_casadi.assignability import Verdict
from necc_casadi.lifting import Scales
from necc_casadi.lyapunov import Terms
from necc_casadi.networks import KAPPA_MIN, Vector

__all__ = ["least_kappa"]

_SAMPLES = 400
#: Least eigenvalue, relative to the reference stiffness, that quadratic parts alone must reach
#: at every sample: what is left for the networks to take away.
_MARGIN = 0.15
_STIFFEST = 1e4


def least_kappa(
    terms: Terms, scales: Scales, verdict: Verdict, x_star: Vector, xi_star: Vector
) -> float:
    """The least κ, in natural units, for which quadratic parts alone make V convex at samples.

    The samples fill twice the natural domain, whole turns of an angle included. A certificate,
    not this search, says whether V is convex everywhere. Where no stiffness helps (H curves
    downwards somewhere along an invisible direction) the default bound is returned.
    """
    lowest = _lowest_curvature(terms, scales, verdict, np.concatenate([x_star, xi_star]))
    upper = 1.0
    while lowest(upper) < _MARGIN:
        upper *= 2
        if upper > _STIFFEST:
            return KAPPA_MIN
    lower = 0.0 if upper == 1.0 else upper / 2
    for _ in range(20):
        middle = (lower + upper) / 2
        lower, upper = (lower, middle) if lowest(middle) >= _MARGIN else (middle, upper)
    return upper


def _lowest_curvature(
    terms: Terms, scales: Scales, verdict: Verdict, z_star: Vector
) -> Callable[[float], float]:
    """κ ↦ least eigenvalue of ∇²V over the samples, V = H + λᵀc + ½κ(‖ξ‖² + ‖c − c*‖²) scaled."""
    n = terms.n
    z, kappa = ca.MX.sym("z", len(z_star)), ca.MX.sym("kappa")
    c, c_star = terms.c(z), np.asarray(terms.c(z_star), float)
    slope = ca.Function("dc", [z], [ca.jacobian(c, z)])
    reach = (np.abs(np.asarray(slope(z_star), float)) * scales.state).max(axis=1, initial=0.0)
    reach[reach == 0] = 1.0
    lam = np.zeros(terms.r)
    if verdict.lam is not None and len(verdict.lam) == terms.r:
        lam = np.array([float(sp.N(v)) for v in verdict.lam])
    stretch = ca.sumsqr(z[n:] / scales.state[n:]) + ca.sumsqr((c - c_star) / reach)
    V = terms.H(z[:n]) + ca.dot(lam, c) + kappa * scales.energy / 2 * stretch
    hessian = ca.Function("hessian", [z, kappa], [ca.hessian(V, z)[0]])
    offsets = np.random.default_rng(0).uniform(-4, 4, (_SAMPLES, len(z_star)))
    samples = z_star + offsets * scales.state

    def lowest(value: float) -> float:
        all_hessians = np.asarray(hessian.map(len(samples))(samples.T, value), float)
        blocks = all_hessians.reshape(len(z_star), len(samples), len(z_star)).swapaxes(0, 1)
        relative = blocks * np.outer(scales.state, scales.state) / scales.energy
        finite = relative[np.isfinite(relative).all(axis=(1, 2))]
        return float(np.linalg.eigvalsh(finite).min())

    return lowest
