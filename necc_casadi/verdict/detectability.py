"""Which stability the structure can reach at an assignable target.

With ∇V(z*) = 0 and P = ∇²V(z*) ≻ 0 the damped linearisation is Hurwitz iff (JP, [Rcl 𝒢]ᵀP) is
observable, J = Jcl(z*): JP has its spectrum on the imaginary axis, so every mode must be
touched by dissipation or by damping injection. One admissible P for which this holds proves that
asymptotic stability is within reach. "Only stable" needs a witness that no V can remove: a
Casimir with 𝒢ᵀ∇C ≡ 0, or a flat family of motions on which damping and dissipation vanish.
"""

from __future__ import annotations

import random
from collections.abc import Mapping, Sequence

import flint
import numpy as np
import sympy as sp

from necc_casadi.model.closed_loop import ClosedLoop
from necc_casadi.symbolic.derivatives import at, gradient, sparse_hessian
from necc_casadi.symbolic.finite_field import PRIMES, NoFiniteFieldValue, Residues
from necc_casadi.symbolic.linear_algebra import generic_rank, has_rank, kernel
from necc_casadi.symbolic.modular import null_basis, rational_rows
from necc_casadi.symbolic.observability import (
    as_balls,
    certain_rank,
    observability_matrix,
    residues,
)
from necc_casadi.symbolic.zero import is_zero

__all__ = ["reachable_stability"]


_BITS = 1000


_SMALL = 14  # states beyond which a state-dependent kernel is not computed


def reachable_stability(
    loop: ClosedLoop,
    functions: Sequence[sp.Expr],
    x_star: Mapping[sp.Symbol, sp.Expr],
    xi_star: Sequence[sp.Expr],
    lam: Sequence[sp.Expr],
    directions: Sequence[sp.Matrix],
) -> tuple[str | None, str | None]:
    """(``asymptotic`` | ``stable`` | None, witness or what is missing).

    Parameters
    ----------
    functions
        Casimirs c.
    lam
        λ with ∇H + Nλ = 0 and positive curvature, at ξ*.
    directions
        Basis of {λ : Nλ = 0}; the witness must not depend on them.
    """
    silent = _undamped_casimir(loop, functions)
    if silent is not None:
        return "stable", f"the Casimir {silent} is untouched by every input: its value stays"
    resting = _equilibrium_manifold(
        loop, {**x_star, **dict(zip(loop.controller.xi, xi_star, strict=True))}
    )
    if resting:
        return "stable", (
            f"a {resting}-dimensional family of equilibria passes through the target, for every V: "
            "ker Jcl ∩ ker Rcl ∩ ker 𝒢ᵀ is not zero"
        )
    at_target = _Linearisation(loop, functions, x_star, xi_star, lam)
    for seed, prime in enumerate(PRIMES):
        try:
            if len(at_target.silent_part(prime, (seed,))) == 0 and at_target.confirmed(seed):
                return "asymptotic", None
            modes = at_target.silent_modes(prime)
        except NoFiniteFieldValue:
            continue  # a root that occurs does not exist modulo this prime
        if modes is None:
            continue
        for plane in [modes, *[modes[:, k] for k in range(modes.cols) if modes.cols > 1]]:
            family = _invariant_family(loop, functions, x_star, xi_star, lam, directions, plane)
            if family is not None:
                return "stable", family
        break
    return None, (
        "the linearisation has a mode that neither dissipation nor damping injection touches; "
        "whether nonlinear damping reaches it is not decided"
    )


def _undamped_casimir(loop: ClosedLoop, functions: Sequence[sp.Expr]) -> sp.Expr | None:
    for c in functions:
        free = c.free_symbols
        rate = [
            sp.Add(*[loop.ports[i, j] * sp.diff(c, s) for i, s in enumerate(loop.z) if s in free])
            for j in range(loop.ports.cols)
        ]
        if all(is_zero(entry) for entry in rate):
            return c
    return None


def _equilibrium_manifold(loop: ClosedLoop, z_star: Mapping[sp.Symbol, sp.Expr]) -> int:
    """Dimension of ker Jcl ∩ ker Rcl ∩ ker 𝒢ᵀ near z*, 0 where it is not proved to be constant.

    The states with ∇V in that kernel are equilibria of every damped loop; because ∇²V ≻ 0 and
    the kernel's dimension is constant near z*, they form a manifold of that dimension.
    """
    still = sp.Matrix.vstack(sp.Matrix(loop.M), sp.Matrix(loop.ports).T)
    free = still.free_symbols
    generic = loop.n - generic_rank(still)
    if generic == 0 or (free and loop.n > _SMALL):
        return 0
    there = sp.Matrix(at(still, z_star)) if free else still
    if free and not has_rank(there, loop.n - generic):
        return 0
    return generic if kernel(still).cols == generic else 0


class _Linearisation:
    """J, Rcl, 𝒢 and the admissible Hessians at z*, over GF(p): full rank there is a proof.

    Irrational constants get the values of `specialise`; their algebraic relations survive.
    """

    def __init__(
        self,
        loop: ClosedLoop,
        functions: Sequence[sp.Expr],
        x_star: Mapping[sp.Symbol, sp.Expr],
        xi_star: Sequence[sp.Expr],
        lam: Sequence[sp.Expr],
    ) -> None:
        z_star = {**x_star, **dict(zip(loop.controller.xi, xi_star, strict=True))}
        self.n, self.plant_n = loop.n, loop.plant.n
        self.J = sp.Matrix(at(loop.J, z_star))
        inputs = sp.Matrix.hstack(sp.Matrix(loop.R), sp.Matrix(loop.ports))
        self.inputs = sp.Matrix(at(inputs, z_star))
        gradients = [at(gradient(c, loop.z), z_star) for c in functions]
        self.grad_c = sp.Matrix.hstack(*gradients) if gradients else None
        weighted = [w * c for w, c in zip(lam, functions, strict=True) if w != 0]
        energy = loop.plant.H + sp.Add(*weighted)
        self.base = sp.Matrix(at(sparse_hessian(energy, loop.z), z_star))

    def hessian(self, seed: int) -> sp.Matrix:
        """A random ∇²V(z*) = ∇²(H + Σλc) + ∇c S ∇cᵀ + ∇²Hc with S and ∇²Hc large and rational."""
        rng = random.Random(seed)
        P = sp.Matrix(self.base)
        if self.grad_c is not None:
            S = _random_positive(self.grad_c.cols, rng)
            P += sp.Matrix(sp.SparseMatrix(self.grad_c) * S * sp.SparseMatrix(self.grad_c).T)
        nc = self.n - self.plant_n
        P[self.plant_n :, self.plant_n :] += _random_positive(nc, rng) * 7
        return P

    def silent_part(self, prime: int, seeds: Sequence[int]) -> Residues:
        """Basis over GF(p) of the motions that neither damping nor dissipation touches.

        The unobservable subspace of (JP, [Rcl 𝒢]ᵀP), common to the random P of all `seeds`. An
        empty one proves that a P with an observable pair exists.
        """
        rows = []
        for seed in seeds:
            J, B, P = (
                residues(matrix, prime) for matrix in (self.J, self.inputs, self.hessian(seed))
            )
            rows.append(observability_matrix(J * P, B.transpose() * P, prime))
        return null_basis(np.concatenate(rows), prime)

    def confirmed(self, seed: int) -> bool:
        """Whether observability over GF(p) is proved for the real matrices of one P.

        For rational entries full rank over GF(p) is a proof. For others GF(p) may miss a relation
        between constants, so that Arb balls have to find n certain pivots.
        """
        matrices = (self.J, self.inputs, self.hessian(seed))
        if all(e.is_Rational for matrix in matrices for e in matrix.todok().values()):
            return True
        previous, flint.ctx.prec = flint.ctx.prec, _BITS
        try:
            J, B, P = (as_balls(matrix) for matrix in matrices)
            return certain_rank(J * P, B.transpose() * P) == self.n
        finally:
            flint.ctx.prec = previous

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


def _invariant_family(
    loop: ClosedLoop,
    functions: Sequence[sp.Expr],
    x_star: Mapping[sp.Symbol, sp.Expr],
    xi_star: Sequence[sp.Expr],
    lam: Sequence[sp.Expr],
    directions: Sequence[sp.Matrix],
    modes: sp.Matrix,
) -> str | None:
    """The plane z* + modes, if every V keeps it invariant and undamped; in words.

    Along the plane ξ = ξ* and every Casimir is constant, so ∇V is Φ₁∇(H + λᵀc) less its value in
    ξ at z*, whatever K, Hc and Φ are. On it 𝒢ᵀ∇V and Rcl∇V must vanish and M∇V be tangent.
    """
    plant, xi = loop.plant, dict(zip(loop.controller.xi, xi_star, strict=True))
    tau = sp.symbols(f"_tau0:{len(directions)}", real=True)
    weights = list(lam)
    for t, d in zip(tau, directions, strict=True):
        weights = [w + t * e for w, e in zip(weights, d, strict=True)]
    s = sp.symbols(f"_s0:{modes.cols}", real=True)
    plane = {
        v: x_star[v] + sp.Add(*[modes[i, k] * s[k] for k in range(modes.cols)])
        for i, v in enumerate(plant.x)
    }
    on_plane = {**plane, **xi}
    for c in functions:
        if any(is_zero(sp.diff(c.subs(on_plane, simultaneous=True), v)) is not True for v in s):
            return None
    W = plant.H + sp.Add(*[w * c for w, c in zip(weights, functions, strict=True)])
    slope = sp.Matrix([sp.diff(W, v) for v in loop.z])
    start = {**x_star, **xi}
    for i in range(plant.n, loop.n):
        slope[i] -= slope[i].subs(start, simultaneous=True)
    gradient = slope.subs(on_plane, simultaneous=True)
    damping = sp.Matrix.hstack(sp.Matrix(loop.R), sp.Matrix(loop.ports))
    damped = damping.subs(on_plane, simultaneous=True).T * gradient
    motion = loop.M.subs(on_plane, simultaneous=True) * gradient
    normal = kernel(modes.T).T
    leaving = [*(normal * motion[: plant.n, :]), *motion[plant.n :, :], *damped]
    if not all(is_zero(entry) is True for entry in leaving):
        return None
    moving = [
        str(v) for i, v in enumerate(plant.x) if any(modes[i, k] != 0 for k in range(modes.cols))
    ]
    return f"motions of {', '.join(moving[:6])} that no input and no dissipation touches"
