"""LQR at the target: what a linear state feedback of least quadratic cost would do.

References
----------
Anderson and Moore (1990), Optimal Control: Linear Quadratic Methods.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from necc_casadi.arrays import Vector
from necc_casadi.model.cost import QuadraticCost

__all__ = ["Lqr", "lqr"]


#: A mode that decays more slowly than this share of the fastest is one that no input moves.
_STILL = 1e-9


@dataclass(frozen=True, eq=False)
class Lqr:
    """u = u* − K(x − x*), of cost (x − x*)ᵀP(x − x*) near the target."""

    A: Vector  # (n, n) plant at the target
    B: Vector  # (n, m)
    K: Vector  # (m, n)
    P: Vector  # (n, n)

    @cached_property
    def spectrum(self) -> Vector:
        """Eigenvalues of A − BK, (n,)."""
        return np.asarray(np.linalg.eigvals(self.A - self.B @ self.K))


def lqr(A: Vector, B: Vector, cost: QuadraticCost) -> Lqr | None:
    """LQR of ẋ = Ax + Bu; None where no feedback stabilises what costs.

    Solved where R = I and the diagonal of Q is 1, whatever the units (Bryson's coordinates).
    """
    from scipy.linalg import solve_continuous_are  # slow to import, and few runs need it

    diagonal = np.diag(cost.Q)
    scale = np.where(diagonal > 0, diagonal, np.max(diagonal)) ** -0.5
    root = np.linalg.cholesky(cost.R)  # R = root rootᵀ
    A_hat = A * scale / scale[:, None]
    B_hat = np.linalg.solve(root, (B / scale[:, None]).T).T
    Q_hat = cost.Q * np.outer(scale, scale)
    try:
        P_hat = solve_continuous_are(A_hat, B_hat, Q_hat, np.eye(B.shape[1]))
    except (np.linalg.LinAlgError, ValueError):
        return None
    P = np.asarray(P_hat / np.outer(scale, scale), float)
    K = np.linalg.solve(cost.R, B.T @ P)
    found = Lqr(A, B, K, P)
    fastest = float(np.abs(found.spectrum).max())
    return found if found.spectrum.real.max() < -_STILL * fastest else None
