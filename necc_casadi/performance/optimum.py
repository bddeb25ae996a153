"""The least cost from a start: Radau collocation, solved by IPOPT, with LQR's cost at the end.

Inputs stay within the limits of the model.

References
----------
Biegler (2010), Nonlinear Programming, chapter 10. Wächter and Biegler (2006), IPOPT.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from necc_casadi.arrays import Vector
from necc_casadi.interrupts import interruptible
from necc_casadi.performance.closed_loop_cost import Responses
from necc_casadi.performance.plant_model import PlantModel

__all__ = ["Optimal", "Optimum", "optimal_responses"]


#: Points of collocation per interval, intervals, and how much longer each is than the one before.
_DEGREE, _INTERVALS, _GRADED = 3, 60, 1.04


_IPOPT = {
    "print_time": False,
    "show_eval_warnings": False,  # where a step leaves the model's domain
    "ipopt.print_level": 0,
    "ipopt.sb": "yes",
    "ipopt.max_iter": 300,
    "ipopt.mumps_pivot_order": 0,
}


@dataclass(frozen=True, eq=False)
class _Grid:
    """Intervals of the horizon and the points of collocation in them."""

    steps: Vector  # (intervals,)
    times: Vector  # (intervals · degree,)
    slopes: Vector  # (degree + 1, degree) derivative of the polynomial at the points
    weights: Vector  # (degree,) of the quadrature


def _grid(horizon: float) -> _Grid:
    lengths = _GRADED ** np.arange(_INTERVALS)
    steps = np.asarray(lengths * (horizon / lengths.sum()), float)
    tau = ca.collocation_points(_DEGREE, "radau")
    slopes, _, weights = ca.collocation_coeff(tau)
    begins = np.concatenate([[0.0], np.cumsum(steps)[:-1]])
    times = (begins[:, None] + steps[:, None] * np.array(tau)).ravel()
    return _Grid(steps, times, np.asarray(slopes, float), np.asarray(weights, float).ravel())


@dataclass(frozen=True, eq=False)
class Optimal:
    """A response of least cost, in natural units."""

    cost: float
    t: Vector  # (points,)
    x: Vector  # (points, n)
    u: Vector  # (points, m)


class Optimum:
    """The optimal control problem of a plant over a horizon, in natural units; built once.

    Raises
    ------
    ValueError
        Where LQR does not stabilise the plant: there is no cost for what follows the horizon.
    """

    def __init__(self, plant: PlantModel, horizon: float) -> None:
        if plant.linear is None:
            raise ValueError("no terminal cost")
        self.plant, self.grid = plant, _grid(horizon)
        n, m = plant.n, plant.m
        start = ca.MX.sym("start", n)
        X, U = ca.MX.sym("X", n * _DEGREE, _INTERVALS), ca.MX.sym("U", m * _DEGREE, _INTERVALS)
        ends = X[n * (_DEGREE - 1) :, :]
        begins = ca.horzcat(start, ends[:, :-1])
        interval = self._interval().map(_INTERVALS)
        defects, costs = interval.call([begins, X, U, ca.DM(self.grid.steps).T])
        left = ends[:, -1] - ca.DM(plant.x_star)
        cost = ca.sum2(costs) + ca.bilin(ca.MX(ca.DM(plant.linear.P)), left, left)
        problem = {
            "x": ca.vertcat(ca.vec(X), ca.vec(U)),
            "p": start,
            "f": cost,
            "g": ca.vec(defects),
        }
        self.solver = ca.nlpsol("optimum", "ipopt", problem, _IPOPT)
        free = np.full(n * _DEGREE * _INTERVALS, np.inf)
        points = _DEGREE * _INTERVALS
        self.lower = np.concatenate([-free, np.tile(plant.u_low, points)])
        self.upper = np.concatenate([free, np.tile(plant.u_high, points)])

    def _interval(self) -> ca.Function:
        """(x at its begin, x and u at its points, length) -> (defects, cost)."""
        plant, grid, n, m = self.plant, self.grid, self.plant.n, self.plant.m
        begin, length = ca.SX.sym("begin", n), ca.SX.sym("length")
        X, U = ca.SX.sym("X", n * _DEGREE), ca.SX.sym("U", m * _DEGREE)
        points = ca.horzcat(begin, ca.reshape(X, n, _DEGREE))
        inputs = ca.reshape(U, m, _DEGREE)
        slopes = points @ ca.SX(ca.DM(grid.slopes))
        defects, cost = [], ca.SX(0)
        for j in range(_DEGREE):
            x, u = points[:, j + 1], inputs[:, j]
            defects.append(slopes[:, j] - length * plant.dynamics(x, u))
            cost = cost + length * float(grid.weights[j]) * plant.running_cost(x, u)
        return ca.Function("interval", [begin, X, U, length], [ca.vertcat(*defects), cost])

    def response(
        self, start: Vector, guess: tuple[Vector, Vector, Vector] | None = None
    ) -> Optimal | None:
        """The response of least cost from a plant state; None where IPOPT does not find it.

        `guess` is a response (t, x (points, n), u (points, m)) to begin with.
        """
        states, inputs = self._straight(start) if guess is None else self._along(*guess)
        first = np.concatenate([states.ravel(), inputs.ravel()])
        with interruptible():
            found = self.solver(x0=first, p=start, lbx=self.lower, ubx=self.upper, lbg=0, ubg=0)
        if not self.solver.stats()["success"]:
            return None
        n, m = self.plant.n, self.plant.m
        values = np.asarray(found["x"], float).ravel()
        x = values[: n * len(self.grid.times)].reshape(-1, n)
        u = values[n * len(self.grid.times) :].reshape(-1, m)
        return Optimal(float(found["f"]), self.grid.times, x, u)

    def cost(self, start: Vector, guess: tuple[Vector, Vector, Vector] | None = None) -> float:
        """The least cost from a plant state; ∞ where IPOPT does not find it."""
        found = self.response(start, guess)
        return np.inf if found is None else found.cost

    def _along(self, t: Vector, x: Vector, u: Vector) -> tuple[Vector, Vector]:
        times = self.grid.times
        states, inputs = (
            np.column_stack([np.interp(times, t, column) for column in rows.T]) for rows in (x, u)
        )
        return states, inputs

    def _straight(self, start: Vector) -> tuple[Vector, Vector]:
        """Straight to the target, at the pace of LQR."""
        plant = self.plant
        pace = 1.0 if plant.linear is None else float(-plant.linear.spectrum.real.max())
        share = np.exp(-pace * self.grid.times)[:, None]
        inputs = np.repeat(plant.u_star[None], len(share), axis=0)
        return plant.x_star + share * (start - plant.x_star), inputs


def optimal_responses(
    plant: PlantModel, starts: Sequence[Vector], known: Sequence[Responses]
) -> list[Optimal | None]:
    """The response of least cost from each start, the best found from every known response.

    The known responses share their times, whose end is the horizon.
    """
    problem = Optimum(plant, float(known[0].t[-1]))
    best: list[Optimal | None] = []
    for index, start in enumerate(starts):
        arrived = [r for r in known if r.arrived[index]]
        tried = [problem.response(start, (r.t, r.x[index], r.u[index])) for r in arrived]
        found = [r for r in (tried or [problem.response(start)]) if r is not None]
        best.append(min(found, key=lambda r: r.cost, default=None))
    return best
