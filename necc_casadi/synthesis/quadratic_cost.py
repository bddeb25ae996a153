"""The quadratic cost of the linearised loop, minimised over V's quadratic parts and the damping.

At z*, where ∇V = 0, the damped loop and its input are linear in N = ∇²V(z*) and 𝒟:

    A = (M − 𝒢𝒟𝒢ᵀ) N,   C_u = −∂(A∇Hc)/∂z − [D B] 𝒢ᵀN,  u = −A∇Hc + v,
    AᵀP + PA + Q + C_uᵀ R C_u = 0,   P = L_P L_Pᵀ,

so that xᵀPx is what a response costs near the target. N depends on the weights through the lifted
2-jets alone (lifting.py), and the hard form of eq. Loss stays as it is (programs.py):

    min  tr(P Z₀)/tr(P_LQR Σ) + shape + proximity,   ‖A‖_F ≤ √N ω,

ω a few times LQR's fastest mode, Z₀ the mean of z zᵀ over starts of the domain. Most of them are
known when the controller starts, and ξ(0) = ξ* + T(x(0) − x*) with the T of least cost; a push that
comes later finds ξ at ξ*, whatever T is (docs/theory.md, Controller state at the start).

With a rate α, A + αI stands in place of A in the Lyapunov equation: it has a solution P ⪰ 0 only
where every mode decays faster than α, and the cost is that of responses times exp(αt). LQR's cost
and modes are those of the plant with the same shift.

Without, 𝒟 + 𝒟ᵀ ≻ 0 makes every A Hurwitz that LaSalle's principle makes attract, so no constraint
of stability is needed. The networks cost much to move: quadratic parts and damping carry the cost,
and V stays smooth away from z*.

References
----------
Anderson and Moore (1990), Optimal Control: Linear Quadratic Methods.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import casadi as ca
import numpy as np

from necc_casadi.arrays import Vector
from necc_casadi.designs.outcome import Start
from necc_casadi.interrupts import interruptible
from necc_casadi.lyapunov.damping import dissipates
from necc_casadi.lyapunov.networks import Network
from necc_casadi.performance.initial_xi import start_gain
from necc_casadi.synthesis.lifting import Lifting
from necc_casadi.synthesis.programs import Program

__all__ = [
    "Begin",
    "LinearLoop",
    "LinearQuadratic",
    "Responsive",
    "coupled_damping",
    "damping_bounds",
    "damping_variables",
    "least_cost",
    "readable_damping",
]


#: Multiples of LQR's fastest mode that the loop may have.
FASTEST = 6.0


#: Share of the starts that are pushes, which ξ does not follow.
_PUSHED = 0.3


#: A norm above this share of the bound lies at it.
_NEAR_THE_BOUND = 0.97


#: Weight of the shape of V, and of staying where training ended.
SHAPE, _PROXIMITY = 1e-3, 1e-2


#: Weight of a step away from where a solve begins.
_STEP = 0.03


#: How much more a weight of a network costs than one of a quadratic part.
_NETWORKS_STAY = 1e5


#: Weight of a damping unlike the one that training ended with.
_DAMPING = 1e-3


#: 𝒟 = root (LLᵀ + skew) root, root² the damping at the start: bounds of L and of the skew part.
_LEAST_DAMPING, _MOST_DAMPING, _COUPLING = 0.01, 30.0, 3.0


_IPOPT = {
    "print_time": False,
    "ipopt.print_level": 0,
    "ipopt.sb": "yes",
    "ipopt.tol": 1e-7,
    "ipopt.constr_viol_tol": 1e-12,
    "ipopt.acceptable_tol": 1e-6,
    "ipopt.max_iter": 100,  # no solve goes far: one that succeeds takes far fewer
    "ipopt.mumps_pivot_order": 0,
}


@dataclass(frozen=True, eq=False)
class LinearQuadratic:
    """What the linearised loop is judged by, in training units."""

    Q: Vector  # (n, n)
    R: Vector  # (m, m)
    starts: Vector  # (n, n) Σ: mean of (x − x*)(x − x*)ᵀ
    lqr_cost: float  # tr(P_LQR Σ)
    fastest: float  # of LQR's modes
    rate: float = 0.0  # α, which every mode is to exceed


@dataclass(frozen=True, eq=False)
class Begin:
    """Where a solve begins, other than where training ended."""

    weights: Vector
    xi_star: Vector
    eta: Vector  # variables of the damping
    gain: Vector | None = None  # T of ξ(0), (nc, n)


@dataclass(frozen=True, eq=False)
class Responsive:
    """A V and a damping of least cost."""

    weights: Vector  # (form.size,)
    xi_star: Vector  # (nc,)
    damping: Vector  # (m + channels)²
    eta: Vector  # its variables in the program
    start: Start
    before: float  # cost of the linearised loop over LQR's, at the start
    after: float
    at_the_bound: bool  # of ‖A‖
    gain: Vector | None = None  # T of ξ(0) = ξ* + T(x(0) − x*), (nc, n)


def least_cost(
    lifting: Lifting,
    program: Program,
    aim: LinearQuadratic,
    a: Vector,
    kappa_min: float,
    weights: Vector,
    xi_star: Vector,
    damping: Vector,
    seed: int,
    begin: Begin,
    verbose: bool = False,
) -> Responsive | None:
    """V and 𝒟 of least cost, from a trained V and its damping; None where the loop has no cost.

    None, too, where what IPOPT ends with does not decay faster than the rate.

    Parameters
    ----------
    lifting, program
        Of the hard form of eq. Loss, for Φ = H + Hc + C with C = K(c).
    aim
        The cost.
    a
        What ∇²V(z*) is to exceed: a diagonal (n + nc,) or a matrix.
    kappa_min
        Least curvature of the quadratic parts, natural units.
    weights, xi_star, damping
        Of training: what the solution is to stay near.
    seed
        That the weights were drawn with.
    begin
        What to begin with, and not to leave by far.
    verbose
        Print IPOPT's iterations.
    """
    loop = LinearLoop(lifting, aim, damping)
    small, eta = lifting.jets_at(begin.weights, begin.xi_star), begin.eta
    first = (begin.weights - lifting.tau) / lifting.sigma
    P = loop.cost_matrix(small, eta)
    if P is None:
        return None
    w_hat = (weights - lifting.tau) / lifting.sigma
    step = eta, first
    nlp = _Nlp(lifting, program, loop, w_hat, xi_star, kappa_min, verbose, step)
    began = time.perf_counter()
    solution, objective = nlp.solve(small, eta, _upper_factor(P), first)
    seconds = time.perf_counter() - began
    found = lifting.sigma * solution.w_hat + lifting.tau
    xi = solution.small[: lifting.terms.nc]
    made = readable_damping(np.asarray(loop.damping_of(solution.eta), float))
    stats = nlp.solver.stats()
    start = Start(
        seed=seed,
        mode="cost",
        status=str(stats["return_status"]),
        iterations=int(stats["iter_count"]),
        seconds=seconds,
        objective=objective,
        loss=lifting.loss(found, xi, a),
    )
    after = loop.cost_matrix(solution.small, solution.eta)
    if after is None:
        return None
    near = loop.near_the_bound(solution.small, solution.eta)
    ratios = loop.relative(P), loop.relative(after)
    return Responsive(found, xi, made, solution.eta, start, *ratios, near)


def coupled_damping(trained: Vector, eta: Vector) -> Vector:
    """𝒟 of its variables η beside the damping of training."""
    symbols, D = damping_variables(trained)
    return readable_damping(np.asarray(ca.Function("damping", [symbols], [D])(eta), float))


def readable_damping(damping: Vector) -> Vector:
    """Three digits of each entry, where that still dissipates."""
    rounded = np.array([[float(f"{v:.3g}") for v in row] for row in damping])
    return rounded if dissipates(rounded) else damping


class LinearLoop:
    """A, C_u and 𝒟 in the lifted variables and those of the damping; states in their sizes.

    `bend` is ∇²V of a member of a family less that of V, at z*.
    """

    def __init__(
        self,
        lifting: Lifting,
        aim: LinearQuadratic,
        damping: Vector,
        bend: Vector | None = None,
    ) -> None:
        terms, self.aim = lifting.terms, aim
        n, m = terms.n, terms.m
        self.size = lifting.scales.state
        self.eta, D = damping_variables(damping)
        z = ca.vertcat(ca.SX(lifting.x_star), lifting.xi)
        ports = terms.ports(z)
        N = lifting.N if bend is None else lifting.N + ca.DM(bend)
        seen = ports.T @ N
        A = terms.M(z) @ N - ports @ D @ seen
        input_slope = _input_slope(lifting, -D[:m, :] @ seen)
        scale, inverse = ca.DM(self.size), ca.DM(1 / self.size)
        # in what the controller keeps, s = ξ − γ(x)
        carried = np.asarray(terms.slopes(lifting.x_star), float).T * self.size[:n]
        shift = np.eye(len(self.size))
        shift[n:, :n] = carried / self.size[n:, None]
        back = 2 * np.eye(len(shift)) - shift
        self.A = ca.DM(back) @ ca.diag(inverse) @ A @ ca.diag(scale) @ ca.DM(shift)
        self.C = input_slope @ ca.diag(scale) @ ca.DM(shift)
        self.B = np.zeros((len(self.size), m))
        self.B[:n] = np.asarray(terms.directions(lifting.x_star), float) / self.size[:n, None]
        Q = np.zeros((len(self.size), len(self.size)))
        Q[:n, :n] = aim.Q * np.outer(self.size[:n], self.size[:n])
        self.W = ca.SX(ca.DM(Q)) + self.C.T @ ca.DM(aim.R) @ self.C
        self.n = n
        self._matrices = ca.Function("loop", [lifting.small, self.eta], [self.A, self.W])
        self.damping_of = ca.Function("damping", [self.eta], [D])

    def cost_matrix(self, small: Vector, eta: Vector) -> Vector | None:
        """P of the Lyapunov equation, (N, N); None where the loop does not decay at the rate."""
        return self.cost_of(*(np.asarray(v, float) for v in self._matrices.call([small, eta])))

    def cost_of(self, A: Vector, W: Vector) -> Vector | None:
        """The same of a loop A whose states and inputs cost W."""
        A = A + self.aim.rate * np.eye(len(A))
        if not np.isfinite(A).all() or np.linalg.eigvals(A).real.max() >= 0:
            return None
        from scipy.linalg import solve_continuous_lyapunov  # slow to import, and few runs need it

        P = solve_continuous_lyapunov(A.T, -W)
        P = np.asarray((P + P.T) / 2, float)
        # a state that nothing costs has no share in P: the factor L_P must exist all the same
        P += 1e-9 * float(np.trace(P)) * np.eye(len(P))
        return P if np.linalg.eigvalsh(P)[0] > 0 else None

    def near_the_bound(self, small: Vector, eta: Vector) -> bool:
        """Whether ‖A‖ is all but as large as allowed."""
        A = np.asarray(self._matrices.call([small, eta])[0], float)
        allowed = np.sqrt(len(A)) * FASTEST * self.aim.fastest
        return bool(np.linalg.norm(A) > _NEAR_THE_BOUND * allowed)

    def spread(self, P: Vector) -> Vector:
        """Z₀ with the T that is best for P, over LQR's cost, (N, N)."""
        along = np.vstack([np.eye(self.n), start_gain(P, self.n)])
        Z = (1 - _PUSHED) * along @ self.starts @ along.T
        Z[: self.n, : self.n] += _PUSHED * self.starts
        return np.asarray(Z / self.aim.lqr_cost, float)

    def gain(self, P: Vector) -> Vector:
        """T that is best for P, (nc, n)."""
        n = self.n
        return start_gain(P, n) * self.size[n:, None] / self.size[:n]

    def relative(self, P: Vector) -> float:
        """tr(P Z₀) over LQR's."""
        return float(np.sum(P * self.spread(P)))

    @property
    def starts(self) -> Vector:
        """Σ of states in their sizes."""
        size = self.size[: self.n]
        return np.asarray(self.aim.starts / np.outer(size, size), float)


def _input_slope(lifting: Lifting, injected: ca.SX) -> ca.SX:
    """∂u/∂z at z*, (m, n + nc), with ∂v/∂z `injected`; v* = 0."""
    terms = lifting.terms
    z = ca.SX.sym("z", terms.n + terms.nc)
    energy = lifting.jets[0].model(z[terms.n :])
    output = ca.densify(-terms.feedback(z) @ ca.gradient(energy, z)[terms.n :])
    slope = ca.jacobian(output, z)
    if terms.preliminary is not None:
        given = ca.SX.sym("u", terms.m)
        u = terms.preliminary(z[: terms.n], given)
        by_x, by_input = ca.jacobian(u, z), ca.jacobian(u, given)
        by_x, by_input = ca.substitute([by_x, by_input], [given], [output])
        slope, injected = by_x + by_input @ slope, by_input @ injected
    here = ca.vertcat(ca.SX(lifting.x_star), lifting.xi)
    slope, injected = ca.substitute([slope, injected], [z], [here])
    return slope + injected


def _upper_factor(P: Vector) -> Vector:
    """U upper triangular with UUᵀ = P."""
    return np.asarray(np.linalg.cholesky(P[::-1, ::-1])[::-1, ::-1], float)


def damping_bounds(size: int) -> tuple[Vector, Vector]:
    """Bounds of η for a damping of so many rows."""
    coupling = np.full(size * (size - 1), _COUPLING)
    diagonal = np.ones(size)
    low = np.concatenate([np.log(_LEAST_DAMPING) * diagonal, -coupling])
    return low, np.concatenate([np.log(_MOST_DAMPING) * diagonal, coupling])


def damping_variables(start: Vector) -> tuple[ca.SX, ca.SX]:
    """Variables η (0 at the start) and 𝒟 = root (LLᵀ + skew) root, whose diagonal part is first."""
    size = len(start)
    below = [(i, j) for i in range(size) for j in range(i)]
    eta = ca.SX.sym("eta", size + 2 * len(below))
    L, skew = ca.SX(size, size), ca.SX(size, size)
    for i in range(size):
        L[i, i] = ca.exp(eta[i] / 2)
    for index, (i, j) in enumerate(below):
        L[i, j] = eta[size + index]
        skew[i, j] = eta[size + len(below) + index]
        skew[j, i] = -skew[i, j]
    root = ca.DM(np.sqrt(np.diag(start)))
    return eta, ca.diag(root) @ (L @ L.T + skew) @ ca.diag(root)


@dataclass(frozen=True, eq=False)
class _Solution:
    small: Vector
    eta: Vector
    w_hat: Vector


class _Nlp:
    """The hard form and the Lyapunov equation, in (small, L, η, L_P, ŵ)."""

    def __init__(
        self,
        lifting: Lifting,
        program: Program,
        loop: LinearLoop,
        w_hat: Vector,
        xi_star: Vector,
        kappa_min: float,
        verbose: bool,
        step: tuple[Vector, Vector],
    ) -> None:
        self.lifting, self.program, self.loop = lifting, program, loop
        size = len(loop.size)
        # upper triangular: what is left of P where ξ is chosen is then a product of its first block
        self.pattern = [(i, j) for j in range(size) for i in range(j + 1)]
        entries = ca.SX.sym("p", len(self.pattern))
        core = self._core(entries)
        s, e = ca.MX.sym("s", lifting.small.numel()), ca.MX.sym("e", program.extra.numel())
        eta, p = ca.MX.sym("eta", loop.eta.numel()), ca.MX.sym("p", len(self.pattern))
        w = ca.MX.sym("w", lifting.form.size)
        objective, equal, speed = core.call([s, e, eta, p])
        weights = ca.DM(lifting.sigma) * w + ca.DM(lifting.tau)
        moved = ca.dot(ca.DM(self._weight_cost()), (w - ca.DM(w_hat)) ** 2) / lifting.form.size
        nc = lifting.terms.nc
        away = ca.sumsqr((s[:nc] - ca.DM(xi_star)) / ca.DM(loop.size[-nc:]))
        objective = objective + (_PROXIMITY * (moved + away) + _DAMPING * ca.sumsqr(eta)) / 2
        far = ca.sumsqr(eta - ca.DM(step[0]))
        far += ca.dot(ca.DM(self._weight_cost()), (w - ca.DM(step[1])) ** 2)
        objective = objective + _STEP * far / 2  # not so far that A becomes unstable
        g = ca.vertcat(lifting.residuals(weights, s), equal, speed)
        self.upper = np.zeros(g.numel())
        self.lower = np.zeros(g.numel())
        self.lower[-1] = -np.inf
        self.bounds = self._bounds(kappa_min)
        options = _IPOPT | ({"ipopt.print_level": 5} if verbose else {})
        problem = {"x": ca.vertcat(s, e, eta, p, w), "f": objective, "g": g}
        self.solver = ca.nlpsol("least_cost", "ipopt", problem, options)

    def _core(self, entries: ca.SX) -> ca.Function:
        """(small, L, η, L_P) -> (cost and shape, what must vanish, excess of ‖A‖²)."""
        loop, program, size = self.loop, self.program, len(self.loop.size)
        L = ca.SX(size, size)
        for index, (i, j) in enumerate(self.pattern):
            L[i, j] = entries[index]
        P, n = L @ L.T, loop.n
        shifted = loop.A + loop.aim.rate * ca.SX.eye(size)
        balance = shifted.T @ P + P @ shifted + loop.W
        vanish = ca.vertcat(program.equalities, *[balance[i, j] for i, j in self.pattern])
        known, pushed = L[:n, :n], L[:n, n:]
        paid = known @ known.T + _PUSHED * pushed @ pushed.T
        cost = ca.dot(paid, ca.DM(loop.starts)) / loop.aim.lqr_cost
        excess = ca.sumsqr(loop.A) / (FASTEST * loop.aim.fastest) ** 2 - size
        return ca.Function(
            "core",
            [self.lifting.small, program.extra, loop.eta, entries],
            [cost + SHAPE * program.objective, vanish, excess],
        )

    def _weight_cost(self) -> Vector:
        """Of a change in each weight: networks stay as they are."""
        parts = []
        for network in self.lifting.form.networks:
            cost = network.cost
            tail = 2 * network.inputs if isinstance(network, Network) and network.quadratic else 0
            cost[: cost.size - tail] *= _NETWORKS_STAY
            parts.append(cost)
        return np.concatenate(parts)

    def _bounds(self, kappa_min: float) -> tuple[Vector, Vector]:
        lifting, program = self.lifting, self.program
        low, high = damping_bounds(lifting.terms.m + lifting.terms.channels)
        free = np.full(len(self.pattern), np.inf)
        networks = [network.lower(kappa_min) for network in lifting.form.networks]
        lower = [np.full(lifting.small.numel(), -np.inf), program.lower, low, -free, *networks]
        many = lifting.small.numel() + program.lower.size
        upper = [np.full(many, np.inf), high, free, np.full(lifting.form.size, np.inf)]
        return np.concatenate(lower), np.concatenate(upper)

    def solve(
        self, small: Vector, eta: Vector, L: Vector, w_hat: Vector
    ) -> tuple[_Solution, float]:
        """From a trained V, its damping and the factor of its cost."""
        entries = np.array([L[i, j] for i, j in self.pattern])
        first = [small, self.program.initial(small), eta, entries, w_hat]
        with interruptible():
            result = self.solver(
                x0=np.concatenate(first),
                lbx=self.bounds[0],
                ubx=self.bounds[1],
                lbg=self.lower,
                ubg=self.upper,
            )
        parts = np.split(np.asarray(result["x"], float).ravel(), np.cumsum([v.size for v in first]))
        return _Solution(parts[0], parts[2], parts[4]), float(result["f"])
