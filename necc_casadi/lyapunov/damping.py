"""Damping injection (v, v_c) = −𝒟 𝒢ᵀ∇V: 𝒟 with a positive definite symmetric part.

𝒟 = diag(D, Dc) is that of Lemma EnergyCasimirControl. A coupling between the two ports, its skew
part included, changes neither V nor where V̇ vanishes: V̇ sees (𝒟 + 𝒟ᵀ)/2 alone.
"""

from __future__ import annotations

import numpy as np

from necc_casadi.arrays import Vector

__all__ = ["acts_alone", "dissipates", "is_coupled", "uncoupled", "without_inputs"]


def uncoupled(D: Vector, Dc: Vector) -> Vector:
    """𝒟 = diag(D, Dc), square, one row for each entry of (v, v_c)."""
    m, size = len(D), len(D) + len(Dc)
    damping = np.zeros((size, size))
    damping[:m, :m], damping[m:, m:] = D, Dc
    return damping


def is_coupled(damping: Vector, m: int) -> bool:
    """Whether the first m ports and the others have to do with each other."""
    return bool(damping[:m, m:].any() or damping[m:, :m].any())


def acts_alone(damping: Vector, m: int) -> bool:
    """Whether each of the first m entries of (v, v_c) is about its own port alone."""
    D = damping[:m, :m]
    return not (is_coupled(damping, m) or (D - np.diag(np.diag(D))).any())


def without_inputs(damping: Vector, m: int) -> Vector:
    """𝒟 without v, the first m entries, and without all that is coupled with it."""
    left = np.zeros_like(damping)
    if not is_coupled(damping, m):
        left[m:, m:] = damping[m:, m:]
    return left


def dissipates(damping: Vector) -> bool:
    """Whether the symmetric part is ≻ 0 in floating point, whatever the units of its rows."""
    symmetric = (damping + damping.T) / 2
    diagonal = np.diag(symmetric)
    if not np.all(diagonal > 0):
        return False
    root = np.sqrt(diagonal)
    return bool(np.linalg.eigvalsh(symmetric / root / root[:, None])[0] > 0)
