"""The free numbers of a mechanical structure, by what the linearised loop costs.

At rest at q*, with b = M_dg⊥ᵀ, N = ∇γ(q*), Θ = ∇²K and the damping D of the inputs,

    q̇ = v,   v̇ = −M_d ∇²W q − M_d N D Nᵀ v,   ∇²W = (s′/bᵣ) eᵣeᵣᵀ + NΘNᵀ,

whatever J₂ is. M_d = bbᵀ/(g⊥b) + gΛgᵀ, g the basis of ker g⊥ with gₐ = eₐ − g⊥ₐeᵣ, is positive
definite for every b with g⊥b > 0 and Λ ≻ 0.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import sympy as sp

from necc_casadi.arrays import Vector
from necc_casadi.methods.linear_target import LinearTarget, Weigh, least, linear_target
from necc_casadi.methods.mechanical_model import FreeRow, MechanicalModel
from necc_casadi.model.closed_loop import interconnect
from necc_casadi.model.controller import default_controller
from necc_casadi.model.sizes import Sizes, natural_sizes
from necc_casadi.symbolic.derivatives import at, gradient
from necc_casadi.symbolic.floats import float_matrix

__all__ = ["MechanicalResponse", "mechanical_response"]


#: A structure whose loop costs no more than this multiple of LQR's is not improved.
_ENOUGH = 1.01

#: Scales of Θ and D from which the search starts, in natural units.
_SCALES = (1.0, 10.0, 0.1)

#: How often sizes that depend on γ are adapted, and the factor by which they then still grow.
_SETTLING, _SETTLED = 4, 1.5


@dataclass(frozen=True, eq=False)
class MechanicalResponse:
    """A row without an input at its target, in natural units of q, v and p."""

    target: LinearTarget
    units: Vector  # (k,) powers of two near the sizes of q
    g_perp: Vector  # (k,) with g⊥ᵣ = 1
    slope: float  # ∂s/∂qᵣ
    r: int
    momenta: Vector  # (k, k) M(q*): v to p

    @property
    def k(self) -> int:
        """Number of coordinates."""
        return len(self.g_perp)

    @property
    def others(self) -> list[int]:
        """Places of the coordinates other than q_r."""
        return [a for a in range(self.k) if a != self.r]

    @cached_property
    def _g(self) -> Vector:
        """The basis of ker g⊥, (k, k − 1)."""
        g = np.eye(self.k)[:, self.others]
        g[self.r] -= self.g_perp[self.others]
        return g

    def inertia(self, b: Vector, Lambda: Vector) -> Vector:
        """M_d, (k, k)."""
        return np.asarray(np.outer(b, b) / (self.g_perp @ b) + self._g @ Lambda @ self._g.T, float)

    def over_lqr(self, b: Vector, Lambda: Vector, Theta: Vector, D: Vector) -> float:
        """The cost of the linearised loop over LQR's."""
        k, r = self.k, self.r
        M_d = self.inertia(b, Lambda)
        N = np.eye(k)[:, self.others]
        N[r] = -b[self.others] / b[r]
        W = N @ Theta @ N.T
        W[r, r] += self.slope / b[r]
        closed = np.block([[np.zeros((k, k)), np.eye(k)], [-M_d @ W, -M_d @ N @ D @ N.T]])
        T = np.block([[np.eye(k), np.zeros((k, k))], [np.zeros((k, k)), self.momenta]])
        return self.target.over_lqr(T @ closed @ np.linalg.inv(T))

    @cached_property
    def best(self) -> tuple[Vector, Vector, float] | None:
        """A vector b with |bᵣ| = 1, Λ, and the cost that they allow; None: none is finite."""
        r, e, k = self.r, self.g_perp, self.k
        across = e.copy()
        across[r] = 0.0
        coupling = float(across @ across)
        if coupling == 0:
            return None
        along = across / coupling
        free = np.linalg.svd(np.vstack([across, np.eye(k)[r]]))[2][2:]  # (k − 2, k)
        sign = np.sign(self.slope)

        def parts(theta: Vector) -> tuple[Vector, Vector, Vector, Vector]:
            b = sign * np.eye(k)[r] + (np.exp(theta[0]) - sign) * along
            Lambda, Theta, D = _positive(theta[k - 1 :], k - 1, 3)
            return b + theta[1 : k - 1] @ free, Lambda, Theta, D

        start = np.zeros(k - 1 + 3 * _count(k - 1))
        found = self._least(lambda theta: self.over_lqr(*parts(theta)), start)
        if found is None:
            return None
        b, Lambda, *_ = parts(found[0])
        return b, Lambda, found[1]

    def best_beside(self, b: Vector) -> tuple[Vector, float] | None:
        """The diagonal of Λ (k − 1,) for a given b, and the cost that it allows."""
        k = self.k

        def parts(theta: Vector) -> tuple[Vector, Vector, Vector]:
            Theta, D = _positive(theta[k - 1 :], k - 1, 2)
            return np.diag(np.exp(theta[: k - 1])), Theta, D

        start = np.zeros(k - 1 + 2 * _count(k - 1))
        found = self._least(lambda theta: self.over_lqr(b, *parts(theta)), start)
        return None if found is None else (np.exp(found[0][: k - 1]), found[1])

    def _least(self, cost: Callable[[Vector], float], start: Vector) -> tuple[Vector, float] | None:
        """From scales of Θ and D, the last two of the matrices that θ holds."""
        count = _count(self.k - 1)
        diagonal = np.cumsum(np.arange(self.k - 1) + 1) - 1
        starts = []
        for scale in _SCALES:
            shifted = start.copy()
            for block in (2, 1):
                shifted[len(start) - block * count + diagonal] = np.log(scale) / 2
            starts.append(shifted)
        return least(cost, starts, _ENOUGH)


def mechanical_response(
    model: MechanicalModel, row: FreeRow, x_star: Mapping[sp.Symbol, sp.Expr], weigh: Weigh
) -> MechanicalResponse | None:
    """The linearised plant as a row without an input sees it; None where LQR does not hold it."""
    plant = model.plant
    sizes = natural_sizes(interconnect(plant, default_controller(plant)), (), x_star)
    response = _in_sizes(model, row, x_star, weigh, sizes)
    free = _free(model, x_star)
    for _ in range(_SETTLING):
        best = None if response is None else response.best
        if best is None or not free:
            break
        state = sizes.state.copy()
        ratio = np.abs(best[0] / best[0][row.r])
        units = sizes.units.state
        for a in free:
            seen = float(ratio[a] * units[a] / units[row.r] * state[row.r])
            state[a] = max(state[a], seen)
        if (state < _SETTLED * sizes.state).all():
            break
        sizes = replace(sizes, state=state)
        response = _in_sizes(model, row, x_star, weigh, sizes)
    return response


def _free(model: MechanicalModel, x_star: Mapping[sp.Symbol, sp.Expr]) -> list[int]:
    """Coordinates at 0 in which nothing of the plant repeats and that nobody gave a size.

    Their size is the one at which γ feels them.
    """
    plant = model.plant
    used = plant.drift.free_symbols | plant.directions.free_symbols
    return [
        a
        for a, s in enumerate(model.q)
        if s not in used and str(s) not in {*plant.sizes, *plant.domain} and x_star[s] == 0
    ]


def _in_sizes(
    model: MechanicalModel,
    row: FreeRow,
    x_star: Mapping[sp.Symbol, sp.Expr],
    weigh: Weigh,
    sizes: Sizes,
) -> MechanicalResponse | None:
    k = model.k
    target = linear_target(model.plant, x_star, sizes, weigh)
    if target is None:
        return None
    units = sizes.units
    q, p, time = units.state[:k], units.state[k : 2 * k], units.time
    g_perp = float_matrix(at(sp.Matrix(row.g_perp), x_star)).ravel() * q / q[row.r]
    slope = float_matrix(at(sp.Matrix(gradient(row.s, [model.q[row.r]])), x_star)).item()
    mass = float_matrix(at(sp.Matrix(model.mass), x_star)) * q / p[:, None] / time
    if not (np.isfinite(g_perp).all() and np.isfinite(mass).all() and np.isfinite(slope)):
        return None
    return MechanicalResponse(target, q, g_perp, slope * time**2, row.r, mass)


def _count(size: int) -> int:
    """Entries of a triangle."""
    return size * (size + 1) // 2


def _positive(theta: Vector, size: int, matrices: int) -> list[Vector]:
    """Positive definite matrices by their Cholesky factors, logarithms on the diagonal."""
    found = []
    for part in np.split(theta, matrices):
        L = np.zeros((size, size))
        L[np.tril_indices(size)] = part
        L[np.diag_indices(size)] = np.exp(np.diag(L))
        found.append(L @ L.T)
    return found
