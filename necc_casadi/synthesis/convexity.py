"""Quadratic parts stiff enough for V to be convex everywhere, where the plant allows it."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import casadi as ca
import numpy as np

from necc_casadi.arrays import Vector
from necc_casadi.lyapunov.lyapunov import Terms
from necc_casadi.lyapunov.networks import KAPPA_MIN
from necc_casadi.model.sizes import Sizes
from necc_casadi.symbolic.floats import to_floats
from necc_casadi.verdict.verdict import Verdict

__all__ = ["least_kappa"]


_SAMPLES = 400


#: Least eigenvalue, relative to the reference stiffness, that quadratic parts alone must reach
#: at every sample: what is left for the networks to take away.
_MARGIN = 0.15


#: Curvature at z* beyond the one asked for.
_TO_SPARE = 1.2


_STIFFEST = 1e4


def least_kappa(
    terms: Terms,
    scales: Sizes,
    verdict: Verdict,
    x_star: Vector,
    xi_star: Vector,
    a: Vector,
    momenta: Sequence[int] = (),
    energies: Sequence[ca.Function] = (),
) -> float:
    """The least κ, in natural units, for which quadratic parts alone make V convex at samples.

    `energies` are those of the members of a family, for which V is to be convex, too.

    They must also reach the curvature `a` (n + nc,) at z*, with something to spare, so that the
    networks need not. The samples fill twice the natural domain, whole turns of an angle included.
    The plant states `momenta` are at rest in them: H is convex in them, and the proof of a global
    minimum minimises over them before it asks for the Hessian of what is left. A certificate, not
    this search, says whether V is convex everywhere. Where no stiffness helps (H curves downwards
    somewhere along an invisible direction) the default bound is returned.
    """
    z_star = np.concatenate([x_star, xi_star])
    members = [_hessians(terms, H, scales, verdict, z_star, momenta) for H in (terms.H, *energies)]
    asked = np.sqrt(np.outer(a, a))
    relative = np.outer(scales.state, scales.state) / scales.energy

    def lowest(kappa: float) -> tuple[float, float]:
        found = [hessians(kappa) for hessians in members]
        least = min(np.linalg.eigvalsh(at_target / asked)[0] for at_target, _ in found)
        flattest = min(np.linalg.eigvalsh(around * relative).min() for _, around in found)
        return float(least), float(flattest)

    # invisible directions have the curvature of H and no more: ask for what can be reached
    top, margin = lowest(_STIFFEST)
    if (top <= 1 or margin <= 0) and energies:  # of the nominal plant alone
        return least_kappa(terms, scales, verdict, x_star, xi_star, a, momenta)
    if top <= 1 or margin <= 0:
        return KAPPA_MIN
    needed = min(_TO_SPARE, (1 + top) / 2), min(_MARGIN, margin / 2)

    def convex(kappa: float) -> bool:
        reached = lowest(kappa)
        return reached[0] >= needed[0] and reached[1] >= needed[1]

    upper = 1.0
    while upper < _STIFFEST and not convex(upper):
        upper *= 2
    lower = 0.0 if upper == 1.0 else upper / 2
    for _ in range(20):
        middle = (lower + upper) / 2
        lower, upper = (lower, middle) if convex(middle) else (middle, upper)
    return upper


def _hessians(
    terms: Terms,
    H: ca.Function,
    scales: Sizes,
    verdict: Verdict,
    z_star: Vector,
    momenta: Sequence[int],
) -> Callable[[float], tuple[Vector, Vector]]:
    """κ ↦ ∇²V at z* and at the samples, V = H + λᵀc + ½κ(‖ξ‖² + ‖c − c*‖²) in natural units."""
    n = terms.n
    z, kappa = ca.MX.sym("z", len(z_star)), ca.MX.sym("kappa")
    c, c_star = terms.c(z), np.asarray(terms.c(z_star), float)
    slope = ca.Function("dc", [z], [ca.jacobian(c, z)])
    reach = (np.abs(np.asarray(slope(z_star), float)) * scales.state).max(axis=1, initial=0.0)
    reach[reach == 0] = 1.0
    lam = np.zeros(terms.r)
    if verdict.lam is not None and len(verdict.lam) == terms.r:
        lam = to_floats(verdict.lam)
    stretch = ca.sumsqr(z[n:] / scales.state[n:]) + ca.sumsqr((c - c_star) / reach)
    V = H(z[:n]) + ca.dot(lam, c) + kappa * scales.energy / 2 * stretch
    hessian = ca.Function("hessian", [z, kappa], [ca.hessian(V, z)[0]])
    offsets = np.random.default_rng(0).uniform(-4, 4, (_SAMPLES, len(z_star)))
    samples = z_star + offsets * scales.state
    samples[:, list(momenta)] = 0.0

    def at(value: float) -> tuple[Vector, Vector]:
        columns = np.asarray(hessian.map(len(samples))(samples.T, value), float)
        blocks = columns.reshape(len(z_star), len(samples), len(z_star)).swapaxes(0, 1)
        finite = blocks[np.isfinite(blocks).all(axis=(1, 2))]
        return np.asarray(hessian(z_star, value), float), finite

    return at
