"""The least quadratic cost over quadratic parts and damping alone: few variables, no constraint.

Networks and ξ* stay as they are. With θ = (s, η), κ = κ_min + eˢ the curvatures of the quadratic
parts, whose centres move so that their slopes at z* stay, ∇V(z*) does not depend on θ, and the
Lyapunov equation is solved, where quadratic_cost.py imposes it:

    J(θ) = tr(PZ₀) + shape,   AᵀP + PA + W = 0,   AY + YAᵀ + Z₀ = 0,
    dJ = 2 tr(YP dA) + tr(Y dW) + …

‖S − T‖∞ at the plant's input, S − T = I + 2C(jωI − A)⁻¹B, adds to J where its disk margin is small.
Steps are those of Broyden, Fletcher, Goldfarb and Shanno, with Armijo's rule, which accepts no loop
that is not stable. So there is always an answer, in milliseconds.

References
----------
Nocedal and Wright (2006), chapter 6. Levine and Athans (1970), output feedback. Seiler, Packard and
Gahinet (2020), disk margins.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from necc_casadi.arrays import Vector
from necc_casadi.designs.outcome import Start
from necc_casadi.lyapunov.networks import Network
from necc_casadi.synthesis.lifting import Lifting
from necc_casadi.synthesis.programs import asked_matrix
from necc_casadi.synthesis.quadratic_cost import (
    FASTEST,
    SHAPE,
    LinearLoop,
    LinearQuadratic,
    Responsive,
    coupled_damping,
    damping_bounds,
)
from necc_casadi.synthesis.rollouts import Moving

__all__ = ["descended"]


#: Steps at most; so many in a row that lower J by less than this share are the last.
_STEPS, _GAIN, _IDLE = 200, 1e-5, 3


#: Longest first step of a search along a line, Armijo's constant, and the shortest step.
_LONGEST, _ARMIJO, _SHORTEST = 1.0, 1e-4, 1e-10


#: Weight of a damping unlike the one that training ended with.
_DAMPING = 1e-3


#: Weight of what lies beyond a bound, and the share of the one of ‖A‖² beyond which it counts.
_BEYOND, _NEAR = 10.0, 0.95


#: Weight of a peak of S − T beyond the one of the disk margin 0.9, and the frequencies at which it
#: is looked for: these multiples of LQR's fastest mode, and so many of them.
_ROBUST, _PEAK, _SWEPT, _POINTS = 1.0, 2 / 0.9, (1e-2, 1e2), 80


def descended(
    lifting: Lifting,
    aim: LinearQuadratic,
    a: Vector,
    kappa_min: float,
    weights: Vector,
    xi_star: Vector,
    damping: Vector,
    seed: int,
    moves_V: bool = True,
    bends: Sequence[Vector] = (),
) -> Responsive | None:
    """Quadratic parts and 𝒟 of least cost beside the networks; None where nothing costs less.

    Parameters are those of ``least_cost``; with `moves_V` false, 𝒟 alone moves. With the `bends` of
    a family, ∇²V of a member less that of V at z*, the cost is the mean of the members'.
    """
    began = time.perf_counter()
    moving = Moving(lifting, kappa_min, weights, xi_star, damping, networks=False)
    asked = asked_matrix(a, lifting.g.numel())
    objective = _Objective(lifting, aim, asked, moving, weights, moves_V, bends)
    first = objective.at(objective.first)
    if first is None:
        return None
    last, steps = _descend(objective, first)
    if steps == 0:
        return None
    eta, found = last.theta[objective.kappas :], weights
    if moves_V:
        theta = moving.first(eta)
        theta[moving.kappa_at] = last.theta[: objective.kappas]
        found = moving.weights_at(theta)
    start = Start(
        seed=seed,
        mode="cost",
        status="Solve_Succeeded" if steps < _STEPS else "Maximum_Iterations_Exceeded",
        iterations=steps,
        seconds=time.perf_counter() - began,
        objective=last.value,
        loss=lifting.loss(found, xi_star, a),
    )
    return Responsive(
        weights=found,
        xi_star=xi_star,
        damping=coupled_damping(damping, eta),
        eta=eta,
        start=start,
        before=first.cost,
        after=last.cost,
        at_the_bound=last.speed > _NEAR,
        gain=objective.loop.gain(last.P[0]),
    )


@dataclass(frozen=True, eq=False)
class _At:
    """The objective at one θ, with what its slope is made of."""

    theta: Vector
    value: float
    cost: float  # over LQR's, the mean of the members
    A: tuple[Vector, ...]  # of the nominal loop, then of the members
    P: tuple[Vector, ...]
    gap: Vector  # ∇²V(z*) less what is asked, natural units
    speed: float  # ‖A‖² over what is allowed
    outside: Vector  # of the bounds of η
    peak: _Peak  # of S − T at the plant's input


@dataclass(frozen=True, eq=False)
class _Peak:
    """‖S − T‖∞ over some frequencies, and its slopes."""

    size: float
    by_A: Vector
    by_C: Vector  # (m, N)


def _peak(A: Vector, C: Vector, B: Vector, frequencies: Vector) -> _Peak:
    """Of S − T = I + 2C(jωI − A)⁻¹B, the loop closed."""
    resolvent = np.linalg.inv(1j * frequencies[:, None, None] * np.eye(len(A)) - A)
    moved = resolvent @ B
    found = np.eye(B.shape[1]) + 2 * C @ moved
    left, sizes, right = np.linalg.svd(found)
    k = int(np.argmax(sizes[:, 0]))
    row = left[k, :, 0].conj() @ C @ resolvent[k]  # pᴴC(jωI − A)⁻¹
    column = moved[k] @ right[k, 0].conj()  # (jωI − A)⁻¹Bq
    by_A = 2 * np.real(np.outer(row, column))
    by_C = 2 * np.real(np.outer(left[k, :, 0].conj(), column))
    return _Peak(float(sizes[k, 0]), by_A, by_C)


class _Objective:
    """J and its slope, of θ = (s, η)."""

    def __init__(
        self,
        lifting: Lifting,
        aim: LinearQuadratic,
        asked: Vector,
        moving: Moving,
        weights: Vector,
        moves_V: bool,
        bends: Sequence[Vector],
    ) -> None:
        self.moves_V = moves_V
        loops = [LinearLoop(lifting, aim, moving.trained, bend) for bend in (None, *bends)]
        self.loop = loops[0]
        self.kappas = len(moving.kappa)
        self.bounds = damping_bounds(len(moving.trained))
        s = ca.SX.sym("s", self.kappas)
        small = _stiffened(lifting, moving, weights, s)
        theta = ca.vertcat(s, self.loop.eta)
        size = ca.DM(self.loop.size)
        gap = ca.diag(size) @ (lifting.N - ca.DM(asked)) @ ca.diag(size) / lifting.scales.energy
        parts = [gap, self.loop.C]
        for loop in loops:
            parts += ca.substitute([loop.A, loop.W], [loop.eta], [self.loop.eta])
        found = ca.substitute(parts, [lifting.small], [small])
        self._matrices = ca.Function("matrices", [theta], [ca.densify(v) for v in found])
        duals = [ca.SX.sym(f"d{k}", *v.shape) for k, v in enumerate(found)]
        along = sum((ca.dot(d, v) for d, v in zip(duals, found, strict=True)), ca.SX(0))
        self._slope = ca.Function("slope", [theta, *duals], [ca.gradient(along, theta)])
        self.first = moving.first(np.zeros(self.loop.eta.numel()))
        self.first = np.concatenate([self.first[moving.kappa_at], self.first[moving.eta_at]])
        gap_at_start = np.asarray(self._matrices.call([self.first])[0], float)
        self.reference = np.linalg.inv(gap_at_start)
        self.frequencies = np.geomspace(*_SWEPT, _POINTS) * aim.fastest
        self.allowed = len(gap_at_start) * (FASTEST * aim.fastest) ** 2

    def at(self, theta: Vector) -> _At | None:
        """The objective; None where the loop is not stable or V has too little curvature."""
        gap, C, *loops = (np.asarray(v, float) for v in self._matrices.call([theta]))
        if not all(np.isfinite(v).all() for v in (gap, C, *loops)):
            return None
        if np.linalg.eigvalsh(gap)[0] <= 0:
            return None
        As, Ps = loops[::2], list[Vector]()
        for A, W in zip(As, loops[1::2], strict=True):
            P = self.loop.cost_of(A, W)
            if P is None:
                return None
            Ps.append(P)
        low, high = self.bounds
        eta, cost = theta[self.kappas :], float(np.mean([self.loop.relative(P) for P in Ps]))
        outside = np.fmax(eta - high, 0.0) + np.fmin(eta - low, 0.0)
        relative, speed = self.reference @ gap, float(np.sum(As[0] ** 2)) / self.allowed
        shape = float(np.trace(relative) - np.linalg.slogdet(relative)[1]) - len(gap)
        beyond = max(speed - _NEAR, 0.0) ** 2 + float(outside @ outside)
        value = cost + SHAPE * shape + _DAMPING * float(eta @ eta) / 2 + _BEYOND * beyond
        peak = _peak(As[0], C, self.loop.B, self.frequencies)
        value += _ROBUST * max(peak.size - _PEAK, 0.0) ** 2
        return _At(theta, value, cost, tuple(As), tuple(Ps), gap, speed, outside, peak)

    def slope(self, at: _At) -> Vector:
        """∂J/∂θ."""
        from scipy.linalg import solve_continuous_lyapunov  # slow to import, few runs need it

        dual = list[Vector]()
        for A, P in zip(at.A, at.P, strict=True):
            Y = solve_continuous_lyapunov(A, -self.loop.spread(P)) / len(at.A)
            dual += [2 * P @ Y, Y]
        fast = 4 * _BEYOND * max(at.speed - _NEAR, 0.0) / self.allowed
        to_gap = SHAPE * (self.reference - np.linalg.inv(at.gap))
        fragile = 2 * _ROBUST * max(at.peak.size - _PEAK, 0.0)
        dual[0] = dual[0] + fast * at.A[0] + fragile * at.peak.by_A
        dual = [to_gap, fragile * at.peak.by_C, *dual]
        slope = np.asarray(self._slope(at.theta, *dual), float).ravel()
        if not self.moves_V:
            slope[: self.kappas] = 0.0
        slope[self.kappas :] += _DAMPING * at.theta[self.kappas :] + 2 * _BEYOND * at.outside
        return slope


def _stiffened(lifting: Lifting, moving: Moving, weights: Vector, s: ca.SX) -> ca.SX:
    """Lifted variables with κ = κ_min + eˢ in place of those of training."""
    small = ca.SX(ca.DM(lifting.jets_at(weights, moving.xi_star)))
    jet_at, index = lifting.terms.nc, 0
    for network, unit in zip(lifting.form.networks, lifting.form.split(lifting.sigma), strict=True):
        d = network.inputs
        for i in range(d if isinstance(network, Network) and network.quadratic else 0):
            at = jet_at + 1 + d + i * d - i * (i - 1) // 2  # ∂²/∂vᵢ² in the 2-jet
            more = moving.kappa_min + ca.exp(s[index]) - moving.w0[moving.kappa[index]]
            small[at] += more * unit[network.size - 2 * d + i]
            index += 1
        jet_at += 1 + d + d * (d + 1) // 2
    return small


def _descend(objective: _Objective, first: _At) -> tuple[_At, int]:
    """Where the steps end, and how many there are."""
    now, slope = first, objective.slope(first)
    inverse = np.eye(slope.size)
    idle = 0
    for step in range(_STEPS):
        direction = -inverse @ slope
        if direction @ slope >= 0:
            inverse, direction = np.eye(slope.size), -slope
        after = _along(objective, now, direction, float(direction @ slope))
        if after is None:
            return now, step
        turned = objective.slope(after)
        inverse = _updated(inverse, after.theta - now.theta, turned - slope, first_step=step == 0)
        idle = idle + 1 if now.value - after.value < _GAIN * now.value else 0
        now, slope = after, turned
        if idle == _IDLE:
            return now, step + 1
    return now, _STEPS


def _along(objective: _Objective, now: _At, direction: Vector, slope: float) -> _At | None:
    """Armijo's rule; None where no step lowers the objective."""
    length = min(1.0, _LONGEST / max(float(np.abs(direction).max()), 1e-300))
    while length > _SHORTEST:
        after = objective.at(now.theta + length * direction)
        if after is not None and after.value <= now.value + _ARMIJO * length * slope:
            return after
        length /= 2
    return None


def _updated(inverse: Vector, moved: Vector, turned: Vector, first_step: bool) -> Vector:
    """The inverse of the curvature after a step along which the slope turned."""
    rise = float(moved @ turned)
    if rise <= 1e-12 * float(np.linalg.norm(moved) * np.linalg.norm(turned)):
        return inverse
    if first_step:
        inverse = inverse * rise / float(turned @ turned)
    turn = np.eye(moved.size) - np.outer(moved, turned) / rise
    return np.asarray(turn @ inverse @ turn.T + np.outer(moved, moved) / rise, float)
