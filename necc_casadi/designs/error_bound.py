"""ε of a finished design (eq. FinalTrainLoss) and the bound that follows (eq. ErrorUpperBound)."""

from __future__ import annotations

import numpy as np

from necc_casadi.designs.design import Design

__all__ = ["ACCEPTED_LOSS", "gradient_and_hessian", "loss", "natural_loss", "published_bound"]


#: A design whose ε, in natural units, is above this fell short, whatever else is proved.
ACCEPTED_LOSS = 1e-6


def natural_loss(design: Design) -> float:
    """ε of eq. Loss in natural units, for the curvature that was asked for there."""
    g, hessian = gradient_and_hessian(design.natural)
    short = -np.linalg.eigvalsh(hessian - np.diag(design.curvature))[0]
    return float(np.linalg.norm(g) + max(0.0, short))


def loss(design: Design) -> float:
    """ε of eq. Loss, recomputed from the stored weights, in the units of the model."""
    g, hessian = gradient_and_hessian(design)
    return float(np.linalg.norm(g) + max(0.0, design.a - np.linalg.eigvalsh(hessian)[0]))


def published_bound(loss: float, a: float) -> float | None:
    """ε/(a − ε), to first order a bound of ‖z̄ − z*‖ (eq. ErrorUpperBound); None where a ≤ ε.

    What holds without that restriction is the certificate's ``bound_rigorous``.
    """
    return loss / (a - loss) if a > loss else None


def gradient_and_hessian(design: Design) -> tuple[np.ndarray, np.ndarray]:
    """∇V (N,) and ∇²V (N, N) at z*."""
    V, z = design.lyapunov, design.z_star
    return V.gradient(z), V.hessian(z)
