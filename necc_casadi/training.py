"""The training problem of eq. Loss as a smooth nonlinear program, solved by IPOPT.

    ε = ‖∇V(z*)‖ + ReLU(−λ_min(∇²V(z*) − aI))                                   eq. Loss

*Lifting* (:mod:`necc_casadi.lifting`). The 2-jets y of the networks at their inputs are decision
variables, tied to the weights by y = jet(θ, ξ*): every other function is small, and the Jacobian
has one dense row per entry of y.

*Hard form*, where the target is assignable with a within reach: ∇V(z*) = 0 and
∇²V(z*) − aI = LLᵀ; no eigenvalue and no norm is ever differentiated. Rows of ∇²V that no weight
moves are eliminated by a Schur complement. What is left to choose is the shape of V:

    min  tr(P⁻¹ LLᵀ) − 2 Σ log Lᵢᵢ + ½ ‖θ − θ₀‖²_Q

The first two terms are the log-det (Burg) divergence of ∇²V(z*) − aI from a reference stiffness
P: they ask for a well-conditioned Hessian of the plant's own size and keep L nonsingular, away
from the spurious stationary points of LLᵀ. The last term keeps the networks as smooth as their
random initialisation; hidden layers cost more than output layers, in which jets are linear, so
that the Gauss–Newton Hessian is accurate.

*Soft form*, for targets or curvatures out of reach: min s + t subject to ∇V(z*) = s w, wᵀw ≤ 1,
∇²V(z*) + (t − a)I = LLᵀ, s, t ≥ 0. Its minimum is the minimum of ε exactly.

*Shaped form* (:mod:`necc_casadi.shaping`). The hard form with a heavy objective over samples of the
domain, in rows u = A m + b that are affine in the weights m that move; the hidden layers are fixed
at their start and ξ* is held to its own, around which the samples lie. The Hessian is exact.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise

import casadi as ca
import numpy as np
import numpy.typing as npt

from necc_casadi.interrupts import interruptible
from necc_casadi.lifting import Lifting, Scales
from necc_casadi.lyapunov import Form, Terms
from necc_casadi.networks import KAPPA_MIN, Vector
from necc_casadi.outcome import Start
from necc_casadi.shaped_rows import Rows
from necc_casadi.shaping import Shaping, moving_weights, sharper

__all__ = ["Solution", "train"]

#: Up to this many weights the Hessian of the Lagrangian is exact, beyond it Gauss–Newton in θ.
EXACT_HESSIAN_WEIGHTS = 500
#: Weak pull of ξ* to its initial value: V may be invariant under translations of ξ.
XI_COST = 1e-2
#: Pull of ξ* where V is shaped over samples around its start: it moves only where it must.
SHAPED_XI_COST = 1e4
#: Quadratic parts start this much above their lower bound.
STIFFER = 1.1
#: A fixed entry of ∇V(z*) below this, in natural units, is rounding.
_ZERO = 1e-12
#: A start whose ε is below this has solved the hard form.
SOLVED = 1e-9

_IPOPT = {
    "print_time": False,
    "ipopt.print_level": 0,
    "ipopt.sb": "yes",
    # of the shape only: Newton steps make the constraints, so ε, exact to rounding
    "ipopt.tol": 1e-8,
    "ipopt.constr_viol_tol": 1e-12,
    "ipopt.acceptable_tol": 1e-7,
    "ipopt.max_iter": 500,
    # AMD: a fill-reducing ordering that keeps the dense Jacobian rows last.
    "ipopt.mumps_pivot_order": 0,
}

#: A constant initial matrix: the scaled one tends to zero with a linear objective, and pivots of
#: that size fill the factorisation.
_LIMITED_MEMORY = {
    "ipopt.tol": 1e-10,  # here the objective is ε itself
    "ipopt.hessian_approximation": "limited-memory",
    "ipopt.limited_memory_initialization": "constant",
}


#: A shape need not be optimal to many digits; the constraints are exact all the same.
_SHAPED = {
    "ipopt.tol": 1e-4,
    "ipopt.acceptable_tol": 1e-3,
    "ipopt.max_iter": 300,
    # the monotone barrier now and then stops at a narrow V, or wanders until the limit
    "ipopt.mu_strategy": "adaptive",
}


@dataclass(frozen=True, eq=False)
class Solution:
    """Best of all starts, and the outcome of each."""

    weights: Vector  # (form.size,)
    xi_star: Vector  # (nc,)
    loss: float  # ε of eq. Loss, recomputed from the weights
    starts: tuple[Start, ...]

    @property
    def solved(self) -> bool:
        """Whether ε vanishes to working precision."""
        return self.loss <= SOLVED

    @property
    def seconds(self) -> float:
        """Time inside IPOPT, all starts together."""
        return sum(start.seconds for start in self.starts)


def train(
    terms: Terms,
    form: Form,
    x_star: Vector,
    *,
    a: float,
    scales: Scales,
    seed: int = 0,
    starts: int = 1,
    xi_guess: Vector | None = None,
    kappa_min: float = KAPPA_MIN,
    stiffness: tuple[float, ...] | None = None,
    xi_cost: float = XI_COST,
    penalty: Callable[[ca.MX, ca.MX], ca.MX] | None = None,
    shaping: Shaping | None = None,
    report: Callable[[Start], None] | None = None,
    verbose: bool = False,
) -> Solution:
    """Minimise eq. Loss over the weights and ξ*.

    Each start runs the shaped form where one is asked for, then, as long as none is solved, the
    hard form and the soft form.

    Parameters
    ----------
    terms
        Symbolic terms of plant, controller and Casimirs.
    form
        Networks of V.
    x_star
        Target (n,).
    a
        Curvature asked of ∇²V(z*).
    scales
        Natural sizes; the published form is trained in the plant's own units.
    seed, starts
        Start i uses seed + i.
    xi_guess
        Where ξ* starts, (nc,); zeros by default. Later starts move away from it.
    kappa_min
        Least curvature of the quadratic parts, in natural units (energy/length²).
    stiffness
        Curvature of the quadratic part of each network, in natural units, where training starts
        and whose Hessian is the reference P; None: P is diagonal, of the plant's own size.
    xi_cost
        How strongly ξ* is pulled to where it starts.
    penalty
        (weights, ξ*) ↦ a further term of the objective, over as many sample points as it likes.
    shaping
        What is asked of V over samples of the domain, in the hard form; V must be affine in its
        output layers (Φ = H + Hc + C, joint form).
    report
        Called with the outcome of each start.
    verbose
        Print IPOPT's iterations.
    """
    guess = np.zeros(terms.nc) if xi_guess is None else np.asarray(xi_guess, float)
    lifting = Lifting(terms, form, np.asarray(x_star, float), scales, guess)
    results: list[tuple[Start, Vector, Vector]] = []
    forms = [(_hard, None), (_soft, None)]
    for make, shaped in forms if shaping is None else [(_hard, shaping), *forms]:
        program = make(lifting, a, stiffness)
        if program is None:
            continue
        bounds = (kappa_min, stiffness or (STIFFER * kappa_min,) * len(form.networks))
        solver = _Solver(lifting, program, a, bounds, xi_cost, penalty, shaped, verbose)
        for index in range(starts):
            results.append(solver.run(seed + index, away=index > 0))
            if report is not None:
                report(results[-1][0])
        if any(start.loss <= SOLVED for start, _, _ in results):
            break
    best, weights, xi_star = min(results, key=lambda result: _rank(result[0]))
    return Solution(weights, xi_star, best.loss, tuple(start for start, _, _ in results))


def _rank(start: Start) -> tuple[bool, float]:
    """Solved starts first, by the shape of V; the others by their loss."""
    solved = start.loss <= SOLVED
    return (not solved, start.objective if solved and start.mode != "soft" else start.loss)


# --- the two forms, in the lifted variables ------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Program:
    """Objective and constraints in the lifted variables and extra ones; networks come later."""

    mode: str  # "hard" or "soft"
    extra: ca.SX  # variables besides the lifted ones
    lower: Vector  # lower bounds of `extra`
    objective: ca.SX
    equalities: ca.SX  # = 0
    inequalities: ca.SX  # ≥ 0
    initial: Callable[[Vector], Vector]  # lifted variables -> start of `extra`


def _hard(lifting: Lifting, a: float, stiffness: tuple[float, ...] | None) -> _Program | None:
    """∇V(z*) = 0, ∇²V(z*) − aI = LLᵀ; None where no weight can satisfy that."""
    movable = _movable_rows(lifting, a)
    if movable is None:
        return None
    g, S, rows = movable
    pattern = _block_pattern(S)
    L, entries = _lower(pattern)
    P = lifting.scales.stiffness[rows]
    gap = ca.vertcat(*[(S - L @ L.T)[i, j] for i, j in pattern])
    value = ca.Function("S", [lifting.small], [S])
    reference = np.diag(P)
    if stiffness is not None:  # the quadratic parts are the reference: no network undoes them
        stiff = np.asarray(value(lifting.quadratic_only(stiffness)), float)
        reference = stiff if np.linalg.eigvalsh(stiff)[0] > 0 else reference
    inverse = ca.sparsify(ca.DM(np.linalg.inv(reference)))
    shape = ca.dot(inverse, L @ L.T) - 2 * ca.sum1(ca.log(ca.diag(L)))
    diagonal = np.array([i == j for i, j in pattern], bool)
    return _Program(
        mode="hard",
        extra=entries,
        lower=np.where(diagonal, 1e-8 * np.sqrt(P.max(initial=1.0)), -np.inf),
        objective=shape,
        equalities=ca.vertcat(g, gap),
        inequalities=ca.SX(0, 1),
        initial=lambda small: _on(pattern, _factor(np.asarray(value(small), float), P)),
    )


def _movable_rows(lifting: Lifting, a: float) -> tuple[ca.SX, ca.SX, list[int]] | None:
    """(rows of g, Schur complement of N − aI, its indices) that the design can move."""
    g, N, small = lifting.g, lifting.N, lifting.small
    n = g.numel()
    moves = ca.which_depends(ca.densify(ca.vertcat(g, ca.vec(N))), small, 1, True)
    fixed_g = [i for i in range(n) if not moves[i]]
    rows = [i for i in range(n) if any(moves[n + i * n : n + (i + 1) * n])]
    rest = [i for i in range(n) if i not in rows]
    w_hat = lifting.form.initial(np.random.default_rng(0))
    g0, N0 = lifting.at(lifting.small_at(w_hat, lifting.guess))
    size = lifting.scales.energy / lifting.scales.state
    if np.any(np.abs(g0[fixed_g]) > _ZERO * size[fixed_g]):
        return None
    A = N0[np.ix_(rest, rest)] - a * np.eye(len(rest))
    if len(rest) and np.linalg.eigvalsh(A)[0] <= 0:
        return None
    B = N0[np.ix_(rest, rows)]
    S = N[rows, rows] - a * ca.SX.eye(len(rows))
    if B.any():
        S -= ca.sparsify(ca.DM(B.T @ np.linalg.solve(A, B)))
    return ca.vertcat(*[g[i] for i in range(n) if moves[i]]), ca.sparsify(S), rows


def _soft(lifting: Lifting, a: float, _: tuple[float, ...] | None) -> _Program:
    """Minimise s + t with ∇V(z*) = s w, wᵀw ≤ 1, ∇²V(z*) + (t − a)I = LLᵀ: ε exactly."""
    n = lifting.g.numel()
    s, t, w = ca.SX.sym("s"), ca.SX.sym("t"), ca.SX.sym("w", n)
    pattern = _block_pattern(lifting.N)
    L, entries = _lower(pattern)
    shifted = lifting.N + (t - a) * ca.SX.eye(n)
    gap = ca.vertcat(*[(shifted - L @ L.T)[i, j] for i, j in pattern])

    def initial(small: Vector) -> Vector:
        g0, N0 = lifting.at(small)
        s0 = max(float(np.linalg.norm(g0)), 1e-3)
        t0 = max(0.0, a - np.linalg.eigvalsh(N0)[0]) + 0.1 * a
        factor = np.linalg.cholesky(N0 + (t0 - a) * np.eye(n))
        return np.concatenate([[s0, t0], g0 / s0, _on(pattern, factor)])

    return _Program(
        mode="soft",
        extra=ca.vertcat(s, t, w, entries),
        lower=np.concatenate([[0.0, 0.0], np.full(n + len(pattern), -np.inf)]),
        objective=s + t,
        equalities=ca.vertcat(lifting.g - s * w, gap),
        inequalities=1 - ca.sumsqr(w),
        initial=initial,
    )


def _block_pattern(S: ca.SX) -> list[tuple[int, int]]:
    """Lower-triangular entries of the diagonal blocks of S, dense within each block."""
    size = S.shape[0]
    pattern = S.sparsity().unite(ca.Sparsity.diag(size))
    _, order, ends = pattern.scc() if size else (0, [], [0])
    blocks = [sorted(order[a:b]) for a, b in pairwise(ends)]
    return [(i, j) for block in blocks for i in block for j in block if j <= i]


def _lower(pattern: list[tuple[int, int]]) -> tuple[ca.SX, ca.SX]:
    """A lower-triangular matrix of symbols on `pattern`, and the vector of its entries."""
    size = 1 + max((i for i, _ in pattern), default=-1)
    entries = ca.SX.sym("l", len(pattern))
    L = ca.SX(size, size)
    for index, (i, j) in enumerate(pattern):
        L[i, j] = entries[index]
    return L, entries


def _on(pattern: list[tuple[int, int]], matrix: Vector) -> Vector:
    """The entries of `matrix` on `pattern`."""
    return np.array([matrix[i, j] for i, j in pattern], float)


def _factor(S: Vector, P: Vector) -> Vector:
    """A nonsingular Cholesky factor to start from: of S, its eigenvalues relative to P lifted."""
    root = np.sqrt(P)
    values, vectors = np.linalg.eigh(S / np.outer(root, root)) if len(P) else (P, np.eye(0))
    lifted = (vectors * np.maximum(values, 0.1)) @ vectors.T * np.outer(root, root)
    return np.linalg.cholesky(lifted)


# --- the whole program, with the networks --------------------------------------------------------


class _Solver:
    """One NLP in (lifted variables, extra variables, ŵ), compiled once and run from many starts."""

    def __init__(
        self,
        lifting: Lifting,
        program: _Program,
        a: float,
        kappa: tuple[float, tuple[float, ...]],  # least; where each quadratic part starts
        xi_cost: float,
        penalty: Callable[[ca.MX, ca.MX], ca.MX] | None,
        shaping: Shaping | None,
        verbose: bool,
    ) -> None:
        program = _with_level(program) if shaping is not None and shaping.has_level else program
        self.lifting, self.program, self.a = lifting, program, a
        self.kappa_min, self.stiffness = kappa
        self.shaping = shaping
        self.xi_cost = xi_cost if shaping is None else SHAPED_XI_COST
        small = ca.vertcat(lifting.small, program.extra)
        core = ca.Function(
            "core", [small], [program.objective, program.equalities, program.inequalities]
        )
        self.n_small = small.numel()
        n_lifted, nc = lifting.small.numel(), lifting.terms.nc
        s, w = ca.MX.sym("s", self.n_small), ca.MX.sym("w", lifting.form.size)
        start = ca.MX.sym("start", nc + lifting.form.size)
        f, equal, unequal = core(s)
        weights = ca.DM(lifting.sigma) * w + ca.DM(lifting.tau)
        if program.mode == "hard":
            f = f + self._proximity(s, w, start)
        if penalty is not None:
            f = f + penalty(weights, s[:nc])
        rows = Rows(shaping, lifting, w, s[-1]) if shaping is not None else None
        p = start if rows is None else ca.vertcat(start, rows.parameters)
        g = ca.vertcat(lifting.residuals(weights, s[:n_lifted]), equal, unequal)
        slopes = {}
        if rows is not None:
            slopes = rows.first_derivative(s, w, p, g)
            f, unequal = f + rows.objective, ca.vertcat(unequal, rows.margins)
            g = ca.vertcat(g, rows.margins)
        self.g_upper = np.zeros(g.numel())
        self.g_upper[g.numel() - unequal.numel() :] = np.inf
        self.lower = np.concatenate(
            [
                np.full(n_lifted, -np.inf),
                program.lower,
                *[network.lower(self.kappa_min) for network in lifting.form.networks],
            ]
        )
        many = lifting.form.size > EXACT_HESSIAN_WEIGHTS
        first_order = program.mode == "soft" or (penalty is not None and many)
        options = _IPOPT | (_LIMITED_MEMORY if first_order else self._hessian(s, w, p, f, g, rows))
        if rows is not None:
            options |= _SHAPED | slopes
        if verbose:
            options |= {"ipopt.print_level": 5}
        problem = {"x": ca.vertcat(s, w), "p": p, "f": f, "g": g}
        self.solver = ca.nlpsol("train", "ipopt", problem, options)

    def _cost(self) -> ca.DM:
        """Diagonal of Q."""
        return ca.DM(np.concatenate([network.cost for network in self.lifting.form.networks]))

    def _proximity(self, s: ca.MX, w: ca.MX, start: ca.MX) -> ca.MX:
        """½ ‖θ − θ₀‖²_Q and the weak pull on ξ*."""
        nc = self.lifting.terms.nc
        pull = ca.sumsqr((s[:nc] - start[:nc]) / ca.DM(self.lifting.scales.state[-nc:]))
        return (ca.dot(self._cost(), (w - start[nc:]) ** 2) + self.xi_cost * pull) / 2

    def _hessian(
        self, s: ca.MX, w: ca.MX, p: ca.MX, f: ca.MX, g: ca.MX, rows: Rows | None
    ) -> dict[str, object]:
        """Exact second derivatives for few weights; for many, Gauss–Newton in θ.

        With `rows` the hidden layers are fixed and everything is affine in θ but the rows' sum.
        """
        if self.lifting.form.size <= EXACT_HESSIAN_WEIGHTS and rows is None:
            return {}
        multiplier_f, multiplier_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", g.numel())
        gradient = ca.gradient(multiplier_f * f + ca.dot(multiplier_g, g), s)
        corner, cross = ca.jacobian(gradient, s), ca.jacobian(gradient, w)
        theta = ca.diag(self._cost()) if rows is None else ca.diag(self._cost()) + rows.curvature
        hessian = ca.blockcat([[corner, cross], [cross.T, multiplier_f * theta]])
        inputs = [ca.vertcat(s, w), p, multiplier_f, multiplier_g]
        return {"hess_lag": ca.Function("hess_lag", inputs, [ca.triu(hessian)])}

    def run(self, seed: int, away: bool) -> tuple[Start, Vector, Vector]:
        """Solve from the random initialisation `seed`: (outcome, weights, ξ*)."""
        lifting, nc = self.lifting, self.lifting.terms.nc
        rng = np.random.default_rng(seed)
        w0 = lifting.form.initial(rng)
        if self.shaping is not None and self.shaping.has_level:
            w0 *= sharper(lifting.form)
        spread = 0.5 * lifting.scales.state[-nc:] if away else np.zeros(nc)
        xi0 = lifting.guess + rng.normal(0.0, 1.0, nc) * spread
        w0 = lifting.centred(w0, xi0, self.stiffness)
        small = lifting.small_at(w0, xi0)
        first, p = self.program.initial(small), np.concatenate([xi0, w0])
        lower, upper = self.lower, np.full(self.lower.size, np.inf)
        if self.shaping is not None:
            A, b, moving = self._sampled(self.shaping, w0, xi0)
            level = self.shaping.first_level(A @ w0[moving] + b)
            first = np.concatenate([first[: first.size - level.size], level])
            p = np.concatenate([p, A.ravel(order="F"), b])
            fixed = self.n_small + np.setdiff1d(np.arange(w0.size), moving)
            lower = lower.copy()
            lower[fixed] = upper[fixed] = w0[fixed - self.n_small]
        began = time.perf_counter()
        with interruptible():
            result = self.solver(
                x0=np.concatenate([small, first, w0]),
                p=p,
                lbx=lower,
                ubx=upper,
                lbg=0,
                ubg=self.g_upper,
            )
        seconds = time.perf_counter() - began
        solution = np.asarray(result["x"], float).ravel()
        weights = lifting.sigma * solution[self.n_small :] + lifting.tau
        xi_star = solution[:nc]
        stats = self.solver.stats()
        start = Start(
            seed=seed,
            mode="shaped" if self.shaping is not None else self.program.mode,
            status=str(stats["return_status"]),
            iterations=int(stats["iter_count"]),
            seconds=seconds,
            objective=float(result["f"]),
            loss=lifting.loss(weights, xi_star, self.a),
        )
        return start, weights, xi_star

    def _sampled(
        self, shaping: Shaping, w0: Vector, xi0: Vector
    ) -> tuple[Vector, Vector, npt.NDArray[np.int_]]:
        """(A, b, moving) of u = A ŵ[moving] + b, for hidden layers and samples at this start."""
        lifting = self.lifting
        moving = moving_weights(lifting.form)
        weights, z_star = lifting.sigma * w0 + lifting.tau, np.concatenate([lifting.x_star, xi0])
        A, b = shaping.rows(lifting.terms, lifting.form, weights, z_star)
        return A * lifting.sigma[moving], b + A @ lifting.tau[moving], moving


def _with_level(program: _Program) -> _Program:
    """The program with the level c as its last variable; where it starts is set later."""
    return replace(
        program,
        extra=ca.vertcat(program.extra, ca.SX.sym("c")),
        lower=np.append(program.lower, -np.inf),
        initial=lambda small: np.append(program.initial(small), 0.0),
    )
