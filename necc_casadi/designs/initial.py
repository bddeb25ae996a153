"""ξ(0) for a measured x(0): ξ*, or where V(x(0), ·) is least.

The least is sought as ``necc_init_at`` does it: Newton's method from ξ* with Armijo's rule, at most
50 steps of 30 halvings each. Both end at the same minimum.
"""

from __future__ import annotations

import numpy as np

from necc_casadi.arrays import Vector
from necc_casadi.designs.parts import Parts
from necc_casadi.lyapunov.lyapunov import LyapunovFunction

__all__ = ["least_over_xi"]


_STEPS, _HALVINGS, _ARMIJO = 50, 30, 1e-4


#: Shifts of a Hessian that is not positive definite, in natural stiffnesses.
_SHIFTS = (0.0, *10.0 ** np.arange(-3, 9))


def least_over_xi(V: LyapunovFunction, parts: Parts, x: Vector) -> tuple[Vector, bool]:
    """ξ at the minimum of V(x, ·) that Newton's method reaches from ξ*, (nc,); whether it does.

    Where it reaches none, ξ is the best that was found.

    Parameters
    ----------
    V, parts
        Of the design, in one system of units.
    x
        Plant state (n,).
    """
    n, xi = len(x), parts.xi_star
    stiffness = np.diag(parts.sizes.stiffness[n:])
    rounding = 4 * np.finfo(float).eps
    for _ in range(_STEPS):
        z = np.concatenate([x, xi])
        value, g = float(V.V(z)), V.gradient(z)[n:]
        step, convex = _downhill(V.hessian(z)[n:, n:], stiffness, g)
        slope = float(g @ step)
        if -slope <= rounding * (parts.sizes.energy + abs(value)):
            return np.asarray(xi + step, float), convex
        for halving in range(_HALVINGS):
            length = 0.5**halving
            trial = xi + length * step
            if float(V.V(np.concatenate([x, trial]))) <= value + _ARMIJO * length * slope:
                break
        else:
            break
        xi = trial
    return xi, False


def _downhill(hessian: Vector, stiffness: Vector, g: Vector) -> tuple[Vector, bool]:
    """Newton's step, or that of the least shift which makes the Hessian positive definite.

    And whether it is Newton's.
    """
    for shift in _SHIFTS:
        shifted = hessian + shift * stiffness
        try:
            np.linalg.cholesky(shifted)
            return np.asarray(-np.linalg.solve(shifted, g), float), shift == 0
        except np.linalg.LinAlgError:
            continue
    return np.zeros_like(g), False
