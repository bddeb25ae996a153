"""Which stability the structure can reach at an assignable target.

With ∇V(z*) = 0 and P = ∇²V(z*) ≻ 0 the damped linearisation is Hurwitz iff (JP, [Rcl 𝒢]) is
controllable, J = Jcl(z*): JP has its spectrum on the imaginary axis, so every mode must be
touched by dissipation or by damping injection. One admissible P for which this holds proves that
asymptotic stability is within reach. "Only stable" needs a witness that no V can remove: a
Casimir with 𝒢ᵀ∇C ≡ 0, or a flat family of motions on which damping and dissipation vanish.
"""

from __future__ import annotations

import random
from collections.abc import Mapping, Sequence

import flint
import sympy as sp

from necc_casadi import exact as ex
from necc_casadi.loop import ClosedLoop
from necc_casadi.specialise import PRIMES, Unspecialised, values

__all__ = ["reachable_stability"]

_PRIME = PRIMES[0]
_TRIES = 3


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
    at = _Linearisation(loop, functions, x_star, xi_star, lam)
    for seed in range(_TRIES):
        if at.controllable(seed):
            return "asymptotic", None
    modes = at.silent_modes()
    if modes is not None:
        for plane in [modes, *[modes[:, k] for k in range(modes.cols) if modes.cols > 1]]:
            family = _invariant_family(loop, functions, x_star, xi_star, lam, directions, plane)
            if family is not None:
                return "stable", family
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
        if all(ex.is_zero(entry) for entry in rate):
            return c
    return None


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
        self.J = evaluated(loop.J, z_star)
        inputs = sp.Matrix.hstack(sp.Matrix(loop.R), sp.Matrix(loop.ports))
        self.inputs = evaluated(inputs, z_star)
        gradients = [
            [sp.diff(c, s) if s in c.free_symbols else sp.Integer(0) for s in loop.z]
            for c in functions
        ]
        self.grad_c = evaluated(sp.Matrix(gradients).T, z_star) if functions else None
        weighted = [w * c for w, c in zip(lam, functions, strict=True) if w != 0]
        energy = loop.plant.H + sp.Add(*weighted)
        self.base = evaluated(hessian(energy, loop.z), z_star)

    def admissible(self, seed: int) -> sp.Matrix:
        """A random ∇²V(z*) = ∇²(H + Σλc) + ∇c S ∇cᵀ + ∇²Hc with S and ∇²Hc large and rational."""
        rng = random.Random(seed)
        P = sp.Matrix(self.base)
        if self.grad_c is not None:
            S = _random_positive(self.grad_c.cols, rng)
            P += sp.Matrix(sp.SparseMatrix(self.grad_c) * S * sp.SparseMatrix(self.grad_c).T)
        nc = self.n - self.plant_n
        P[self.plant_n :, self.plant_n :] += _random_positive(nc, rng) * 7
        return P

    def controllable(self, seed: int) -> bool:
        """Whether (JP, [Rcl 𝒢]) is controllable for one admissible P."""
        return self._reached(self.admissible(seed)) == self.n

    def _reached(self, P: sp.Matrix) -> int:
        """Dimension that the inputs reach, over GF(p): a lower bound of the true one."""
        try:
            J, B, modular = (_residues(matrix) for matrix in (self.J, self.inputs, P))
        except Unspecialised:
            return 0
        A = J * modular
        span, block, reached = B, B, int(B.rank())
        while True:
            block = A * block
            span = _independent(_beside(span, block))
            block = span
            size = int(span.rank())
            if size == reached or size == self.n:
                return size
            reached = size

    def silent_modes(self) -> sp.Matrix | None:
        """Plant directions δx of the motions that neither damping nor dissipation touches, n × k.

        The directions common to two random admissible Hessians, when they leave ξ alone and are
        rational; None otherwise.
        """
        bases = []
        for seed in (11, 12):
            P = self.admissible(seed)
            rows = sp.Matrix(sp.SparseMatrix(self.inputs).T * sp.SparseMatrix(P))
            A = sp.SparseMatrix(self.J) * sp.SparseMatrix(P)
            if not all(e.is_Rational for e in [*rows, *A]):
                return None
            hidden = ex.kernel(rows)
            for _ in range(self.n):
                if hidden.cols == 0:
                    return None
                image = sp.Matrix(A) * hidden
                outside = ex.kernel(hidden.T).T
                kept = hidden * ex.kernel(outside * image) if outside.rows else hidden
                if kept.cols == hidden.cols:
                    break
                hidden = kept
            bases.append(hidden)
        first, second = bases
        joint = ex.kernel(first.row_join(-second))
        shared = first * joint[: first.cols, :]
        if shared.cols == 0 or not shared[self.plant_n :, :].is_zero_matrix:
            return None
        return shared[: self.plant_n, :]


def hessian(f: sp.Expr, variables: Sequence[sp.Symbol]) -> sp.Matrix:
    """∇²f; only pairs of variables that occur together are differentiated."""
    free = f.free_symbols
    entries: dict[tuple[int, int], sp.Expr] = {}
    for i, u in enumerate(variables):
        if u in free:
            slope = sp.diff(f, u)
            for j, v in enumerate(variables):
                if v in slope.free_symbols:
                    entries[i, j] = sp.diff(slope, v)
    return sp.Matrix(sp.SparseMatrix(len(variables), len(variables), entries))


def evaluated(matrix: sp.MatrixBase, point: Mapping[sp.Symbol, sp.Expr]) -> sp.Matrix:
    """`matrix` at a point."""
    entries = {}
    for place, entry in matrix.todok().items():
        known = {s: point[s] for s in entry.free_symbols}
        entries[place] = entry.subs(known) if known else entry
    return sp.Matrix(sp.SparseMatrix(*matrix.shape, entries))


def _random_positive(size: int, rng: random.Random) -> sp.Matrix:
    """A random symmetric positive definite integer matrix, diagonally dominant."""
    S = sp.zeros(size, size)
    for i in range(size):
        for j in range(i):
            S[i, j] = S[j, i] = sp.Integer(rng.randint(-9, 9))
    for i in range(size):
        S[i, i] = sp.Integer(10 * size + rng.randint(1, 99))
    return S


def _residues(matrix: sp.Matrix) -> object:
    table = values(list(matrix), 1, prime=_PRIME)[0]
    return flint.nmod_mat(matrix.rows, matrix.cols, [int(v) for v in table], _PRIME)


def _beside(left: object, right: object) -> object:
    rows = [a + b for a, b in zip(left.tolist(), right.tolist(), strict=True)]  # type: ignore[attr-defined]
    return flint.nmod_mat(len(rows), len(rows[0]), [int(v) for row in rows for v in row], _PRIME)


def _independent(matrix: object) -> object:
    """The columns' span in reduced form, without the zero columns."""
    reduced, size = matrix.transpose().rref()  # type: ignore[attr-defined]
    rows = reduced.tolist()[:size]
    return flint.nmod_mat(
        size, len(rows[0]), [int(v) for row in rows for v in row], _PRIME
    ).transpose()


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
        if any(ex.is_zero(sp.diff(c.subs(on_plane, simultaneous=True), v)) is not True for v in s):
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
    normal = ex.kernel(modes.T).T
    leaving = [*(normal * motion[: plant.n, :]), *motion[plant.n :, :], *damped]
    if not all(ex.is_zero(entry) is True for entry in leaving):
        return None
    moving = [
        str(v) for i, v in enumerate(plant.x) if any(modes[i, k] != 0 for k in range(modes.cols))
    ]
    return f"motions of {', '.join(moving[:6])} that no input and no dissipation touches"
