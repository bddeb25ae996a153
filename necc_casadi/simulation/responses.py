"""The closed loop in time: error-controlled integration by SUNDIALS' CVODES through CasADi."""

from __future__ import annotations

import time as clock
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import casadi as ca
import numpy as np
import numpy.typing as npt

from necc_casadi.arrays import Vector
from necc_casadi.designs.design import Design
from necc_casadi.interrupts import interruptible
from necc_casadi.simulation.saturated import disturbed_field, integrators

__all__ = [
    "SETTLED",
    "Trajectory",
    "default_horizon",
    "random_states",
    "response_from",
    "simulate",
    "slowest_decay",
]


#: A response has settled when it stays within this share of its first distance from z̄.
SETTLED = 0.02


#: A mode that decays slower than this share of its own frequency is taken as not decaying, and so
#: is one that is slower than this share of the fastest.
_DECAYS, _SLOWEST = 1e-4, 1e-7


#: Horizon of a loop of which no mode decays, in natural times.
_NOTHING_DECAYS = 30.0


#: Periods of the fastest oscillation that a response spans at most.
_MOST_PERIODS = 1000


#: Output times in a period of the fastest oscillation; of a response, at least and at most.
_IN_A_PERIOD, _FEWEST, _MOST = 16, 500, 4000


#: Error that a step allows, in natural units.
_RELATIVE, _ABSOLUTE = 1e-9, 1e-11


#: A response is integrated in so many pieces, each with so many steps between two outputs at most.
_PIECES, _MOST_STEPS = 5, 10_000


@dataclass(frozen=True, eq=False)
class Trajectory:
    """One closed-loop response on a time grid; units are the model's, times in seconds.

    Examples
    --------
    >>> from necc_casadi import design, find_casimirs, judge, load_model, parse_target, simulate
    >>> loop = load_model("pendulum.py").loop
    >>> x_star = parse_target(loop.plant, "pi/4")
    >>> casimirs = find_casimirs(loop)
    >>> made = design(loop, casimirs, judge(loop, casimirs, x_star), x_star)
    >>> response = simulate(made, [0.0, 0.0], points=201)
    >>> response.t.shape, response.z.shape, response.u.shape
    ((201,), (201, 3), (201, 1))
    >>> response.complete, response.converged, response.settling_time < 20
    (True, True, True)
    """

    t: Vector  # (N,) s
    z: Vector  # (N, n + nc) plant states, then controller states
    u: Vector  # (N, m) inputs, within the limits of the model
    V: Vector  # (N,) Lyapunov function
    z_bar: Vector  # (n + nc,) where it should go
    V_bar: float  # V(z̄)
    complete: bool  # False: the integrator gave up, the arrays end there
    size: Vector | float = 1.0  # (n + nc,) natural sizes, for distances
    cut: bool = False  # the time for computing was over
    demand: Vector | None = None  # (N, m) what the law asked for; None: u
    measured: Vector | None = None  # (N, n) what the controller takes; None: the plant's states
    zeta: Vector | None = None  # (N, m) of integral action

    @property
    def shown(self) -> Vector:
        """(N, n + nc): what the controller takes, then its states."""
        if self.measured is None:
            return self.z
        return np.hstack([self.measured, self.z[:, self.measured.shape[1] :]])

    @property
    def settling_time(self) -> float:
        """Time after which ‖z − z̄‖ stays within 2 % of its initial value, s; inf if never.

        The norm is that of natural units.
        """
        away = (self.z - self.z_bar) / self.size
        if not np.all(np.isfinite(away)):
            return float("inf")
        largest = float(np.abs(away).max()) or 1.0  # so that squares do not overflow
        distance = np.linalg.norm(away / largest, axis=1)
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

    @property
    def saturated(self) -> bool:
        """Whether the law asked for more than the limits of the model."""
        return self.demand is not None and bool(np.any(np.abs(self.demand - self.u) > 0))

    def csv(self, names: Sequence[str], inputs: Sequence[str] = ()) -> str:
        """The response as CSV with a header: t, what is measured, ξ, inputs (u1 … um), V."""
        inputs = inputs or [f"u{i + 1}" for i in range(self.u.shape[1])]
        header = ["t", *names, *inputs, "V"]
        rows = np.column_stack([self.t, self.shown, self.u, self.V])
        lines = [",".join(header), *[",".join(map(repr, map(float, row))) for row in rows]]
        return "\n".join(lines) + "\n"


@lru_cache(maxsize=4)
def default_horizon(design: Design) -> float:
    """A time in which the slowest decaying mode falls well below 2 %, s.

    No more than so many periods of the fastest oscillation: a lossless line with many states
    takes longer to settle than anyone wants to integrate with error control.
    """
    spectrum = design.spectrum
    pace = slowest_decay(spectrum)
    settled = 8.0 / pace if pace else _NOTHING_DECAYS * design.units.time
    oscillation = float(np.abs(spectrum.imag).max())
    return min(settled, _MOST_PERIODS * 2 * np.pi / oscillation) if oscillation else settled


def slowest_decay(spectrum: npt.NDArray[np.complex128] | Vector) -> float:
    """The least rate at which a mode decays, 0 where none does.

    The current of a winding may be over 10⁵ times as fast as what it moves.
    """
    speed, decay = np.abs(spectrum), -np.real(spectrum)
    decays = (decay > _DECAYS * speed) & (speed > _SLOWEST * speed.max())
    return float(decay[decays].min()) if decays.any() else 0.0


def random_states(design: Design, count: int, seed: int = 0) -> list[Vector]:
    """Plant states drawn uniformly from the middle half of the domain, (n,) each."""
    rng = np.random.default_rng(seed)
    n = design.loop.plant.n
    lo, hi = design.domain.lo, design.domain.hi
    return [
        z[:n] for z in rng.uniform(0.75 * lo + 0.25 * hi, 0.25 * lo + 0.75 * hi, (count, len(lo)))
    ]


def simulate(
    design: Design,
    x0: npt.ArrayLike,
    xi0: npt.ArrayLike | None = None,
    *,
    time: float | None = None,
    points: int | None = None,
    patience: float = np.inf,
    disturbance: npt.ArrayLike | None = None,
) -> Trajectory:
    """Integrate the damped closed loop from (x0, ξ0), u within the limits of the model.

    Parameters
    ----------
    design
        The design.
    x0
        What is measured at first, (n,): the plant's state, or (q, q̇).
    xi0
        Controller state (nc,); by default the one of the design, as ``necc_start`` sets it.
    time
        Horizon, s; by default long enough for the slowest mode.
    points
        Number of output times; by default 501, or as many as show the fastest oscillation.
    patience
        Seconds of computing after which the response is cut; some stiff loops take very long.
    disturbance
        Constant d (m,), added to what the plant gets.

    Returns
    -------
    Trajectory
        At `points` times; where the integrator gives up, ``complete`` is False and the arrays end.

    References
    ----------
    Hindmarsh et al. (2005), CVODES.

    Examples
    --------
    >>> from necc_casadi import design, find_casimirs, judge, load_model, parse_target, simulate
    >>> loop = load_model("pendulum.py").loop
    >>> x_star = parse_target(loop.plant, "pi/4")
    >>> casimirs = find_casimirs(loop)
    >>> made = design(loop, casimirs, judge(loop, casimirs, x_star), x_star)
    >>> response = simulate(made, [0.0, 0.0])
    >>> bool(abs(response.z[-1] - made.z_bar).max() < 1e-2)
    True
    """
    at = design.lyapunov.state(x0)
    return response_from(
        design, at, xi0, time=time, points=points, patience=patience, disturbance=disturbance
    )


def response_from(
    design: Design,
    x0: npt.ArrayLike,
    xi0: npt.ArrayLike | None = None,
    *,
    time: float | None = None,
    points: int | None = None,
    patience: float = np.inf,
    disturbance: npt.ArrayLike | None = None,
) -> Trajectory:
    """The same from a state of the plant, (n,), whatever is measured of it."""
    natural, units = design.natural, design.units
    V = natural.lyapunov
    xi = design.xi_at_state(x0) if xi0 is None else np.asarray(xi0, float)
    z0 = np.concatenate([np.asarray(x0, float), xi]) / units.state
    horizon = default_horizon(design) if time is None else float(time)
    points = _enough_points(design, horizon) if points is None else points
    grid = np.linspace(0.0, horizon, points)
    m, n, N = V.terms.m, V.terms.n, len(z0)
    d = (np.zeros(m) if disturbance is None else np.asarray(disturbance, float)) / units.input
    w0 = np.concatenate([z0, np.zeros(integrators(design))])
    both, cut = _integrated(natural, w0, grid / units.time, patience, d)
    states, zeta, count = both[:, :N], both[:, N:], len(both)
    kept = np.hstack([V.stored(states[:, :n], states[:, n:]), zeta])
    u, _, demand = (
        np.asarray(v, float).T for v in natural.limited_controller.call([states[:, :n].T, kept.T])
    )
    return Trajectory(
        t=grid[:count],
        z=states * units.state,
        u=u * units.input,
        V=V.V(states) * units.energy,
        z_bar=design.z_bar,
        V_bar=natural.V(natural.z_bar) * units.energy,
        complete=count == points and bool(np.all(np.isfinite(states))),
        size=design.sizes.state,
        cut=cut,
        demand=demand * units.input,
        measured=design.lyapunov.measured(states[:, :n] * units.state[:n])
        if design.measurement.of_velocities
        else None,
        zeta=zeta * units.input if zeta.size else None,
    )


def _enough_points(design: Design, horizon: float) -> int:
    """Output times between which the fastest oscillation does not turn."""
    periods = horizon * float(np.abs(design.spectrum.imag).max()) / (2 * np.pi)
    return int(np.clip(_IN_A_PERIOD * periods, _FEWEST, _MOST)) + 1


def _integrated(
    design: Design, z0: Vector, grid: Vector, patience: float, d: Vector
) -> tuple[Vector, bool]:
    """States at the times of an equidistant grid, as far as they were reached; whether cut."""
    began, found = clock.monotonic(), [z0[None, :]]
    count = -(-(len(grid) - 1) // _PIECES)  # outputs of one piece
    try:
        with interruptible():
            for done in range(0, len(grid) - 1, count):
                if clock.monotonic() - began > patience:
                    return np.concatenate(found), True
                few = min(count, len(grid) - 1 - done)
                integrator = _integrator(design, float(grid[1]), few)
                ends = np.asarray(integrator(x0=found[-1][-1], p=d)["xf"], float).T
                found.append(ends)
                if not np.all(np.isfinite(ends)):
                    break
    except RuntimeError:  # the integrator's way to say that it cannot go on
        pass
    return np.concatenate(found), False


@lru_cache(maxsize=8)
def _integrator(design: Design, step: float, count: int) -> ca.Function:
    """CVODES from (z, ζ) over `count` equidistant times; kept, because building it takes longer."""
    w = ca.MX.sym("w", len(design.loop.z) + integrators(design))
    d = ca.MX.sym("d", design.loop.plant.m)
    options = {
        "abstol": _ABSOLUTE,
        "reltol": _RELATIVE,
        "max_num_steps": _MOST_STEPS,
        "show_eval_warnings": False,
        "disable_internal_warnings": True,
    }
    field = {"x": w, "p": d, "ode": disturbed_field(design)(w, d)}
    grid = (step * np.arange(1, count + 1)).tolist()
    return ca.integrator("response", "cvodes", field, 0.0, grid, options)
