"""Stability margins with the loop opened at the plant's input.

S = (I + L)⁻¹ and T = I − S. One input at a time, the others closed: phase, gain and delay that an
input may be off by before the loop stops being stable. All inputs at once: the disk margin
α = 2/‖S − T‖∞, of the gains and phases of all inputs together.

References
----------
Seiler, Packard and Gahinet (2020), disk margins with σ = 0. Skogestad and Postlethwaite (2005).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from necc_casadi.arrays import Vector

__all__ = ["Margins", "Sweep", "margins", "one_input"]


#: Decades beyond the slowest and the fastest mode that are swept, and points in each of them.
_BEYOND, _POINTS = 3, 200


#: Distances from the frequency of a mode, in its rates of decay, at which a peak is looked for.
_NEAR = np.concatenate([-np.logspace(1, -3, 30), np.logspace(-3, 1, 30)])


#: The same for a mode that does not decay, as a share of its frequency: L is infinite there.
_UNDAMPED = 1e-3


#: A sign that changes with more than this share left of the whole changes across a pole.
_POLE = 1e-6


#: Halvings of an interval at most: next to a pole a sign changes within rounding.
_REFINED = 1000


#: A loop gain beyond this is that of an integrator.
_INFINITE = 1e12


_Complex = npt.NDArray[np.complex128]


@dataclass(frozen=True)
class Margins:
    """The least over the inputs; ∞ where nothing of that kind makes the loop unstable."""

    phase_deg: float  # degrees, either way
    gain: float  # > 1: factor by which a gain may grow
    gain_down: float  # < 1: factor to which a gain may fall; 0: a loop that needs no control
    delay: float  # s
    disk: float  # α, all inputs at once; 2 at most


def margins(A: Vector, B: Vector, C: Vector) -> Margins:
    """Margins of L(s) = C(sI − A)⁻¹B with negative feedback.

    Parameters
    ----------
    A, B, C
        The opened loop (N, N), (N, m), (m, N); A − BC must be Hurwitz.
    """
    inputs = B.shape[1]
    frequencies = _sweep(A, A - B @ C)
    singles = [_of_one_input(*_one_loop(A, B, C, i), frequencies) for i in range(inputs)]
    return Margins(
        phase_deg=min(single[0] for single in singles),
        gain=min(single[1] for single in singles),
        gain_down=max(single[2] for single in singles),
        delay=min(single[3] for single in singles),
        disk=_disk(A, B, C, frequencies),
    )


@dataclass(frozen=True, eq=False)
class Sweep:
    """L(jω) of a scalar loop."""

    w: Vector  # (points,) rad/s
    L: _Complex  # (points,)


def one_input(A: Vector, B: Vector, C: Vector, i: int) -> Sweep:
    """The loop opened at input i, the others closed, around its modes."""
    loop = _one_loop(A, B, C, i)
    w = _sweep(A, A - B @ C)
    return Sweep(w, np.asarray(_response(*loop, w)[:, 0, 0]))


def _one_loop(A: Vector, B: Vector, C: Vector, i: int) -> tuple[Vector, Vector, Vector]:
    """Input i opened, the others closed."""
    others = [j for j in range(B.shape[1]) if j != i]
    return A - B[:, others] @ C[others], B[:, [i]], C[[i]]


def _sweep(*matrices: Vector) -> Vector:
    """Frequencies, rad/s, dense around every mode."""
    modes = np.concatenate([np.linalg.eigvals(A) for A in matrices])
    speeds = np.abs(modes)
    speeds = speeds[speeds > 1e-12 * speeds.max(initial=0.0)]
    if not speeds.size:
        return np.logspace(-_BEYOND, _BEYOND, 2 * _BEYOND * _POINTS)
    low, high = np.log10(speeds.min()) - _BEYOND, np.log10(speeds.max()) + _BEYOND
    grid = [np.logspace(low, high, int((high - low) * _POINTS))]
    for mode in modes[modes.imag > 0]:
        grid.append(mode.imag + max(abs(mode.real), _UNDAMPED * mode.imag) * _NEAR)
    every = np.unique(np.concatenate(grid))
    return every[every > 0]


def _response(A: Vector, B: Vector, C: Vector, w: Vector) -> _Complex:
    """L(jω) for many ω, (…, m, m); next to a pole where ω is one to the last digit."""
    resolvent = 1j * np.asarray(w)[..., None, None] * np.eye(len(A)) - A
    forces = np.broadcast_to(B, (*np.shape(w), *B.shape))
    try:
        states = np.linalg.solve(resolvent, forces)
    except np.linalg.LinAlgError:
        beside = np.finfo(float).eps * np.linalg.norm(A)
        states = np.linalg.solve(resolvent + beside * np.eye(len(A)), forces)
    return np.asarray(C @ states)


def _of_one_input(A: Vector, B: Vector, C: Vector, w: Vector) -> tuple[float, float, float, float]:
    """(phase in degrees, gain up, gain down, delay) of a scalar loop."""

    def L(frequency: float) -> complex:
        return complex(_response(A, B, C, np.array(frequency))[0, 0])

    sampled = _response(A, B, C, w)[:, 0, 0]
    phase = delay = np.inf
    for at in _zeros(lambda v: abs(L(v)) - 1, w, np.abs(sampled) - 1):
        angle = float(np.angle(-L(at)))  # from −1 to L
        phase = min(phase, abs(angle))
        delay = min(delay, (angle if angle > 0 else angle + 2 * np.pi) / at)
    crossings = [L(at) for at in _zeros(lambda v: L(v).imag, w, sampled.imag)]
    near = [v for v in crossings if abs(v.imag) < _POLE * abs(v) < _POLE * _INFINITE]
    real = [value.real for value in near]
    gains = [-1 / value for value in [*real, *_at_rest(A, B, C)] if value < 0]
    up = min((g for g in gains if g > 1), default=np.inf)
    down = max((g for g in gains if g < 1), default=0.0)
    return float(np.degrees(phase)), up, down, delay


def _at_rest(A: Vector, B: Vector, C: Vector) -> list[float]:
    """L(0), where no integrator makes it infinite."""
    try:
        value = float((-C @ np.linalg.solve(A, B))[0, 0])
    except np.linalg.LinAlgError:
        return []
    return [value] if np.isfinite(value) and np.linalg.cond(A) < 1 / np.finfo(float).eps else []


def _zeros(f: Callable[[float], float], w: Vector, values: Vector) -> list[float]:
    """Where a function changes its sign between neighbouring frequencies, refined."""
    from scipy.optimize import brentq  # slow to import, and few runs need it

    return [
        float(brentq(f, w[k], w[k + 1], xtol=1e-12 * w[k], rtol=1e-13, maxiter=_REFINED))
        for k in np.flatnonzero(values[:-1] * values[1:] < 0)
    ]


def _disk(A: Vector, B: Vector, C: Vector, w: Vector) -> float:
    """2/‖S − T‖∞ with S − T = (I − L)(I + L)⁻¹."""
    identity = np.eye(B.shape[1])

    def size(v: Vector) -> Vector:
        L = _response(A, B, C, v)
        return np.linalg.svd((identity - L) @ np.linalg.inv(identity + L), compute_uv=False)[..., 0]

    from scipy.optimize import minimize_scalar  # slow to import, and few runs need it

    sampled = size(w)
    best = max(1.0, float(sampled.max()))  # L vanishes at infinity: S − T is I there
    peaks = np.flatnonzero((sampled[1:-1] >= sampled[:-2]) & (sampled[1:-1] >= sampled[2:])) + 1
    for k in peaks[np.argsort(sampled[peaks])[-5:]]:
        found = minimize_scalar(
            lambda v: -float(size(np.array(np.exp(v)))),
            bounds=(np.log(w[k - 1]), np.log(w[k + 1])),
            method="bounded",
            options={"xatol": 1e-10},
        )
        best = max(best, -float(found.fun))
    return 2 / best
