"""The non-parameterised mode: a network C_θ(z) with the Casimir equation in the cost.

eq. NonParameterizedCostMinimization: Σ ‖∇C_θ(zᵢ)ᵀ(Jcl − Rcl)(zᵢ)‖² over samples of the domain joins
the objective. C_θ is then a Casimir only approximately: V̇ ≤ 0 is not implied, and no certificate
is claimed from it (docs/theory.md#learned-casimirs). What is reported is the residual on points
that it was not trained on.
"""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import numpy as np

from necc_casadi.arrays import Vector
from necc_casadi.casimirs.casimirs import Casimirs
from necc_casadi.designs.outcome import Residual
from necc_casadi.lyapunov.lyapunov import Terms
from necc_casadi.lyapunov.parameterization import Form
from necc_casadi.model.closed_loop import ClosedLoop
from necc_casadi.model.sizes import Sizes

__all__ = ["casimir_penalty", "casimir_residual", "state_inputs"]


#: Weight of the mean squared Casimir residual beside the shape of V; large, because the residual
#: is what the decrease of V rests on.
_WEIGHT = 1e4


_TRAINED, _TESTED = 200, 1000


def state_inputs(loop: ClosedLoop, casimirs: Casimirs) -> Casimirs:
    """What C_θ(z) takes in place of Casimirs: every closed-loop state. None of them is proved."""
    return Casimirs(
        functions=loop.z,
        kernel_rank=casimirs.kernel_rank,
        generic_count=casimirs.generic_count,
        origins=("state, input of a learned Casimir",) * len(loop.z),
        count_proved=casimirs.count_proved,
    )


def casimir_penalty(
    terms: Terms, form: Form, scales: Sizes, z_guess: Vector, seed: int
) -> Callable[[ca.MX, ca.MX], ca.MX]:
    """(weights, ξ*) ↦ weighted mean over samples of ‖∇C_θᵀ(Jcl − Rcl)‖², in natural units."""
    w, z = ca.MX.sym("w", form.size), ca.MX.sym("z", len(z_guess))
    gradient = ca.gradient(form.casimir(w)(terms.c(z)), z)
    scaled = (terms.M(z).T @ gradient) / ca.DM(scales.state)
    square = ca.Function("square", [w, z], [ca.sumsqr(scaled)])
    samples = ca.DM(_samples(scales, z_guess, _TRAINED, seed).T)
    count = samples.shape[1]

    def penalty(weights: ca.MX, _: ca.MX) -> ca.MX:
        return _WEIGHT / count * ca.sum2(square.map(count)(ca.repmat(weights, 1, count), samples))

    return penalty


def casimir_residual(
    terms: Terms, form: Form, weights: Vector, scales: Sizes, z_star: Vector, seed: int
) -> Residual:
    """The relative residual on fresh samples of the domain."""
    z = ca.MX.sym("z", len(z_star))
    gradient = ca.gradient(form.casimir(ca.DM(weights))(terms.c(z)), z)
    evaluate = ca.Function("both", [z], [gradient, terms.M(z)])
    shares = []
    for point in _samples(scales, z_star, _TESTED, seed + 1_000_003):
        slope, M = (np.asarray(v, float) for v in evaluate.call([point]))
        size = np.linalg.norm(slope) * np.linalg.norm(M, 2)
        shares.append(float(np.linalg.norm(M.T @ slope) / size) if size > 0 else 0.0)
    return Residual(float(np.mean(shares)), float(np.max(shares)), len(shares))


def _samples(scales: Sizes, centre: Vector, count: int, seed: int) -> Vector:
    """Points of the natural domain around `centre` (half-width two sizes), (count, n + nc)."""
    rng = np.random.default_rng(seed)
    return centre + rng.uniform(-2, 2, (count, len(centre))) * scales.state
