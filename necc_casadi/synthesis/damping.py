"""How large the damping of Lemma EnergyCasimirControl should be.

Damping injection is v = −D Gᵀ∂V/∂x, v_c = −Dc Gcᵀ∂V/∂ξ: here the two ports are not coupled.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from necc_casadi.arrays import Vector
from necc_casadi.lyapunov.damping import uncoupled
from necc_casadi.lyapunov.lyapunov import LyapunovFunction
from necc_casadi.model.closed_loop import ClosedLoop

__all__ = ["choose_damping"]


#: Multiples of the natural damping that are tried, for loops of few and of many states.
_STEPS, _FEW_STEPS, _MANY_STATES = 33, 13, 12


#: Of the dampings within this share of the best decay rate, the smallest is taken.
_NEAR_BEST = 0.9


#: A mode slower than this share of the fastest rate is one that no damping reaches.
_STILL = 1e-9


def choose_damping(
    V: LyapunovFunction,
    loop: ClosedLoop,
    z_star: Vector,
    D: Vector | None = None,
    Dc: Vector | None = None,
    bends: Sequence[Vector] = (),
) -> tuple[Vector, Vector]:
    """D, m × m, and Dc, (channels)²: as given, or for the best decay rate of the linearised loop.

    Too much damping slows the loop down as much as too little, so the rate is searched over
    multiples of a natural damping, and of those near the best the smallest is taken: it costs
    the least input and amplifies the least noise. The yes or no of stability does not depend
    on the choice. With the `bends` of a family, ∇²V of a member less that of V at z*, the decay
    rate is that of the slowest member.
    """
    if D is not None and Dc is not None:
        return D, Dc
    hessian = V.hessian(z_star)
    M = np.asarray(V.terms.M(z_star), float) / V.phi_slope(z_star)
    ports = np.array(loop.ports.subs(dict(zip(loop.z, z_star, strict=True))).evalf(), float)
    natural = _natural_damping(M, hessian, ports)
    m = V.terms.m
    candidates = [
        (
            np.diag(d * natural[:m]) if D is None else D,
            np.diag(dc * natural[m:]) if Dc is None else Dc,
            d**2 * dc,
        )
        for d, dc in _multiples(D is None, Dc is None, many=len(z_star) > _MANY_STATES)
    ]
    generators = [_generator(M, ports, d, dc) for d, dc, _ in candidates]
    plants = [hessian, *(hessian + more for more in bends)]
    rates = np.min([_decay_rates([A @ N for A in generators]) for N in plants], axis=0)
    good = [
        c for c, rate in zip(candidates, rates, strict=True) if rate >= _NEAR_BEST * rates.max()
    ]
    chosen = min(good, key=lambda candidate: candidate[2])
    return _rounded(chosen[0]), _rounded(chosen[1])


def _multiples(vary_D: bool, vary_Dc: bool, many: bool) -> list[tuple[float, float]]:
    """Multiples of the natural damping to try: a grid, or two lines through 1 for many states."""
    steps = np.logspace(-2, 2, _FEW_STEPS if many else _STEPS).tolist()
    for_D, for_Dc = (steps if vary else [1.0] for vary in (vary_D, vary_Dc))
    if many:
        return [(d, 1.0) for d in for_D] + [(1.0, dc) for dc in for_Dc]
    return [(d, dc) for d in for_D for dc in for_Dc]


def _generator(M: Vector, ports: Vector, D: Vector, Dc: Vector) -> Vector:
    """M/Φ₁ − 𝒢𝒟𝒢ᵀ."""
    result: Vector = M - ports @ uncoupled(D, Dc) @ ports.T
    return result


def _decay_rates(matrices: list[Vector]) -> Vector:
    """Slowest rate of each linearisation, leaving out as many modes as no damping reaches."""
    real = np.array([np.sort(-np.linalg.eigvals(A).real) for A in matrices])
    still = (real <= _STILL * np.abs(real).max(axis=1, keepdims=True)).sum(axis=1).min()
    rates: Vector = np.maximum(real[:, min(int(still), real.shape[1] - 1)], 0.0)
    return rates


def _rounded(D: Vector) -> Vector:
    """Three digits: a damping gain that an engineer can read."""
    return np.array([[float(f"{v:.3g}") for v in row] for row in D])


def _natural_damping(M: Vector, hessian: Vector, ports: Vector) -> Vector:
    """Damping of each port at which its rate equals the loop's natural frequency."""
    frequencies = np.abs(np.linalg.eigvals(M @ hessian))
    significant = frequencies[frequencies > 1e-6 * max(frequencies.max(), 1e-300)]
    omega = float(np.median(significant)) if significant.size else 1.0
    rates = np.einsum("ij,ik,kj->j", ports, hessian, ports)
    return omega / np.where(rates > 0, rates, 1.0)
