"""The training problem of eq. Loss as a smooth nonlinear program, solved by IPOPT.

    ε = ‖∇V(z*)‖ + ReLU(−λ_min(∇²V(z*) − aI))                                   eq. Loss

in natural units, in which aI may be any diagonal.

*Lifting* (lifting.py). The 2-jets y of the networks at their inputs are decision
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
∇²V(z*) + (t − a)I = LLᵀ, s, t ≥ 0. Its minimum is the minimum of ε exactly
(docs/theory.md#smooth-loss).

*Shaped form* (shaping.py). The hard form with a heavy objective over samples of the
domain, in rows u = A m + b that are affine in the weights m that move; the hidden layers are fixed
at their start and ξ* is held to its own, around which the samples lie. The Hessian is exact. A
level starts from a solved hard form and is solved again for the minimisers of the V it gave.

References
----------
Wächter and Biegler (2006), IPOPT. Kulis, Sustik and Dhillon (2009), the log-det divergence.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
import numpy.typing as npt

from necc_casadi.arrays import Vector
from necc_casadi.designs.outcome import Start, solver_seconds
from necc_casadi.interrupts import interruptible
from necc_casadi.lyapunov.lyapunov import LyapunovFunction, Terms
from necc_casadi.lyapunov.networks import KAPPA_MIN
from necc_casadi.lyapunov.parameterization import Form
from necc_casadi.model.sizes import Sizes
from necc_casadi.synthesis.lifting import Lifting
from necc_casadi.synthesis.programs import (
    Program,
    asked_matrix,
    hard_program,
    soft_program,
    with_level,
)
from necc_casadi.synthesis.shaping import AffineRows, Average, Height, Shaping, moving_weights

__all__ = ["STIFFER", "Anchor", "Penalty", "Solution", "train"]


#: Up to this many weights the Hessian of the Lagrangian is exact, beyond it Gauss–Newton in θ.
EXACT_HESSIAN_WEIGHTS = 500


#: Weak pull of ξ* to its initial value: V may be invariant under translations of ξ.
XI_COST = 1e-2


#: Pull of ξ* where V is shaped over samples around its start: it moves only where it must.
SHAPED_XI_COST = 1e4


#: Quadratic parts start this much above their lower bound.
STIFFER = 1.1


#: How often a level is solved, each time for the minimisers of the V before.
_ROUNDS = 3


#: A start whose ε, in natural units, is below this has solved the hard form.
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


#: (weights, ξ*) ↦ a further term of the objective, over as many sample points as it likes.
Penalty = Callable[[ca.MX, ca.MX], ca.MX]


#: Makes the program in the lifted variables.
_Make = Callable[[Lifting, Vector, tuple[float, ...] | None], Program | None]


#: The outcome of a start, weights and ξ*.
_Result = tuple[Start, Vector, Vector]


@dataclass(frozen=True, eq=False)
class Anchor:
    """Where training starts, and what holds it there."""

    xi: Vector  # (nc,) ξ* at the start
    pull: float = XI_COST  # how strongly ξ* is held to it
    kappa_min: float = KAPPA_MIN  # least curvature of the quadratic parts, natural units
    #: Curvature of the quadratic part of each network, in natural units, where training starts
    #: and whose Hessian is the reference P; None: P is diagonal, of the plant's own size.
    stiffness: tuple[float, ...] | None = None

    def begins(self, networks: int) -> tuple[float, ...]:
        """Curvature with which each quadratic part begins."""
        return self.stiffness or (STIFFER * self.kappa_min,) * networks


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
        return solver_seconds(self.starts)


def train(
    terms: Terms,
    form: Form,
    x_star: Vector,
    *,
    a: float | Vector,
    scales: Sizes,
    anchor: Anchor | None = None,
    extra: Penalty | Shaping | None = None,
    seed: int = 0,
    starts: int = 1,
    report: Callable[[Start], None] | None = None,
    verbose: bool = False,
) -> Solution:
    """Minimise eq. Loss over the weights and ξ*.

    Each start runs the regularised form where one is asked for, then, as long as none is solved,
    the hard form and the soft form. A level is asked of the best that solved the hard form.

    Parameters
    ----------
    terms
        Symbolic terms of plant, controller and Casimirs.
    form
        Networks of V.
    x_star
        Target (n,).
    a
        Curvature asked of ∇²V(z*): of every state, of each (n + nc,), or a matrix below it.
    scales
        Sizes of order one in natural units; the published form is trained in the plant's own.
    anchor
        Where training starts and what holds it there; later starts move away from its ξ*.
    extra
        A further term of the objective, or what is asked of V over samples of the domain: then
        V must be affine in its output layers (Φ = H + Hc + C, joint form).
    seed, starts
        Start i uses seed + i.
    report
        Called with the outcome of each start.
    verbose
        Print IPOPT's iterations.
    """
    anchor = anchor or Anchor(np.zeros(terms.nc))
    asked = asked_matrix(a, terms.n + terms.nc)
    lifting = Lifting(terms, form, np.asarray(x_star, float), scales, anchor.xi)
    results: list[_Result] = []
    plain = None if isinstance(extra, Shaping) else extra
    forms: list[tuple[_Make, Penalty | Shaping | None]]
    forms = [(hard_program, plain), (soft_program, plain)]
    if isinstance(extra, Average):
        forms = [(hard_program, extra), *forms]
    for make, added in forms:
        program = make(lifting, asked, anchor.stiffness)
        if program is None:
            continue
        solver = _Solver(lifting, program, asked, anchor, added, verbose)
        for index in range(starts):
            results.append(solver.run(seed + index, away=index > 0))
            if report is not None:
                report(results[-1][0])
        if any(start.loss <= SOLVED for start, _, _ in results):
            break
    best, weights, xi_star = min(results, key=lambda result: _rank(result[0]))
    program = hard_program(lifting, asked, anchor.stiffness)
    if isinstance(extra, Height) and program is not None and best.loss <= SOLVED:
        shaper = _Shaper(lifting, program, asked, anchor, extra, verbose)
        shaped = shaper.shaped(best, weights, xi_star)
        results.append(shaped)
        if report is not None:
            report(shaped[0])
        if shaped[0].loss <= SOLVED:
            best, weights, xi_star = shaped
    return Solution(weights, xi_star, best.loss, tuple(start for start, _, _ in results))


def _rank(start: Start) -> tuple[bool, float]:
    """Solved starts first, by the shape of V; the others by their loss."""
    solved = start.loss <= SOLVED
    return (not solved, start.objective if solved and start.mode != "soft" else start.loss)


class _Solver:
    """One NLP in (lifted variables, extra variables, ŵ), compiled once and run from many starts."""

    def __init__(
        self,
        lifting: Lifting,
        program: Program,
        a: Vector,
        anchor: Anchor,
        extra: Penalty | Shaping | None,
        verbose: bool,
    ) -> None:
        shaping = extra if isinstance(extra, Shaping) else None
        penalty = None if isinstance(extra, Shaping) else extra
        program = with_level(program) if shaping is not None and shaping.has_level else program
        self.lifting, self.program, self.a = lifting, program, a
        self.stiffness = anchor.begins(len(lifting.form.networks))
        self.shaping = shaping
        self.xi_cost = anchor.pull if shaping is None else SHAPED_XI_COST
        small = ca.vertcat(lifting.small, program.extra)
        core = ca.Function(
            "core", [small], [program.objective, program.equalities, program.inequalities]
        )
        self.n_small = small.numel()
        n_lifted, nc = lifting.small.numel(), lifting.terms.nc
        s, w = ca.MX.sym("s", self.n_small), ca.MX.sym("w", lifting.form.size)
        start = ca.MX.sym("start", nc + lifting.form.size)
        f, equal, unequal = core.call([s])
        weights = ca.DM(lifting.sigma) * w + ca.DM(lifting.tau)
        if program.mode == "hard":
            f = f + self._proximity(s, w, start)
        if penalty is not None:
            f = f + penalty(weights, s[:nc])
        rows = AffineRows(shaping, lifting, w, s[-1]) if shaping is not None else None
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
                *[network.lower(anchor.kappa_min) for network in lifting.form.networks],
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
        self, s: ca.MX, w: ca.MX, p: ca.MX, f: ca.MX, g: ca.MX, rows: AffineRows | None
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

    def run(self, seed: int, away: bool) -> _Result:
        """Solve from the random initialisation `seed`."""
        lifting, nc = self.lifting, self.lifting.terms.nc
        rng = np.random.default_rng(seed)
        w0 = lifting.form.initial(rng)
        spread = 0.5 * lifting.scales.state[-nc:] if away else np.zeros(nc)
        xi0 = lifting.guess + rng.normal(0.0, 1.0, nc) * spread
        w0 = lifting.centred(w0, xi0, self.stiffness)
        return self._solved(seed, w0, xi0, self.shaping)

    def _solved(self, seed: int, w0: Vector, xi0: Vector, shaping: Shaping | None) -> _Result:
        """Solve from ŵ and ξ*, with the samples of this shaping."""
        lifting, nc = self.lifting, self.lifting.terms.nc
        small = lifting.small_at(w0, xi0)
        first, p = self.program.initial(small), np.concatenate([xi0, w0])
        lower, upper = self.lower.copy(), np.full(self.lower.size, np.inf)
        if shaping is not None:
            A, b, moving = self._sampled(shaping, w0, xi0)
            p = np.concatenate([p, A.ravel(order="F"), b])
            if isinstance(shaping, Height):
                first[-1] = shaping.first_level(A @ w0[moving] + b)
                least, most = shaping.held(lifting.form, w0)
                lower[self.n_small :] = np.maximum(lower[self.n_small :], least)
                upper[self.n_small :] = most
            fixed = self.n_small + np.setdiff1d(np.arange(w0.size), moving)
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


class _Shaper(_Solver):
    """The shaped form of a level: solved from a V, then for the minimisers of each V it gives."""

    def shaped(self, start: Start, weights: Vector, xi_star: Vector) -> _Result:
        """The last V that meets the conditions at z*, with all rounds' iterations and seconds."""
        best: _Result = (start, weights, xi_star)
        found, iterations, seconds = best, 0, 0.0
        for _ in range(_ROUNDS):
            found = self._round(*best)
            iterations += found[0].iterations
            seconds += found[0].seconds or 0.0
            if found[0].loss > SOLVED:
                break
            best = found
        last = found if best[0] is start else best
        return replace(last[0], iterations=iterations, seconds=seconds), last[1], last[2]

    def _round(self, start: Start, weights: Vector, xi_star: Vector) -> _Result:
        """One solve, for the minimisers of this V."""
        lifting, shaping = self.lifting, self.shaping
        if isinstance(shaping, Height):
            V = LyapunovFunction(lifting.terms, lifting.form, weights, np.eye(2 * lifting.terms.m))
            shaping = shaping.at(V, np.concatenate([lifting.x_star, xi_star]))
        w_hat = (weights - lifting.tau) / lifting.sigma
        return self._solved(start.seed, w_hat, xi_star, shaping)
