"""What a plant is like near a target, in natural units, and what its responses cost beside LQR's.

The free numbers of a target structure are chosen by that cost: it is what a response from random
states near the target costs, ∫ xᵀQx + uᵀRu dt, over the least that any feedback pays.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import sympy as sp

from necc_casadi.arrays import Vector
from necc_casadi.model.cost import QuadraticCost
from necc_casadi.model.lqr import Lqr, lqr
from necc_casadi.model.modulated import System
from necc_casadi.model.sizes import Sizes
from necc_casadi.symbolic.derivatives import at
from necc_casadi.symbolic.floats import float_matrix

__all__ = ["LinearTarget", "Weigh", "least", "linear_target"]


#: Sizes and a number of plant states → the cost by which responses are judged.
Weigh = Callable[[Sizes, int], QuadraticCost]

#: How far the real part of a mode is to be from 0, beside the fastest one.
_STILL = 1e-9

#: How far a loop may be from being the plant under a feedback, beside its largest entry.
_ROUNDING = 1e-7

#: What stands for the logarithm of an infinite cost.
_DEAR = 40.0


@dataclass(frozen=True, eq=False)
class LinearTarget:
    """ẋ = Ax + Bu in natural units, its cost and the LQR of it."""

    A: Vector  # (n, n)
    B: Vector  # (n, m)
    cost: QuadraticCost
    best: Lqr
    spread: Vector  # (n,) of the starts, in natural units

    def over_lqr(self, closed: Vector) -> float:
        """Cost of ẋ = closed·x over LQR's; ∞ where it is not stable or not a feedback's."""
        if not np.isfinite(closed).all():
            return np.inf
        K = np.asarray(np.linalg.lstsq(self.B, self.A - closed, rcond=None)[0], float)
        size = np.abs(self.A).max() + np.abs(closed).max()
        if np.abs(self.A - self.B @ K - closed).max() > _ROUNDING * size:
            return np.inf
        modes = np.linalg.eigvals(closed)
        if not modes.real.max() < -_STILL * np.abs(modes).max():
            return np.inf
        return self._price(closed, K) / self._price(self.A - self.B @ self.best.K, self.best.K)

    def _price(self, closed: Vector, K: Vector) -> float:
        from scipy.linalg import solve_continuous_lyapunov  # slow to import, few runs need it

        P = solve_continuous_lyapunov(closed.T, -(self.cost.Q + K.T @ self.cost.R @ K))
        return float(np.sum(np.diag(P) * self.spread**2))


def linear_target(
    system: System, x_star: Mapping[sp.Symbol, sp.Expr], sizes: Sizes, weigh: Weigh
) -> LinearTarget | None:
    """The linearised plant at an equilibrium; None where LQR does not stabilise it.

    Parameters
    ----------
    system
        ẋ = f + g u.
    x_star
        An equilibrium, exact.
    sizes
        Of the n states and m inputs, and the natural time.
    weigh
        What responses cost, in the units of the model.
    """
    n, units = system.n, sizes.units
    x, u, time = units.state[:n], units.input, units.time
    held = sp.Matrix(system.drift + system.directions * system.holding_input(x_star))
    A = float_matrix(at(held.jacobian(system.x), x_star)) * x / x[:, None] * time
    B = float_matrix(at(sp.Matrix(system.directions), x_star)) * u / x[:, None] * time
    if not (np.isfinite(A).all() and np.isfinite(B).all()):
        return None
    cost = weigh(sizes, n).measured_in(units)
    best = lqr(A, B, cost)
    return None if best is None else LinearTarget(A, B, cost, best, sizes.state[:n] / x)


def least(
    cost: Callable[[Vector], float], starts: Sequence[Vector], enough: float
) -> tuple[Vector, float] | None:
    """Parameters of the least cost > 0 that steps from the starts find; None: none is finite.

    Starts are taken in turn until a cost is below `enough`.
    """
    from scipy.optimize import minimize  # slow to import, few runs need it

    def objective(theta: Vector) -> float:
        with np.errstate(all="ignore"):
            value = cost(theta)
        return float(np.log(value)) if 0 < value < np.exp(_DEAR) else _DEAR

    best: tuple[Vector, float] | None = None
    for start in starts:
        if objective(start) >= _DEAR:
            continue
        found = minimize(objective, start, method="BFGS", options={"gtol": 1e-4, "maxiter": 300})
        value = float(np.exp(found.fun))
        if best is None or value < best[1]:
            best = np.asarray(found.x, float), value
        if best[1] < enough:
            break
    return best
