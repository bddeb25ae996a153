"""Natural sizes: what a large value of each state, input, energy and time is.

Sizes that the user gives, or a domain and input limits imply, are taken as they are. The others
follow from the plant and the target: an angle is large at 1 rad, another coordinate at the
distance of the target from rest. That displacement has an energy E, which gives every further
state its size, E = ½ s² ∂²H + ½ s² ∂²H at the turn from one to the other, so s = √(E/∂²H).
Means are geometric: a mean of energies or rates in other units is the same mean.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import sympy as sp

from necc_casadi.arrays import Truth, Vector
from necc_casadi.model.closed_loop import ClosedLoop
from necc_casadi.model.control_affine import Preliminary
from necc_casadi.model.controller import Controller
from necc_casadi.model.plant import Plant
from necc_casadi.symbolic.derivatives import at, gradient
from necc_casadi.symbolic.floats import to_float

__all__ = ["REACH", "Sizes", "natural_sizes", "power_of_two", "with_casimirs"]

#: Sizes from the middle to the end of a domain.
REACH = 2
#: A slope that moves the target by less than this share of it is rounding.
_ROUNDING = 1e-12


@dataclass(frozen=True, eq=False)
class Sizes:
    """Positive sizes of the states, inputs and Casimirs, of energy and time."""

    state: Vector  # (n + nc,)
    input: Vector  # (m,)
    energy: float
    time: float
    casimir: Vector  # (r,)
    guessed: tuple[str, ...] = ()  # states and inputs whose size nobody gave

    @classmethod
    def ones(cls, states: int, inputs: int, casimirs: int) -> Sizes:
        """The units of the model itself."""
        return cls(np.ones(states), np.ones(inputs), 1.0, 1.0, np.ones(casimirs))

    @cached_property
    def units(self) -> Sizes:
        """The nearest powers of two: to measure in them is exact in binary arithmetic."""
        return Sizes(
            state=_each(self.state),
            input=_each(self.input),
            energy=power_of_two(self.energy),
            time=power_of_two(self.time),
            casimir=_each(self.casimir),
        )

    @property
    def are_ones(self) -> bool:
        """Whether these are the units of the model itself."""
        parts = [self.state, self.input, self.casimir, np.array([self.energy, self.time])]
        return bool(np.all(np.concatenate(parts) == 1))

    def measured_in(self, units: Sizes) -> Sizes:
        """The same sizes in other units."""
        return Sizes(
            state=self.state / units.state,
            input=self.input / units.input,
            energy=self.energy / units.energy,
            time=self.time / units.time,
            casimir=self.casimir / units.casimir,
            guessed=self.guessed,
        )

    @property
    def stiffness(self) -> Vector:
        """Energy over squared size of each state, (n + nc,)."""
        return np.asarray(self.energy / self.state**2, float)

    @property
    def output(self) -> Vector:
        """Size of y, (m,): u and y are a pair of power ports."""
        return np.asarray(self.energy / (self.time * self.input), float)


def power_of_two(value: float) -> float:
    """The power of two that is nearest in ratio."""
    mantissa, exponent = np.frexp(value)  # mantissa in [1/2, 1)
    return float(np.ldexp(1.0, int(exponent) - (mantissa < np.sqrt(0.5))))


def _each(values: Vector) -> Vector:
    return np.array([power_of_two(value) for value in values], float)


def natural_sizes(
    loop: ClosedLoop,
    casimirs: Sequence[sp.Expr],
    x_star: Mapping[sp.Symbol, sp.Expr],
    xi: Vector | None = None,
) -> Sizes:
    """The natural sizes of a loop at a target.

    Every size is positive and finite, whatever the model. If a state, the energy or time is
    measured in another unit, its size is the same in that unit; to the last bit where the units
    differ by a power of two.

    Parameters
    ----------
    loop
        Plant and controller.
    casimirs
        Functions of z; they carry the sizes of plant states over to the controller.
    x_star
        Target, exact.
    xi
        Controller state at which the Casimirs are looked at, (nc,); 0 by default.
    """
    with np.errstate(all="ignore"):  # what overflows is left out of every mean
        found = _by_displacement(loop, casimirs, x_star, xi)
        if loop.plant.preliminary is None:
            return found
        return _behind_feedback(loop, loop.plant.preliminary, found, casimirs, x_star, xi)


def _by_displacement(
    loop: ClosedLoop,
    casimirs: Sequence[sp.Expr],
    x_star: Mapping[sp.Symbol, sp.Expr],
    xi: Vector | None,
) -> Sizes:
    """The sizes that follow from the displacement of the target and the energy that it takes."""
    plant = loop.plant
    given = _given(loop)
    local = _Local.of(plant, x_star)
    known = np.array([given.get(name, np.nan) for name in plant.states])
    known = np.where(np.isnan(known), _displacements(plant, x_star, local), known)
    slopes = _slopes(loop, casimirs, x_star, xi)
    own = geometric_mean(local.periods) or geometric_mean(local.decays)
    energy = _energy(plant, given, local, known, own or 1.0, slopes)
    # a coordinate that goes along stores nothing: the energy is that of its own displacement
    state = _by_energy(local, _following(plant, given, local, known), energy)
    time = geometric_mean(local.periods) or geometric_mean(local.passages(state)) or own or 1.0
    state = _by_velocity(local, state, time)
    inputs = [
        given.get(name, _input_size(local, state, time, k))
        for k, name in enumerate(plant.input_names)
    ]
    entries = [*casimirs, *(e for matrix in loop.matrices for e in matrix.todok().values())]
    turning = _turning(entries, loop.controller.xi)
    controller = _controller_sizes(
        loop, turning | given, slopes, state, energy, np.array(inputs), xi
    )
    names = (*loop.states, *plant.input_names)
    everything = _sound(np.concatenate([state, controller]))
    return Sizes(
        state=everything,
        input=_sound(np.array(inputs)),
        energy=float(_sound(np.array([energy]))[0]),
        time=float(_sound(np.array([time]))[0]),
        casimir=_casimir_sizes(slopes, everything),
        guessed=tuple(name for name in names if name not in given),
    )


def _behind_feedback(
    loop: ClosedLoop,
    ahead: Preliminary,
    found: Sizes,
    casimirs: Sequence[sp.Expr],
    x_star: Mapping[sp.Symbol, sp.Expr],
    xi: Vector | None,
) -> Sizes:
    """Of a structure that feedback makes: states and inputs as the plant itself has them.

    The structure's energy may be of any unit and its quadratic form far from diagonal: energy is
    the mean of its curvatures in these sizes, time that of the plant's own rates.
    """
    plant, n = loop.plant, loop.plant.n
    state, inputs, guessed = found.state[:n], found.input, found.guessed
    if isinstance(ahead.origin, Plant):
        none = sp.ImmutableMatrix(sp.zeros(0, 0))
        alone = ClosedLoop(ahead.origin, Controller((), none, none, none))
        own = natural_sizes(alone, (), x_star)
        state, inputs = own.state, own.input
        left = set(loop.controller.states) & set(found.guessed)
        guessed = (*own.guessed[: len(own.guessed)], *sorted(left))
    rates = _numbers(at(sp.Matrix(plant.drift).jacobian(plant.x), x_star))
    curvature = _numbers(at(sp.hessian(plant.H, plant.x), x_star)) * np.outer(state, state)
    speeds = np.abs(np.linalg.eigvals(rates)).astype(np.float64)
    times = [1 / rate for rate in _significant(speeds)]
    bends = np.linalg.eigvalsh(curvature).astype(np.float64)
    energy = geometric_mean(_significant(bends)) or found.energy
    slopes = _slopes(loop, casimirs, x_star, xi)
    known = _given(loop)
    inner = _controller_sizes(loop, known, slopes, state, energy, inputs, xi)
    state = np.where(_free(plant, known, x_star), _as_seen(slopes, state, inner), state)
    everything = _sound(np.concatenate([state, inner]))
    return Sizes(
        state=everything,
        input=_sound(inputs),
        energy=float(_sound(np.array([energy]))[0]),
        time=geometric_mean(times) or found.time,
        casimir=_casimir_sizes(slopes, everything),
        guessed=guessed,
    )


def _significant(values: Vector) -> list[float]:
    """Those that are no rounding of the largest one."""
    largest = float(np.max(values, initial=0.0))
    return [float(v) for v in values if v > _ROUNDING * largest]


def _free(plant: Plant, known: Mapping[str, float], x_star: Mapping[sp.Symbol, sp.Expr]) -> Truth:
    """States at 0 in which nothing of the plant repeats or is displaced, and nobody gave a size."""
    used = plant.drift.free_symbols | plant.directions.free_symbols
    return np.array([s not in used and str(s) not in known and x_star[s] == 0 for s in plant.x])


def _as_seen(slopes: Vector, state: Vector, inner: Vector) -> Vector:
    """Sizes of plant states at which a Casimir is as large as the controller states are, if more.

    A wheel that balances a pendulum turns many times: 1 rad of it is little.
    """
    n = len(state)
    reach = np.max(slopes[:, n:] * inner, axis=1, initial=0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        seen = np.where(slopes[:, :n] > 0, reach[:, None] / slopes[:, :n], np.inf)
    least = seen.min(axis=0, initial=np.inf)
    return np.where(np.isfinite(least), np.fmax(state, least), state)


def with_casimirs(
    sizes: Sizes,
    loop: ClosedLoop,
    casimirs: Sequence[sp.Expr],
    x_star: Mapping[sp.Symbol, sp.Expr],
    xi: Vector,
) -> Sizes:
    """The same sizes beside those of other functions of z."""
    slopes = _slopes(loop, casimirs, x_star, xi)
    return replace(sizes, casimir=_casimir_sizes(slopes, sizes.state))


def _casimir_sizes(slopes: Vector, state: Vector) -> Vector:
    """Sizes of functions with these slopes (r, n + nc) in states of these sizes, (r,)."""
    return _sound(np.max(slopes * state, axis=1, initial=0.0))


def _sound(sizes: Vector) -> Vector:
    """Positive and finite: 1 where nothing is known."""
    with np.errstate(over="ignore", divide="ignore"):
        good = np.isfinite(sizes) & (sizes > 0) & np.isfinite(1 / sizes**2)
    return np.where(good & (sizes**2 > 0), sizes, 1.0)


def geometric_mean(values: Iterable[float]) -> float | None:
    """Geometric mean of the positive finite ones; None without any.

    A common power of two in the values is the same power in the mean, exactly.
    """
    good = [float(v) for v in values if 0 < v < np.inf]
    if len(good) < 2:
        return good[0] if good else None
    mantissas, exponents = np.frexp(np.sort(good))
    whole, rest = divmod(int(exponents.sum()), len(good))
    return float(np.ldexp(np.exp2((np.log2(mantissas).sum() + rest) / len(good)), whole))


def _given(loop: ClosedLoop) -> dict[str, float]:
    """Sizes that the user names, or that a domain or input limits imply."""
    plant = loop.plant
    sizes = {
        name: float(hi - lo) / (2 * REACH)
        for name, (lo, hi) in plant.domain.items()
        if name in loop.states
    }
    limits = plant.u_limits or ()
    for name, (lo, hi) in zip(plant.input_names, limits, strict=False):
        sizes[name] = (hi - lo) / 2
    return sizes | {name: float(size) for name, size in plant.sizes.items()}


@dataclass(frozen=True, eq=False)
class _Local:
    """What the plant is like at the target."""

    slope: Vector  # (n,) |∂H|
    curvature: Vector  # (n,) |∂²H|
    bends: Vector  # (n, n) |∇²H|
    M: Vector  # (n, n) |J − R|
    G: Vector  # (n, m) |G|
    holding: Vector  # (m,) |u*|

    @classmethod
    def of(cls, plant: Plant, x_star: Mapping[sp.Symbol, sp.Expr]) -> _Local:
        pairs = zip(plant.grad_H, plant.x, strict=True)
        second = sp.Matrix([sp.diff(slope, s) for slope, s in pairs])
        hessian = sp.hessian(plant.H, plant.x)
        slope, curvature, bends, M, G, drift = (
            _numbers(at(sp.Matrix(matrix), x_star))
            for matrix in (
                plant.grad_H, second, hessian, plant.J - plant.R, plant.directions, plant.drift
            )
        )  # fmt: skip
        scale = np.abs(M) @ np.abs(slope)
        force = np.where(np.abs(drift) > _ROUNDING * scale, drift, 0.0).ravel()
        holding = np.array([_least_squares(G[:, k], force) for k in range(plant.m)])
        return cls(
            np.abs(slope).ravel(), np.abs(curvature).ravel(), np.abs(bends), np.abs(M), np.abs(G),
            holding,
        )  # fmt: skip

    @property
    def periods(self) -> list[float]:
        """1/max_j |M_ij| √(∂²H_i ∂²H_j): in which a state exchanges what it stores, s."""
        root = np.sqrt(np.outer(self.curvature, self.curvature))
        rates = (root * np.maximum(self.M, self.M.T))[~np.eye(len(root), dtype=bool)]
        fastest = rates.reshape(len(root), -1).max(axis=1, initial=0.0)
        return [float(1 / rate) for rate in fastest if rate > 0]

    @property
    def decays(self) -> list[float]:
        """Time constants of states that dissipate what they store, s."""
        rates = np.diag(self.M) * self.curvature
        return [float(1 / rate) for rate in rates if rate > 0]

    def passages(self, size: Vector) -> list[float]:
        """Times in which states without curvature travel their size, s."""
        speeds = (self.M * (self.curvature * np.nan_to_num(size))).max(axis=1)
        return [
            float(size[i] / speed)
            for i, speed in enumerate(speeds)
            if self.curvature[i] == 0 and speed > 0
        ]


def _numbers(matrix: sp.MatrixBase) -> Vector:
    """The matrix in floats; what is not a finite real number is 0: nothing is known from it."""

    def number(value: sp.Expr) -> float:
        try:
            result = to_float(value)
        except (TypeError, ValueError, OverflowError):
            return 0.0
        return result if np.isfinite(result) else 0.0

    return np.array([[number(v) for v in row] for row in matrix.tolist()], float).reshape(
        matrix.shape
    )


def _least_squares(column: Vector, force: Vector) -> float:
    """|u| with column·u nearest to the force in the largest entry of the column."""
    i = int(np.argmax(np.abs(column)))
    return float(abs(force[i] / column[i])) if column[i] else 0.0


def _displacements(plant: Plant, x_star: Mapping[sp.Symbol, sp.Expr], local: _Local) -> Vector:
    """Sizes of angles, and of states whose target is not at rest; nan for the others, (n,)."""
    angles = _angles(plant)
    result = np.full(plant.n, np.nan)
    target = np.abs(_numbers(sp.Matrix([x_star[s] for s in plant.x])).ravel())
    for i, name in enumerate(plant.states):
        slope, curvature, away = local.slope[i], local.curvature[i], target[i]
        to_rest = slope / curvature if curvature > 0 else np.inf
        if plant.preliminary is not None and to_rest <= _ROUNDING * away:
            to_rest = away  # a feedback has moved rest to the target: 0 is what is left
        if name in angles:
            result[i] = angles[name]
        elif to_rest > _ROUNDING * away and to_rest > 0:  # at rest by itself: no displacement
            distance = min(to_rest, away) if away > 0 else to_rest
            result[i] = distance if 0 < distance < np.inf else np.nan
    return result


def _following(plant: Plant, given: Mapping[str, float], local: _Local, known: Vector) -> Vector:
    """The same, and no less than how far a state goes along with an angle that springs tie it to.

    The preload of a spring is little beside its way: behind a stiff shaft a motor turns as far as
    the load does.
    """
    angles = _angles(plant)
    free = [i for i, s in enumerate(plant.states) if s not in angles and s not in given]
    reach = np.where([s in angles for s in plant.states], known, 0.0)
    for _ in free:  # from one to the next, along a chain of springs
        for i in free:
            if local.curvature[i] > 0:
                others = np.where(np.arange(plant.n) == i, 0.0, local.bends[i])
                along = float((others * reach).max() / local.curvature[i])
                reach[i] = max(reach[i], min(along, reach.max(initial=0.0)))
    return np.where(reach > 0, np.fmax(known, reach), known)


def _angles(plant: Plant) -> dict[str, float]:
    """1 rad for each state that is an angle: by its unit, or as a linear part of sin, cos, tan."""
    found = {name: 1.0 for name, unit in plant.units.items() if unit == "rad"}
    return _turning([plant.H, *plant.J, *plant.R, *plant.G], plant.x) | found


def _turning(entries: Iterable[sp.Expr], states: Iterable[sp.Symbol]) -> dict[str, float]:
    """1 rad for each state that is a linear part of an angle of sin, cos or tan."""
    waves = set().union(*(sp.sympify(e).atoms(sp.sin, sp.cos, sp.tan) for e in entries))
    least: dict[str, float] = {}
    for wave in waves:
        for s in wave.args[0].free_symbols & set(states):
            turns = sp.diff(wave.args[0], s)
            if turns.is_number:
                factor = abs(float(turns))
                least[str(s)] = min(factor, least.get(str(s), np.inf))
    return {name: 1 / factor for name, factor in least.items() if factor > 0}


def _energy(
    plant: Plant,
    given: Mapping[str, float],
    local: _Local,
    known: Vector,
    time: float,
    slopes: Vector,
) -> float:
    """Energy of the displacement; where it takes none, of the inputs or of the motion."""
    n = plant.n
    has = ~np.isnan(known)
    size = np.where(has, known, 0.0)
    stored = np.maximum(size**2 * local.curvature, size * local.slope)
    turns = np.array([name in _angles(plant) for name in plant.states])
    falls = has & ~turns & (local.curvature == 0)
    stored[falls] *= 2 * REACH  # a uniform field: what is gained across the whole range
    found = geometric_mean(stored[has])
    if found is not None:
        return found
    inputs = [given.get(name, 0.0) for name in plant.input_names]
    seen = np.max(np.abs(slopes[:, :n]) * size, axis=1, initial=0.0)
    work = [u * reach for u in inputs for reach in seen]
    found = geometric_mean(work)
    if found is not None:
        return found
    # what moves the states across their sizes in the natural time
    moving = []
    for j in map(int, np.flatnonzero(local.curvature)):
        flows = [size[i] / (time * local.M[i, j]) for i in range(n) if local.M[i, j] > 0]
        moving.append(min((f for f in flows if f > 0), default=0.0) ** 2 / local.curvature[j])
    return geometric_mean(moving) or 1.0


def _by_energy(local: _Local, known: Vector, energy: float) -> Vector:
    """States without a size get the one at which they hold the energy."""
    with np.errstate(divide="ignore", invalid="ignore"):
        by_curvature = np.sqrt(energy / local.curvature)
        by_slope = energy / local.slope
    found = np.where(local.curvature > 0, by_curvature, by_slope)
    return np.where(np.isnan(known), np.where(np.isfinite(found), found, np.nan), known)


def _by_velocity(local: _Local, size: Vector, time: float) -> Vector:
    """States that hold no energy get the distance that they travel in the natural time."""
    result = size.copy()
    held = np.where(np.isnan(size), 0.0, size)
    for i in map(int, np.flatnonzero(np.isnan(size))):
        speeds = local.M[i] * local.curvature * held
        result[i] = time * speeds.max() if speeds.max() > 0 else 1.0
    return result


def _input_size(local: _Local, state: Vector, time: float, k: int) -> float:
    """What holds the target, or moves a state by its size in the natural time: the larger."""
    acts = local.G[:, k] > 0
    moves = state[acts] / (time * local.G[acts, k])
    return float(max(moves.min(initial=np.inf) if acts.any() else 0.0, local.holding[k])) or 1.0


def _slopes(
    loop: ClosedLoop,
    casimirs: Sequence[sp.Expr],
    x_star: Mapping[sp.Symbol, sp.Expr],
    xi: Vector | None,
) -> Vector:
    """|∂c/∂z| at (x*, ξ), (r, n + nc)."""
    xi = np.zeros(loop.controller.nc) if xi is None else xi
    point = {s: x_star[s] for s in loop.plant.x}
    point |= {s: sp.Float(float(v)) for s, v in zip(loop.controller.xi, xi, strict=True)}
    rows = [_numbers(at(gradient(c, loop.z), point)).ravel() for c in casimirs]
    return np.asarray(np.abs(rows), float).reshape(len(rows), loop.n)


def _controller_sizes(
    loop: ClosedLoop,
    known: Mapping[str, float],
    slopes: Vector,
    state: Vector,
    energy: float,
    inputs: Vector,
    xi: Vector | None,
) -> Vector:
    """Sizes of the controller states, (nc,).

    Those that are known, from the Casimirs, or from what drives them.
    """
    n, controller = loop.plant.n, loop.controller
    reach = np.max(slopes[:, :n] * state, axis=1, initial=0.0)
    values = np.zeros(controller.nc) if xi is None else xi
    at_xi = {s: sp.Float(float(v)) for s, v in zip(controller.xi, values, strict=True)}
    Gc = np.abs(_numbers(at(sp.Matrix(controller.Gc), at_xi)))
    result = []
    for k, name in enumerate(controller.states):
        tied = [r / s for r, s in zip(reach, slopes[:, n + k], strict=True) if s > 0]
        driven = float(np.max(Gc[k] * energy / inputs, initial=0.0))
        result.append(known.get(name) or geometric_mean(tied) or driven or 1.0)
    return np.array(result, float)
