"""Damping injection (v, v_c) = −𝒟 𝒢ᵀ∇V: 𝒟 with a positive definite symmetric part.

𝒟 = diag(D, Dc) is that of Lemma EnergyCasimirControl. A coupling between the two ports, its skew
part included, changes neither V nor where V̇ vanishes: V̇ sees (𝒟 + 𝒟ᵀ)/2 alone.
"""

from __future__ import annotations

import numpy as np

from necc_casadi.arrays import Vector

__all__ = ["dissipates", "uncoupled"]


def uncoupled(D: Vector, Dc: Vector) -> Vector:
    """𝒟 = diag(D, Dc), square, one row for each entry of (v, v_c)."""
    m, size = len(D), len(D) + len(Dc)
    damping = np.zeros((size, size))
    damping[:m, :m], damping[m:, m:] = D, Dc
    return damping


def dissipates(damping: Vector) -> bool:
    """Whether the symmetric part is ≻ 0 in floating point, whatever the units of its rows."""
    symmetric = (damping + damping.T) / 2
    diagonal = np.diag(symmetric)
    if not np.all(diagonal > 0):
        return False
    root = np.sqrt(diagonal)
    return bool(np.linalg.eigvalsh(symmetric / root / root[:, None])[0] > 0)
