"""Which stability the structure can reach at an assignable target.

With ∇V(z*) = 0 and P = ∇²V(z*) ≻ 0 the damped linearisation is Hurwitz iff (JP, [Rcl 𝒢]ᵀP) is
observable, J = Jcl(z*): JP has its spectrum on the imaginary axis, so every mode must be
touched by dissipation or by damping injection. One admissible P for which this holds proves that
asymptotic stability is within reach. "Only stable" needs a witness that no V can remove: a
Casimir with 𝒢ᵀ∇C ≡ 0, or a flat family of motions on which damping and dissipation vanish.
Dissipation that vanishes at z* may still reach what the linearisation leaves undamped.
"""

from __future__ import annotations

import random
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import sympy as sp

from necc_casadi.model.closed_loop import ClosedLoop
from necc_casadi.symbolic.derivatives import at, gradient, sparse_hessian
from necc_casadi.symbolic.finite_field import PRIMES, NoFiniteFieldValue, Residues
from necc_casadi.symbolic.linear_algebra import generic_rank, has_rank, kernel
from necc_casadi.symbolic.modular import null_basis, rational_rows
from necc_casadi.symbolic.observability import is_observable, observability_matrix
from necc_casadi.symbolic.zero import is_zero
from necc_casadi.verdict.vanishing_damping import vanishing_damping_attracts
from necc_casadi.verdict.verdict import ASYMPTOTIC, STABLE, Stability

__all__ = ["Assignment", "Reach", "reachable_stability"]


_SMALL = 14  # states beyond which a state-dependent kernel is not computed


#: What is said of convergence that the linearisation does not show.
_NO_RATE = (
    "convergence may be slower than exponential: the linearisation has a mode that is not damped, "
    "which only dissipation that vanishes at the target reaches"
)


@dataclass(frozen=True, eq=False)
class Assignment:
    """A target z* = (x*, ξ*) and multipliers that assign it."""

    loop: ClosedLoop
    functions: tuple[sp.Expr, ...]  # (r,) Casimirs c
    x_star: Mapping[sp.Symbol, sp.Expr]
    xi_star: tuple[sp.Expr, ...]  # (nc,)
    lam: tuple[sp.Expr, ...]  # (r,) λ with ∇H + Nλ = 0 and positive curvature, at ξ*
    directions: tuple[sp.Matrix, ...]  # basis of {λ : Nλ = 0}; a witness must not depend on them

    @cached_property
    def z_star(self) -> dict[sp.Symbol, sp.Expr]:
        """Value of every state."""
        return {**self.x_star, **dict(zip(self.loop.controller.xi, self.xi_star, strict=True))}

    @cached_property
    def damping(self) -> sp.Matrix:
        """[Rcl 𝒢], (n + nc) × (n + nc + 2m): what takes energy out of a motion."""
        return sp.Matrix.hstack(sp.Matrix(self.loop.R), sp.Matrix(self.loop.ports))

    def energy(self, lam: Sequence[sp.Expr]) -> sp.Expr:
        """H + λᵀc."""
        weighted = [w * c for w, c in zip(lam, self.functions, strict=True) if w != 0]
        return self.loop.plant.H + sp.Add(*weighted)


class Reach(NamedTuple):
    """The best stability within reach; where it is not exponential, what stands in the way."""

    stability: Stability | None = None
    witness: str | None = None


def reachable_stability(target: Assignment) -> Reach:
    """Which stability some damped V of the structure has at an assignable target."""
    silent = _undamped_casimir(target)
    if silent is not None:
        return Reach(STABLE, f"the Casimir {silent} is untouched by every input: its value stays")
    resting = _equilibrium_manifold(target)
    if resting:
        return Reach(
            STABLE,
            f"a {resting}-dimensional family of equilibria passes through the target, for every V: "
            "ker Jcl ∩ ker Rcl ∩ ker 𝒢ᵀ is not zero",
        )
    linear = _Linearisation(target)
    for seed, prime in enumerate(PRIMES):
        try:
            if len(linear.silent_part(prime, (seed,))) == 0 and linear.confirmed(seed):
                return Reach(ASYMPTOTIC)
            modes = linear.silent_modes(prime)
        except NoFiniteFieldValue:
            continue  # a root that occurs does not exist modulo this prime
        if modes is None:
            continue
        for plane in [modes, *[modes[:, k] for k in range(modes.cols) if modes.cols > 1]]:
            if _stays_undamped(target, plane):
                return Reach(STABLE, _motions(target, plane))
        break
    if vanishing_damping_attracts(target.loop, target.functions, target.z_star, linear.hessian(0)):
        return Reach(ASYMPTOTIC, _NO_RATE)
    return Reach(
        None,
        "the linearisation has a mode that neither dissipation nor damping injection touches; "
        "whether nonlinear damping reaches it is not decided",
    )


def _undamped_casimir(target: Assignment) -> sp.Expr | None:
    """A Casimir c with 𝒢ᵀ∇c ≡ 0."""
    ports = sp.SparseMatrix(target.loop.ports).T
    for c in target.functions:
        if all(is_zero(entry) for entry in ports * gradient(c, target.loop.z)):
            return c
    return None


def _equilibrium_manifold(target: Assignment) -> int:
    """Dimension of ker Jcl ∩ ker Rcl ∩ ker 𝒢ᵀ near z*, 0 where it is not proved to be constant.

    The states with ∇V in that kernel are equilibria of every damped loop; because ∇²V ≻ 0 and
    the kernel's dimension is constant near z*, they form a manifold of that dimension.
    """
    loop = target.loop
    still = sp.Matrix.vstack(sp.Matrix(loop.M), sp.Matrix(loop.ports).T)
    free = still.free_symbols
    generic = loop.n - generic_rank(still)
    if generic == 0 or (free and loop.n > _SMALL):
        return 0
    there = sp.Matrix(at(still, target.z_star)) if free else still
    if free and not has_rank(there, loop.n - generic):
        return 0
    return generic if kernel(still).cols == generic else 0


class _Linearisation:
    """J, [Rcl 𝒢] and the admissible Hessians at z*, over GF(p): full rank there is a proof.

    Irrational constants get the values of `finite_field`; their algebraic relations survive.
    """

    def __init__(self, target: Assignment) -> None:
        loop, z_star = target.loop, target.z_star
        self.plant_n, self.nc = loop.plant.n, loop.controller.nc
        self.J = sp.Matrix(at(loop.J, z_star))
        self.damping = sp.Matrix(at(target.damping, z_star))
        gradients = [at(gradient(c, loop.z), z_star) for c in target.functions]
        self.grad_c = sp.Matrix.hstack(*gradients) if gradients else None
        self.base = sp.Matrix(at(sparse_hessian(target.energy(target.lam), loop.z), z_star))

    def hessian(self, seed: int) -> sp.Matrix:
        """A random ∇²V(z*) = ∇²(H + Σλc) + ∇c S ∇cᵀ + ∇²Hc with S and ∇²Hc large and rational."""
        rng = random.Random(seed)
        P = sp.Matrix(self.base)
        if self.grad_c is not None:
            S = _random_positive(self.grad_c.cols, rng)
            P += sp.Matrix(sp.SparseMatrix(self.grad_c) * S * sp.SparseMatrix(self.grad_c).T)
        P[self.plant_n :, self.plant_n :] += _random_positive(self.nc, rng) * 7
        return P

    def silent_part(self, prime: int, seeds: Sequence[int]) -> Residues:
        """Basis over GF(p) of the motions that neither damping nor dissipation touches.

        The unobservable subspace of (JP, [Rcl 𝒢]ᵀP), common to the random P of all `seeds`. An
        empty one proves that a P with an observable pair exists.
        """
        rows = [
            observability_matrix(self.J, self.damping, self.hessian(seed), prime) for seed in seeds
        ]
        return null_basis(np.concatenate(rows), prime)

    def confirmed(self, seed: int) -> bool:
        """Whether observability over GF(p) is proved for the real matrices of one P."""
        return is_observable(self.J, self.damping, self.hessian(seed))

    def silent_modes(self, prime: int) -> sp.Matrix | None:
        """Plant directions of the motions that are silent for two random V, n × k, or None."""
        rows = rational_rows(self.silent_part(prime, (11, 12)), prime)
        if not rows or any(value != 0 for row in rows for value in row[self.plant_n :]):
            return None
        return sp.Matrix(rows)[:, : self.plant_n].T


def _random_positive(size: int, rng: random.Random) -> sp.Matrix:
    """A random symmetric positive definite integer matrix, diagonally dominant."""
    S = sp.zeros(size, size)
    for i in range(size):
        for j in range(i):
            S[i, j] = S[j, i] = sp.Integer(rng.randint(-9, 9))
    for i in range(size):
        S[i, i] = sp.Integer(10 * size + rng.randint(1, 99))
    return S


def _stays_undamped(target: Assignment, modes: sp.Matrix) -> bool:
    """Whether every V keeps the plane z* + modes (n × k) invariant and undamped.

    Along the plane ξ = ξ* and every Casimir is constant, so ∇V is Φ₁∇(H + λᵀc) less its value in
    ξ at z*, whatever K, Hc and Φ are. On it 𝒢ᵀ∇V and Rcl∇V must vanish and M∇V be tangent.
    """
    loop, n = target.loop, target.loop.plant.n
    s = sp.symbols([f"_s{k}" for k in range(modes.cols)], real=True)
    on_plane = target.z_star | {
        v: target.x_star[v] + sp.Add(*[modes[i, k] * s[k] for k in range(modes.cols)])
        for i, v in enumerate(loop.plant.x)
    }
    for c in target.functions:
        if any(is_zero(sp.diff(c.subs(on_plane, simultaneous=True), v)) is not True for v in s):
            return False
    slope = sp.Matrix(gradient(target.energy(_every_lambda(target)), loop.z))
    for i in range(n, loop.n):
        slope[i] -= slope[i].subs(target.z_star, simultaneous=True)
    there = slope.subs(on_plane, simultaneous=True)
    damped = target.damping.subs(on_plane, simultaneous=True).T * there
    motion = sp.Matrix(loop.M).subs(on_plane, simultaneous=True) * there
    normal = kernel(modes.T).T
    leaving = [*(normal * motion[:n, :]), *motion[n:, :], *damped]
    return all(is_zero(entry) is True for entry in leaving)


def _every_lambda(target: Assignment) -> list[sp.Expr]:
    """λ + Σ τᵢdᵢ, (r,), with symbols τ for what the gradient leaves free."""
    lam = list(target.lam)
    for k, d in enumerate(target.directions):
        tau = sp.Symbol(f"_tau{k}", real=True)
        lam = [w + tau * e for w, e in zip(lam, d, strict=True)]
    return lam


def _motions(target: Assignment, modes: sp.Matrix) -> str:
    moving = [
        str(v)
        for i, v in enumerate(target.loop.plant.x)
        if any(modes[i, k] != 0 for k in range(modes.cols))
    ]
    return f"motions of {', '.join(moving[:6])} that no input and no dissipation touches"
