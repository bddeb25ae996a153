"""Responses of many starts at once to a controller whose inputs are clipped to the plant's limits.

The plant gets sat(u), the controller's own states go on as they are: what the exported code does.

References
----------
Bogacki and Shampine (1989).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from necc_casadi.arrays import Truth, Vector
from necc_casadi.designs.design import Design
from necc_casadi.interrupts import interruptible
from necc_casadi.model.cost import QuadraticCost
from necc_casadi.model.samples import quasi_random
from necc_casadi.performance.closed_loop_cost import Feedback, design_feedback, lqr_feedback
from necc_casadi.performance.plant_model import PlantModel, plant_model
from necc_casadi.performance.turns import turns_of
from necc_casadi.simulation.convergence import stepper
from necc_casadi.simulation.responses import default_horizon

__all__ = ["Elsewhere", "Saturated", "even_starts", "lqr_costs", "saturated"]


#: Starts that a response is judged by.
_STARTS = 40


#: A start that comes this close, as a share of its first distance, has arrived.
_ARRIVED = 0.01


#: One that keeps moving by less than this many sizes in a default horizon, for this share of one,
#: is at rest: a saddle is left sooner. Where z̄ is reached more slowly than exponentially, that
#: tells nothing.
_AT_REST, _LONG = 0.05, 0.5


#: One that is this many times as far away as the domain reaches does not come back; nor does one
#: that is farther away than that reach when its time is over.
_LOST = 50.0


#: Horizons that a start may take: far from z̄ the linearisation says little about time.
_PATIENCE = 4.0


#: Errors of a step are relative to a state's magnitude, or to this where it is smaller.
_TOLERANCE, _SMALL_STATE = 1e-4, 0.01


#: Steps at most for all starts of up to so many states, fewer for more; the shortest step.
_MOST_STEPS, _FEW_STATES, _LEAST_STEP = 3000, 8, 1e-7


#: Ends that are this close, in sizes, are one place; coordinates that are smaller are 0.
_SAME, _NOTHING = 0.1, 0.01


#: Slopes at most of all responses that are stiff, and the error of a step that they allow near 0.
_MOST_CALLS, _STIFF = 40_000, 1e-8


@dataclass
class _Calls:
    """How many slopes may still be asked for."""

    left: int

    class Spent(Exception):
        """None."""

    def count(self) -> None:
        """One less."""
        if self.left == 0:
            raise _Calls.Spent
        self.left -= 1


@dataclass(frozen=True)
class Elsewhere:
    """A place other than the target where starts come to rest."""

    at: Mapping[str, float]  # plant state → value, in the units of the model
    starts: tuple[int, ...]  # which


@dataclass(frozen=True, eq=False)
class Saturated:
    """Responses from N starts, inputs clipped to the plant's limits, in the units of the model."""

    starts: Vector  # (N, n) plant states; ξ starts where the design says
    arrived: Truth  # (N,)
    lost: Truth  # (N,) went far away, or could not be followed
    elsewhere: tuple[Elsewhere, ...]  # the places of most starts first
    cost: Vector  # (N,) of the response, saturated; ∞ where the target is not reached
    peak_u: Vector  # (N, m) largest |u| that the controller asks for
    exceeded: Truth  # (N, m) whether it asks for more than the limits allow

    @property
    def share(self) -> float:
        """Of the starts that arrive."""
        return float(self.arrived.mean())

    @property
    def strayed(self) -> tuple[int, ...]:
        """The starts that are known not to arrive."""
        settled = {index for place in self.elsewhere for index in place.starts}
        return tuple(sorted(settled | set(map(int, np.flatnonzero(self.lost)))))

    @property
    def beyond(self) -> int:
        """How many starts ask for an input beyond the limits."""
        return int(self.exceeded.any(axis=1).sum())

    @property
    def keeps_limits(self) -> bool:
        """Whether no start asks for an input beyond the limits."""
        return not self.exceeded.any()


def even_starts(design: Design, count: int = _STARTS) -> Vector:
    """Plant states that fill the domain evenly, the same for every design of a plant, (N, n)."""
    n = design.loop.plant.n
    lo, hi = design.domain.lo[:n], design.domain.hi[:n]
    return np.asarray(lo + quasi_random(count, n, 0) * (hi - lo), float)


def saturated(design: Design, cost: QuadraticCost, starts: Vector | None = None) -> Saturated:
    """Responses of a design from plant states (N, n), those of :func:`even_starts` by default."""
    starts = even_starts(design) if starts is None else starts
    plant, units = plant_model(design, cost), design.units
    followed = _Follower(design, plant, design_feedback(design)).follow(starts)
    return Saturated(
        starts=starts,
        arrived=followed.arrived,
        lost=followed.lost,
        elsewhere=_places(design, followed),
        cost=followed.cost,
        peak_u=followed.peak * units.input,
        exceeded=followed.exceeded,
    )


def lqr_costs(design: Design, cost: QuadraticCost, starts: Vector) -> Vector | None:
    """What LQR costs from the same starts, clipped likewise, (N,); None where it fails."""
    plant = plant_model(design, cost)
    feedback = lqr_feedback(plant)
    return None if feedback is None else _Follower(design, plant, feedback).follow(starts).cost


@dataclass(frozen=True, eq=False)
class _Followed:
    """Of N starts, in natural units."""

    ends: Vector  # (N, n + nc)
    arrived: Truth
    lost: Truth
    resting: Truth  # away from the target
    cost: Vector
    peak: Vector  # (N, m)
    exceeded: Truth  # (N, m)


class _Follower:
    """A plant and a controller, followed until each start has arrived, rests or is lost."""

    def __init__(self, design: Design, plant: PlantModel, feedback: Feedback) -> None:
        natural = design.natural
        self.plant, self.feedback = plant, feedback
        size = natural.sizes.state
        self.target = natural.stored_z_bar[: plant.n + feedback.nc]
        self.size = size[: len(self.target)]
        self.units = design.units.state[: plant.n]
        self.horizon = default_horizon(design) / design.units.time
        reach = (natural.domain.hi - natural.domain.lo)[: len(self.target)]
        self.reach = float(np.linalg.norm(reach / self.size))
        self.turns = turns_of(design)[: len(self.target)]
        limits = design.loop.plant.u_limits
        bounds = [(-np.inf, np.inf)] * plant.m if limits is None else limits
        self.lo, self.hi = np.array(bounds, float).T / design.units.input
        self.creeps = design.creeps
        self._law = feedback.law
        self._field = self._extended()

    def _extended(self) -> ca.Function:
        """(z, J) -> (ż, J̇), J the cost of what the plant gets."""
        plant, n, nc = self.plant, self.plant.n, self.feedback.nc
        state = ca.MX.sym("state", n + nc + 1)
        x, xi = state[:n], state[n : n + nc]
        u, xi_dot, asked = self.feedback.limited(self.lo, self.hi).call([x, xi])
        sx, su = ca.SX.sym("x", n), ca.SX.sym("u", plant.m)
        running = ca.Function("cost", [sx, su], [plant.running_cost(sx, su)])
        slope = ca.vertcat(plant.dynamics(x, u), xi_dot, running(x, u))
        return ca.Function("extended", [state], [slope, asked])

    def _slopes(self, z: Vector) -> tuple[Vector, Vector]:
        """Slopes (B, N + 1) and the inputs asked for, (B, m)."""
        slopes, asked = self._field.call([z.T])
        return np.asarray(slopes, float).T, np.asarray(asked, float).T

    def distance(self, z: Vector) -> Vector:
        """From the target in sizes, whole turns of angles that nothing counts left out, (B,)."""
        away = z[:, : len(self.size)] - self.target
        turning = self.turns > 0
        whole = np.round(away[:, turning] / self.turns[turning])
        away[:, turning] -= whole * self.turns[turning]
        return np.asarray(np.linalg.norm(away / self.size, axis=1), float)

    def follow(self, starts: Vector) -> _Followed:
        """Follow plant states (N, n), in the units of the model."""
        count = len(starts)
        x = starts / self.units
        xi = np.array([self.feedback.start(row) for row in x]).reshape(count, self.feedback.nc)
        z = np.concatenate([x, xi, np.zeros((count, 1))], axis=1)
        horizon = _PATIENCE * self.horizon
        near = _ARRIVED * self.distance(z)
        arrived, lost, resting = near == 0, *np.zeros((2, count), bool)
        t, h, quiet = np.zeros(count), np.full(count, self.horizon / 1000), np.zeros(count)
        slope, asked = self._slopes(z)
        peak = np.where(np.isfinite(asked), np.abs(asked), 0.0)
        exceeded = (asked < self.lo) | (asked > self.hi)
        alive, stiff = np.flatnonzero(~arrived), np.zeros(count, bool)
        most = _MOST_STEPS * _FEW_STATES // max(_FEW_STATES, z.shape[1])
        take = stepper(self._field, np.append(self.target, 0.0), horizon / most)
        for _ in range(most):
            if alive.size == 0:
                break
            with interruptible(), np.errstate(all="ignore"):
                step = np.minimum(h[alive], horizon - t[alive])
                end, end_slope, difference = take(z[alive], slope[alive], step)
                error = self._error(z[alive], end, difference)
                good = error <= 1
                growth = np.clip(0.9 * np.fmax(error, 1e-9) ** (-1 / 3), 0.2, 5.0)
            moved = alive[good]
            z[moved], slope[moved] = end[good], end_slope[good]
            t[moved] += step[good]
            h[alive] = step * np.where(np.isfinite(error), growth, 0.2)
            if moved.size:
                u = self._inputs(z[moved])
                peak[moved] = np.fmax(peak[moved], np.abs(u))
                exceeded[moved] |= (u < self.lo) | (u > self.hi)
            distance = self.distance(z[alive])
            arrived[alive] = distance <= near[alive]
            pace = np.abs(slope[alive][:, : len(self.size)] / self.size).max(1) * self.horizon
            quiet[alive] = np.where(pace < _AT_REST, quiet[alive], t[alive])
            still = t[alive] - quiet[alive] > _LONG * self.horizon
            resting[alive] = ~arrived[alive] & still & (not self.creeps)
            short = (h[alive] < _LEAST_STEP * horizon) & ~good
            lost[alive] = ~(distance < _LOST * self.reach)
            stiff[alive] = short & ~lost[alive]
            going = (t[alive] < horizon * (1 - 1e-9)) & ~(arrived | lost | resting | stiff)[alive]
            alive = alive[going]
        pending = stiff.copy()
        pending[alive] = not self.creeps
        calls = _Calls(_MOST_CALLS)
        for index in map(int, np.flatnonzero(pending)):
            known = np.isfinite(slope[index]).all()  # not so where the model is not defined
            path = self._stiffly(z[index], t[index], horizon, calls) if known else None
            if path is None:
                lost[index] |= stiff[index]
                continue
            z[index] = path[-1]
            arrived[index] = bool(self.distance(path[-1:])[0] <= near[index])
            u = self._inputs(path)
            peak[index] = np.fmax(peak[index], np.abs(u).max(0))
            exceeded[index] |= ((u < self.lo) | (u > self.hi)).any(0)
        lost |= ~(arrived | resting) & ~(self.distance(z) < self.reach)
        cost = np.where(arrived, z[:, -1], np.inf)
        ends = z[:, : len(self.size)]
        return _Followed(ends, arrived, lost, resting, cost, peak, exceeded)

    def _stiffly(self, z: Vector, t: float, horizon: float, calls: _Calls) -> Vector | None:
        """The rest of a response whose steps became short, (points, N + 1); None: it has none.

        Near a pole of the model a loop may be stiff, or its solution end there.
        """
        from scipy.integrate import solve_ivp  # slow to import, and few runs need it

        def slope(_: float, state: Vector) -> Vector:
            calls.count()
            return np.asarray(self._slopes(state[None])[0][0], float)

        try:
            with interruptible(), np.errstate(all="ignore"):
                found = solve_ivp(
                    slope, (t, horizon), z, method="LSODA", rtol=_TOLERANCE, atol=_STIFF
                )
        except _Calls.Spent:
            return None
        path = np.asarray(found.y, float).T
        return path if found.success and np.isfinite(path).all() else None

    def _error(self, start: Vector, end: Vector, difference: Vector) -> Vector:
        """Of a step, as a multiple of what is allowed, (B,); the cost has no say."""
        size = len(self.size)
        magnitude = np.fmax(np.abs(start[:, :size]), np.abs(end[:, :size]))
        scale = _TOLERANCE * (_SMALL_STATE + magnitude)
        return np.asarray(np.abs(difference[:, :size] / scale).max(axis=1), float)

    def _inputs(self, z: Vector) -> Vector:
        n, nc = self.plant.n, self.feedback.nc
        u, _ = self._law.call([z[:, :n].T, z[:, n : n + nc].T])
        return np.asarray(u, float).T


def _places(design: Design, followed: _Followed) -> tuple[Elsewhere, ...]:
    """Where starts come to rest away from the target, the most frequent place first."""
    n, size = design.loop.plant.n, design.natural.sizes.state
    places: list[list[int]] = []
    for index in map(int, np.flatnonzero(followed.resting)):
        for place in places:
            apart = (followed.ends[index] - followed.ends[place[0]]) / size
            if np.abs(apart[:n]).max() <= _SAME:
                place.append(index)
                break
        else:
            places.append([index])
    places.sort(key=lambda place: (-len(place), place[0]))
    return tuple(_place(design, followed.ends[place[0]], place) for place in places)


def _place(design: Design, end: Vector, starts: Sequence[int]) -> Elsewhere:
    plant, size = design.loop.plant, design.natural.sizes.state
    x = np.where(np.abs(end) < _NOTHING * size, 0.0, end)[: plant.n] * design.units.state[: plant.n]
    return Elsewhere(dict(zip(plant.states, x.tolist(), strict=True)), tuple(starts))
