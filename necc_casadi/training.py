"""The training problem of eq. Loss as a smooth nonlinear program, solved by IPOPT.

    ε = ‖∇V(z*)‖ + ReLU(−λ_min(∇²V(z*) − aI))                                   eq. Loss

*Lifting.* V depends on the weights θ, at z*, only through the 2-jets y (value, gradient,
Hessian) of each network at its input. With y as decision variables, tied to the networks by
y = jet(θ, ξ*), every other function is small and independent of the networks' size, and the
Jacobian has one dense row per entry of y.

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
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import casadi as ca
import numpy as np

from necc_casadi.lyapunov import Form, Terms, value
from necc_casadi.networks import MonotonePhi, Network, Vector
from necc_casadi.outcome import Start

__all__ = ["Scales", "Solution", "train"]

#: Up to this many weights the Hessian of the Lagrangian is exact, beyond it Gauss–Newton in θ.
EXACT_HESSIAN_WEIGHTS = 500
#: Weak pull of ξ* to its initial value: V may be invariant under translations of ξ.
XI_COST = 1e-2
#: A start whose ε is below this has solved the hard form.
SOLVED = 1e-9

_IPOPT = {
    "print_time": False,
    "ipopt.print_level": 0,
    "ipopt.sb": "yes",
    "ipopt.tol": 1e-10,
    "ipopt.constr_viol_tol": 1e-12,
    "ipopt.acceptable_tol": 1e-7,
    "ipopt.max_iter": 500,
    # AMD: a fill-reducing ordering that keeps the dense Jacobian rows last.
    "ipopt.mumps_pivot_order": 0,
}


@dataclass(frozen=True)
class Scales:
    """Natural sizes of a plant, from its domain and its energy: units do not matter."""

    state: Vector  # (n + nc,) size of each state
    energy: float  # size of H

    @property
    def stiffness(self) -> Vector:
        """Diagonal of the reference stiffness P, energy/state²."""
        return self.energy / self.state**2


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
    report: Callable[[Start], None] | None = None,
    verbose: bool = False,
) -> Solution:
    """Minimise eq. Loss over the weights and ξ*.

    Each start runs the hard form; if none solves it, the soft form runs from each start.

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
    report
        Called with the outcome of each start.
    verbose
        Print IPOPT's iterations.
    """
    guess = np.zeros(terms.nc) if xi_guess is None else np.asarray(xi_guess, float)
    problem = _Problem(terms, form, np.asarray(x_star, float), a, scales, guess)
    results: list[tuple[Start, Vector, Vector]] = []
    for make_solver in (problem.hard, problem.soft):
        solver = make_solver(verbose)
        if solver is None:
            continue
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
    return (not solved, start.objective if solved and start.mode == "hard" else start.loss)


@dataclass(frozen=True, eq=False)
class _Jet:
    """Lifted 2-jet of one network at its input: value, gradient and upper Hessian."""

    base: ca.SX  # input of the network at z*, (d,), in the lifted variables
    y: ca.SX  # (1 + d + d(d + 1)/2,)

    def model(self, v: ca.SX) -> ca.SX:
        """The network's second-order Taylor polynomial around its input at z*."""
        d = self.base.numel()
        hessian = _symmetric(self.y[1 + d :], d)
        step = v - self.base
        return self.y[0] + ca.dot(self.y[1 : 1 + d], step) + ca.bilin(hessian, step, step) / 2


def _symmetric(upper: ca.SX, d: int) -> ca.SX:
    matrix = ca.SX(d, d)
    for index, (i, j) in enumerate(_upper(d)):
        matrix[i, j] = matrix[j, i] = upper[index]
    return matrix


def _upper(d: int) -> list[tuple[int, int]]:
    return [(i, j) for i in range(d) for j in range(i, d)]


def _jet_function(network: Network | MonotonePhi) -> ca.Function:
    """(weights, input) -> 2-jet of the network, in the layout of :class:`_Jet`."""
    w, v = ca.MX.sym("w", network.size), ca.MX.sym("v", network.inputs)
    f = network(w, v)
    hessian, gradient = ca.hessian(f, v)
    entries = [hessian[i, j] for i, j in _upper(network.inputs)]
    return ca.Function("jet", [w, v], [ca.vertcat(f, gradient, *entries)])


class _Problem:
    """Everything that hard and soft form share: lifted variables, ∇V(z*), ∇²V(z*)."""

    def __init__(
        self, terms: Terms, form: Form, x_star: Vector, a: float, scales: Scales, guess: Vector
    ) -> None:
        self.terms, self.form, self.x_star, self.a = terms, form, x_star, a
        self.scales, self.guess = scales, guess
        self.jet_functions = [_jet_function(network) for network in form.networks]
        self.xi = ca.SX.sym("xi", terms.nc)
        self.jets = self._lift()
        self.small = ca.vertcat(self.xi, *[jet.y for jet in self.jets])
        self.bases = ca.Function("bases", [self.small], [jet.base for jet in self.jets])
        self.g, self.N = self._derivatives()
        self.sigma, self.tau = self._units()

    def _lift(self) -> list[_Jet]:
        """One jet per network, in the order of ``form.networks``."""
        form, z_star = self.form, ca.vertcat(ca.SX(self.x_star), self.xi)

        def jet(name: str, base: ca.SX) -> _Jet:
            d = base.numel()
            return _Jet(base, ca.SX.sym(name, 1 + d + d * (d + 1) // 2))

        hc, c = jet("hc", self.xi), self.terms.c(z_star)
        betas = [jet(f"beta{i + 1}", c[i]) for i in range(len(form.betas))]
        k = jet("k", sum(beta.y[0] for beta in betas) if betas else c)
        jets = [hc, k, *betas]
        if form.phi is not None:
            energy = self.terms.H(ca.SX(self.x_star)) + hc.y[0]
            jets.append(jet("phi", ca.vertcat(energy, k.y[0])))
        return jets

    def _derivatives(self) -> tuple[ca.SX, ca.SX]:
        """∇V(z*) and ∇²V(z*) in the lifted variables."""
        hc, k, *rest = self.jets
        betas = rest[: len(self.form.betas)]

        def casimir(c: ca.SX) -> ca.SX:
            return k.model(sum(b.model(c[i]) for i, b in enumerate(betas)) if betas else c)

        def outer(energy: ca.SX, C: ca.SX) -> ca.SX:
            phi = self.form.phi
            return energy + C if phi is None else rest[-1].model(ca.vertcat(energy, C))

        z = ca.SX.sym("z", self.terms.n + self.terms.nc)
        V = value(self.terms, z, hc.model, casimir, outer)
        N, g = ca.hessian(V, z)
        at_target = ca.vertcat(ca.SX(self.x_star), self.xi)
        return tuple(ca.substitute([g, N], [z], [at_target]))

    def _units(self) -> tuple[Vector, Vector]:
        """Weights = σ∘ŵ + τ: the networks see inputs and energies of order one."""
        z = ca.SX.sym("z", self.terms.n + self.terms.nc)
        slope = ca.Function("dc", [z], [ca.jacobian(self.terms.c(z), z)])
        sizes = np.abs(np.asarray(slope(np.concatenate([self.x_star, self.guess])), float))
        c_size = (sizes * self.scales.state).max(axis=1, initial=0.0)
        c_size[c_size == 0] = 1.0
        form, energy = self.form, self.scales.energy
        pairs = [form.hc.units(self.scales.state[self.terms.n :], energy)]
        pairs.append(form.k.units(np.ones(1) if form.betas else c_size, energy))
        pairs += [beta.units(c_size[i : i + 1], 1.0) for i, beta in enumerate(form.betas)]
        if form.phi is not None:
            pairs.append(form.phi.units(np.ones(2), energy))
        return np.concatenate([p[0] for p in pairs]), np.concatenate([p[1] for p in pairs])

    def residuals(self, w: ca.MX, small: ca.MX) -> ca.MX:
        """Y − jet(θ, ξ*), the rows that tie lifted variables to networks."""
        bases = self.bases.call([small])
        parts = self.form.split(w)
        jets = [f(p, b) for f, p, b in zip(self.jet_functions, parts, bases, strict=True)]
        return small[self.terms.nc :] - ca.vertcat(*jets)

    def jets_at(self, w: Vector, xi: Vector) -> Vector:
        """Lifted variables (ξ, y) that weights w imply at ξ* = xi."""
        parts = self.form.split(w)
        order = [
            0,
            *range(2, 2 + len(self.form.betas)),
            1,
            *range(2 + len(self.form.betas), len(parts)),
        ]
        starts = np.cumsum([self.terms.nc, *[jet.y.numel() for jet in self.jets]])
        small = np.concatenate([xi, np.zeros(starts[-1] - self.terms.nc)])
        for index in order:  # inner networks before those that take their values
            base = self.bases.call([small])[index]
            jet = self.jet_functions[index](parts[index], base)
            small[starts[index] : starts[index + 1]] = np.asarray(jet).ravel()
        return small

    def loss(self, w: Vector, xi: Vector) -> float:
        """ε of eq. Loss from weights and ξ*, by eigenvalues."""
        evaluate = ca.Function("gN", [self.small], [self.g, self.N])
        g, N = (np.asarray(v, float) for v in evaluate(self.jets_at(w, xi)))
        return float(np.linalg.norm(g) + max(0.0, self.a - np.linalg.eigvalsh(N)[0]))

    def small_at(self, w_hat: Vector, xi: Vector) -> Vector:
        """Lifted variables of dimensionless weights ŵ at ξ* = xi."""
        return self.jets_at(self.sigma * w_hat + self.tau, xi)

    def centred(self, w_hat: Vector, xi: Vector) -> Vector:
        """ŵ with the centres of the quadratic parts at the networks' inputs at z*."""
        w_hat = w_hat.copy()
        bases = self.bases.call([self.small_at(w_hat, xi)])
        parts, units = self.form.split(w_hat), self.form.split(self.sigma)
        for network, part, unit, base in zip(self.form.networks, parts, units, bases, strict=True):
            if isinstance(network, Network) and network.quadratic:
                d = network.inputs
                part[-d:] = np.asarray(base, float).ravel() / unit[-d:]
        return w_hat

    def hard(self, verbose: bool) -> _Solver | None:
        """∇V(z*) = 0, ∇²V(z*) − aI = LLᵀ; None where no weight can satisfy that."""
        start = self.small_at(self.form.initial(np.random.default_rng(0)), self.guess)
        split = self._movable_rows(start)
        if split is None:
            return None
        g, S, rows = split
        pattern = _block_pattern(S)
        L, entries = _lower(pattern)
        P = self.scales.stiffness[rows]
        gap = ca.vertcat(*[(S - L @ L.T)[i, j] for i, j in pattern])
        shape = ca.dot(ca.diag(L @ L.T), 1 / P) - 2 * ca.sum1(ca.log(ca.diag(L)))

        def initial(small: Vector) -> Vector:
            value = np.asarray(ca.Function("S", [self.small], [S])(small), float)
            lower: Vector = _factor(value, P)[tuple(np.array(pattern, int).reshape(-1, 2).T)]
            return lower

        diagonal = np.array([i == j for i, j in pattern], bool)
        return _Solver(
            problem=self,
            mode="hard",
            extra=entries,
            lower=np.where(diagonal, 1e-8 * np.sqrt(P.max(initial=1.0)), -np.inf),
            objective=shape,
            equalities=ca.vertcat(g, gap),
            inequalities=ca.SX(0, 1),
            initial=initial,
            verbose=verbose,
        )

    def _movable_rows(self, start: Vector) -> tuple[ca.SX, ca.SX, list[int]] | None:
        """(rows of g, Schur complement of N − aI, its indices) that the design can move."""
        n = self.g.numel()
        entries = ca.densify(ca.vertcat(self.g, ca.vec(self.N)))
        moves = ca.which_depends(entries, self.small, 1, True)
        fixed_g = [i for i in range(n) if not moves[i]]
        rows = [i for i in range(n) if any(moves[n + i * n : n + (i + 1) * n])]
        rest = [i for i in range(n) if i not in rows]
        evaluate = ca.Function("gN", [self.small], [self.g, self.N])
        g0, N0 = (np.asarray(v, float) for v in evaluate(start))
        size = self.scales.energy / self.scales.state
        if np.any(np.abs(g0.ravel()[fixed_g]) > 1e-12 * size[fixed_g]):
            return None
        A = N0[np.ix_(rest, rest)] - self.a * np.eye(len(rest))
        if len(rest) and np.linalg.eigvalsh(A)[0] <= 0:
            return None
        B = N0[np.ix_(rest, rows)]
        S = self.N[rows, rows] - self.a * ca.SX.eye(len(rows))
        if B.any():
            S -= ca.sparsify(ca.DM(B.T @ np.linalg.solve(A, B)))
        g = ca.vertcat(*[self.g[i] for i in range(n) if moves[i]])
        return g, ca.sparsify(S), rows

    def soft(self, verbose: bool) -> _Solver:
        """Min s + t with ∇V(z*) = s w, wᵀw ≤ 1, ∇²V(z*) + (t − a)I = LLᵀ: ε exactly."""
        n = self.g.numel()
        s, t, w = ca.SX.sym("s"), ca.SX.sym("t"), ca.SX.sym("w", n)
        pattern = _block_pattern(self.N)
        L, entries = _lower(pattern)
        shifted = self.N + (t - self.a) * ca.SX.eye(n)
        gap = ca.vertcat(*[(shifted - L @ L.T)[i, j] for i, j in pattern])
        evaluate = ca.Function("gN", [self.small], [self.g, self.N])

        def initial(small: Vector) -> Vector:
            g0, N0 = (np.asarray(v, float) for v in evaluate(small))
            s0 = max(float(np.linalg.norm(g0)), 1e-3)
            t0 = max(0.0, self.a - np.linalg.eigvalsh(N0)[0]) + 0.1 * self.a
            factor = np.linalg.cholesky(N0 + (t0 - self.a) * np.eye(n))
            lower = factor[tuple(np.array(pattern, int).T)]
            return np.concatenate([[s0, t0], g0.ravel() / s0, lower])

        return _Solver(
            problem=self,
            mode="soft",
            extra=ca.vertcat(s, t, w, entries),
            lower=np.concatenate([[0.0, 0.0], np.full(n + len(pattern), -np.inf)]),
            objective=s + t,
            equalities=ca.vertcat(self.g - s * w, gap),
            inequalities=1 - ca.sumsqr(w),
            initial=initial,
            verbose=verbose,
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


def _factor(S: Vector, P: Vector) -> Vector:
    """A nonsingular Cholesky factor to start from: of S, its eigenvalues relative to P lifted."""
    root = np.sqrt(P)
    values, vectors = np.linalg.eigh(S / np.outer(root, root)) if len(P) else (P, np.eye(0))
    lifted = (vectors * np.maximum(values, 0.1)) @ vectors.T * np.outer(root, root)
    return np.linalg.cholesky(lifted)


class _Solver:
    """One NLP in (lifted variables, extra variables, ŵ), compiled once and run from many starts."""

    def __init__(
        self,
        problem: _Problem,
        mode: str,
        extra: ca.SX,
        lower: Vector,
        objective: ca.SX,
        equalities: ca.SX,
        inequalities: ca.SX,
        initial: Callable[[Vector], Vector],
        verbose: bool,
    ) -> None:
        self.problem, self.mode, self.initial = problem, mode, initial
        small = ca.vertcat(problem.small, extra)
        core = ca.Function("core", [small], [objective, equalities, inequalities])
        self.n_lifted, self.n_small = problem.small.numel(), small.numel()
        self.n_equal = self.n_lifted - problem.terms.nc + equalities.numel()
        self.n_rows = self.n_equal + inequalities.numel()

        s, w = ca.MX.sym("s", self.n_small), ca.MX.sym("w", problem.form.size)
        start = ca.MX.sym("start", problem.terms.nc + problem.form.size)
        f, equal, unequal = core(s)
        if mode == "hard":
            f = f + self._proximity(s, w, start)
        physical = ca.DM(problem.sigma) * w + ca.DM(problem.tau)
        g = ca.vertcat(problem.residuals(physical, s[: self.n_lifted]), equal, unequal)
        self.solver = ca.nlpsol(
            "train",
            "ipopt",
            {"x": ca.vertcat(s, w), "p": start, "f": f, "g": g},
            _IPOPT
            | self._hessian(s, w, start, f, g)
            | ({"ipopt.print_level": 5} if verbose else {}),
        )
        self.lower = np.concatenate(
            [
                np.full(self.n_lifted, -np.inf),
                lower,
                np.concatenate([n.lower for n in problem.form.networks]),
            ]
        )

    def _proximity(self, s: ca.MX, w: ca.MX, start: ca.MX) -> ca.MX:
        """½ ‖θ − θ₀‖²_Q and the weak pull on ξ*."""
        nc = self.problem.terms.nc
        cost = ca.DM(np.concatenate([network.cost for network in self.problem.form.networks]))
        pull = XI_COST * ca.sumsqr((s[:nc] - start[:nc]) / ca.DM(self.problem.scales.state[-nc:]))
        return (ca.dot(cost, (w - start[nc:]) ** 2) + pull) / 2

    def _hessian(self, s: ca.MX, w: ca.MX, start: ca.MX, f: ca.MX, g: ca.MX) -> dict[str, object]:
        """How IPOPT gets second derivatives: exact, Gauss–Newton in θ, or limited memory."""
        if self.mode == "soft":
            # A constant initial matrix: the scaled one tends to zero with the linear objective, and
            # pivots of that size fill the factorisation.
            return {
                "ipopt.hessian_approximation": "limited-memory",
                "ipopt.limited_memory_initialization": "constant",
            }
        if self.problem.form.size <= EXACT_HESSIAN_WEIGHTS:
            return {}
        multiplier_f, multiplier_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", g.numel())
        gradient = ca.gradient(multiplier_f * f + ca.dot(multiplier_g, g), s)
        corner, cross = ca.jacobian(gradient, s), ca.jacobian(gradient, w)
        cost = np.concatenate([network.cost for network in self.problem.form.networks])
        hessian = ca.blockcat([[corner, cross], [cross.T, multiplier_f * ca.diag(ca.DM(cost))]])
        return {
            "hess_lag": ca.Function(
                "hess_lag",
                [ca.vertcat(s, w), start, multiplier_f, multiplier_g],
                [ca.triu(hessian)],
            )
        }

    def run(self, seed: int, away: bool) -> tuple[Start, Vector, Vector]:
        """Solve from the random initialisation `seed`: (outcome, weights, ξ*)."""
        problem = self.problem
        rng = np.random.default_rng(seed)
        w0 = problem.form.initial(rng)
        nc = problem.terms.nc
        xi0 = problem.guess + (rng.normal(0.0, 0.5, nc) * problem.scales.state[-nc:] if away else 0)
        w0 = problem.centred(w0, xi0)
        small = problem.small_at(w0, xi0)
        bounds = {"lbx": self.lower, "ubx": np.inf}
        g_upper = np.concatenate(
            [np.zeros(self.n_equal), np.full(self.n_rows - self.n_equal, np.inf)]
        )
        began = time.perf_counter()
        result = self.solver(
            x0=np.concatenate([small, self.initial(small), w0]),
            p=np.concatenate([xi0, w0]),
            lbg=0,
            ubg=g_upper,
            **bounds,
        )
        seconds = time.perf_counter() - began
        solution = np.asarray(result["x"], float).ravel()
        weights = problem.sigma * solution[self.n_small :] + problem.tau
        xi_star = solution[:nc]
        stats = self.solver.stats()
        start = Start(
            seed=seed,
            mode=self.mode,
            status=str(stats["return_status"]),
            iterations=int(stats["iter_count"]),
            seconds=seconds,
            objective=float(result["f"]),
            loss=problem.loss(weights, xi_star),
        )
        return start, weights, xi_star
