"""The closed loop in time: error-controlled integration by SUNDIALS' CVODES through CasADi."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import casadi as ca
import numpy as np
import numpy.typing as npt

from necc_casadi.artifact import Design
from necc_casadi.interrupts import interruptible
from necc_casadi.networks import Vector

__all__ = [
    "Arrivals",
    "Trajectory",
    "converging",
    "default_horizon",
    "random_states",
    "simulate",
    "simulated_share",
]

#: A response has settled when it stays within this share of its first distance from z̄.
SETTLED = 0.02
#: A mode that decays slower than this share of the fastest rate is taken as not decaying.
_DECAYS = 1e-4
#: Periods of the fastest oscillation that a response spans at most.
_MOST_PERIODS = 1000
_RELATIVE, _ABSOLUTE = 1e-9, 1e-11
#: Many starts at once: one that comes this close, as a share of its first distance, converges.
_ARRIVED = 0.01
#: One that gets this many times as far from z̄ as the domain reaches does not.
_LOST = 50.0
#: Horizons that it may take: far from z̄ the linearisation says little about time.
_PATIENCE = 4.0
#: Steps per start at most, for up to so many states and fewer for more; the shortest step.
_MOST_STEPS, _FEW_STATES, _LEAST_STEP = 4000, 8, 1e-7
#: Random states that a simulated share rests on, and at least for loops with many states.
_SAMPLES, _FEWEST_SAMPLES = 200, 20


@dataclass(frozen=True, eq=False)
class Trajectory:
    """One closed-loop response on a time grid."""

    t: Vector  # (N,) s
    z: Vector  # (N, n + nc) plant states, then controller states
    u: Vector  # (N, m) inputs
    V: Vector  # (N,) Lyapunov function
    z_bar: Vector  # (n + nc,) where it should go
    V_bar: float  # V(z̄)
    complete: bool  # False: the integrator gave up, the arrays end there

    @property
    def settling_time(self) -> float:
        """Time after which ‖z − z̄‖ stays within 2 % of its initial value, s; inf if never."""
        away = self.z - self.z_bar
        if not np.all(np.isfinite(away)):
            return float("inf")
        size = float(np.abs(away).max()) or 1.0  # so that squares of huge states do not overflow
        distance = np.linalg.norm(away / size, axis=1)
        outside = np.flatnonzero(distance > SETTLED * distance[0])
        if outside.size == 0:
            return 0.0
        if not self.complete or outside[-1] + 1 >= len(self.t):
            return float("inf")
        return float(self.t[outside[-1] + 1])

    @property
    def converged(self) -> bool:
        """Whether it has settled within the horizon."""
        return bool(np.isfinite(self.settling_time))

    @property
    def peak_input(self) -> float:
        """Max |u| over time and inputs."""
        return float(np.abs(self.u).max())

    def csv(self, names: Sequence[str]) -> str:
        """The response as CSV with a header: t, states, inputs, V."""
        header = ["t", *names, *[f"u{i + 1}" for i in range(self.u.shape[1])], "V"]
        rows = np.column_stack([self.t, self.z, self.u, self.V])
        lines = [",".join(header), *[",".join(map(repr, map(float, row))) for row in rows]]
        return "\n".join(lines) + "\n"


@lru_cache(maxsize=4)
def default_horizon(design: Design) -> float:
    """A time in which the slowest decaying mode falls well below 2 %, s.

    No more than so many periods of the fastest oscillation: a lossless line with many states
    takes longer to settle than anyone wants to integrate with error control.
    """
    spectrum = np.linalg.eigvals(design.lyapunov.linearisation(design.z_bar))
    fastest = float(np.abs(spectrum).max())
    decaying = [-v.real for v in spectrum if -v.real > _DECAYS * fastest]
    settled = 8.0 / min(decaying) if decaying else 30.0
    oscillation = float(np.abs(spectrum.imag).max())
    return min(settled, _MOST_PERIODS * 2 * np.pi / oscillation) if oscillation else settled


def random_states(design: Design, count: int, seed: int = 0) -> list[Vector]:
    """Plant states drawn uniformly from the middle half of the domain, (n,) each."""
    rng = np.random.default_rng(seed)
    n = design.loop.plant.n
    lo, hi = domain_box(design)
    return [
        z[:n] for z in rng.uniform(0.75 * lo + 0.25 * hi, 0.25 * lo + 0.75 * hi, (count, len(lo)))
    ]


def domain_box(design: Design) -> tuple[Vector, Vector]:
    """Lower and upper corner of the region of interest, (n + nc,): z* ± 2 where none is given."""
    lo, hi = design.z_star - 2.0, design.z_star + 2.0
    for index, name in enumerate(design.loop.states):
        if name in design.loop.plant.domain:
            lo[index], hi[index] = (float(b) for b in design.loop.plant.domain[name])
    return lo, hi


def simulate(
    design: Design,
    x0: npt.ArrayLike,
    xi0: npt.ArrayLike | None = None,
    *,
    time: float | None = None,
    points: int = 501,
) -> Trajectory:
    """Integrate the damped closed loop from (x0, ξ0).

    Parameters
    ----------
    design
        The design.
    x0
        Plant state (n,).
    xi0
        Controller state (nc,); ξ* by default, as ``necc_init`` sets it.
    time
        Horizon, s; by default long enough for the slowest mode.
    points
        Number of output times.
    """
    V = design.lyapunov
    xi = design.xi_star if xi0 is None else np.asarray(xi0, float)
    z0 = np.concatenate([np.asarray(x0, float), xi])
    grid = np.linspace(0.0, default_horizon(design) if time is None else float(time), points)
    integrator = _integrator(design, float(grid[-1]), points)
    try:
        with interruptible():
            states = np.column_stack([z0, np.asarray(integrator(x0=z0)["xf"], float)]).T
        complete = bool(np.all(np.isfinite(states)))
    except RuntimeError:  # the integrator's way to say that it cannot go on
        states, complete = z0[None, :], False
    n, count = V.terms.n, len(states)
    inputs, _ = V.control_law.map(count)(states[:, :n].T, states[:, n:].T)
    values = V.V.map(count)(states.T)
    return Trajectory(
        t=grid[: len(states)],
        z=states,
        u=np.asarray(inputs, float).reshape(V.terms.m, count).T,
        V=np.asarray(values, float).ravel(),
        z_bar=design.z_bar,
        V_bar=design.V(design.z_bar),
        complete=complete,
    )


@lru_cache(maxsize=4)
def _integrator(design: Design, horizon: float, points: int) -> ca.Function:
    """CVODES from z0 over `points` equidistant times; kept, because building it takes longer."""
    z = ca.MX.sym("z", len(design.loop.z))
    options = {
        "abstol": _ABSOLUTE,
        "reltol": _RELATIVE,
        "max_num_steps": 100_000,
        "show_eval_warnings": False,
        "disable_internal_warnings": True,
    }
    field = {"x": z, "ode": design.lyapunov.vector_field(z)}
    grid = np.linspace(0.0, horizon, points)[1:].tolist()
    return ca.integrator("response", "cvodes", field, 0.0, grid, options)


@dataclass(frozen=True, eq=False)
class Arrivals:
    """Which of many starts reach z̄."""

    arrived: npt.NDArray[np.bool_]  # (B,) came to within 1 % of the first distance
    unfinished: npt.NDArray[np.bool_]  # (B,) ran out of steps: not known


def converging(design: Design, starts: npt.ArrayLike, *, tolerance: float = 1e-4) -> Arrivals:
    """Whether the loop comes near z̄ within some default horizons, from states (B, n + nc).

    Bogacki and Shampine's pair of orders 3 and 2 on all states at once, each with its own step.
    """
    horizon, z_bar = _PATIENCE * default_horizon(design), design.z_bar[:, None]
    z = np.array(starts, float).T
    lo, hi = domain_box(design)
    lost = _LOST * float(np.linalg.norm(hi - lo))
    near = _ARRIVED * np.linalg.norm(z - z_bar, axis=0)
    arrived = near == 0
    alive = np.flatnonzero(~arrived)
    t, h = np.zeros(z.shape[1]), np.full(z.shape[1], horizon / 1000)
    field = design.lyapunov.vector_field
    slope = np.array(field(z), float)
    for _ in range(_MOST_STEPS * _FEW_STATES // max(_FEW_STATES, len(z))):
        if alive.size == 0:
            break
        with interruptible(), np.errstate(all="ignore"):
            step, start = np.minimum(h[alive], horizon - t[alive]), z[:, alive]
            end, end_slope, error = _step(field, start, slope[:, alive], step, tolerance)
            good = error <= 1
            moved = alive[good]
            z[:, moved], slope[:, moved] = end[:, good], end_slope[:, good]
            t[moved] += step[good]
            growth = np.clip(0.9 * np.fmax(error, 1e-9) ** (-1 / 3), 0.2, 5.0)
            h[alive] = step * np.where(np.isfinite(error), growth, 0.2)
            distance = np.linalg.norm(z[:, alive] - z_bar, axis=0)
        arrived[alive] = distance <= near[alive]
        short = (h[alive] < _LEAST_STEP * horizon) & ~good
        going = (distance < lost) & (t[alive] < horizon * (1 - 1e-9)) & ~short
        alive = alive[going & ~arrived[alive]]
    unfinished = np.zeros(z.shape[1], dtype=bool)
    unfinished[alive] = True
    return Arrivals(arrived, unfinished)


def _step(
    field: ca.Function, z: Vector, k1: Vector, h: Vector, tolerance: float
) -> tuple[Vector, Vector, Vector]:
    """(z, ż) after one step, and its error against the tolerance."""
    k2 = np.array(field(z + 0.5 * h * k1), float)
    k3 = np.array(field(z + 0.75 * h * k2), float)
    end = z + h * (2 * k1 + 3 * k2 + 4 * k3) / 9
    k4 = np.array(field(end), float)
    difference = h * (-5 * k1 / 72 + k2 / 12 + k3 / 9 - k4 / 8)
    scale = tolerance * (0.01 + np.fmax(np.abs(z), np.abs(end)))
    return end, k4, np.asarray(np.abs(difference / scale).max(axis=0))


def simulated_share(design: Design, resting: Sequence[int], seed: int = 0) -> float | None:
    """Share of random states of the domain from which the loop converges; None: not known.

    The plant states `resting` start at 0, as a certificate's share of the domain has them.
    """
    lo, hi = domain_box(design)
    count = max(_FEWEST_SAMPLES, int(_SAMPLES * min(1.0, (_FEW_STATES / lo.size) ** 2)))
    starts = np.random.default_rng(seed).uniform(lo, hi, (count, lo.size))
    starts[:, list(resting)] = 0.0
    found = converging(design, starts)
    return None if found.unfinished.any() else float(found.arrived.mean())
