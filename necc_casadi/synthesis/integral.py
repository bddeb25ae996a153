"""Integral action for a finished design: τ, Kᵢ, the limits of ζ, and the damping that they take.

S ≻ 0 of docs/theory.md#integral-action bounds D and Dc from below; the two ports are damped apart.
τ and Kᵢ are those of the best decay rate of the linearised loop. V is as it was; the certificate
proves of the loop with ζ what is suggested here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
import sympy as sp

from necc_casadi.arrays import Vector
from necc_casadi.designs.design import Design
from necc_casadi.designs.integral import Integral
from necc_casadi.designs.natural import damping_units
from necc_casadi.errors import OptionError
from necc_casadi.lyapunov.damping import uncoupled
from necc_casadi.lyapunov.sympy2casadi import casadi_function
from necc_casadi.model.closed_loop import ClosedLoop
from necc_casadi.model.lagrangian import (
    Lagrangian,
    Plants,
    lagrangian,
    local_integral_obstacle,
)
from necc_casadi.model.ranges import Range
from necc_casadi.model.samples import quasi_random
from necc_casadi.symbolic.derivatives import gradient, sparse_hessian
from necc_casadi.symbolic.zero import is_zero

__all__ = ["refuse_integral", "with_integral"]


#: τ over the natural time, and Kᵢ over springs per τ, that are tried.
_TIMES, _GAINS = 2.0 ** np.arange(-2, 4.5, 0.5), 2.0 ** np.arange(-4, 4.5, 0.5)


#: Over the least damping of the plant's port and of the controller's: what is away from rest.
_ROOM, _INNER_ROOM = 1.3, 2.0


#: Uncertain parameters of which all ends are looked at.
_MOST_ENDS = 6


#: Positions within one size of the target at which inertia and stiffness are looked at.
_SAMPLES = 32


#: Of the inputs that are left beside the one that holds the target: for constant disturbances.
_FOR_DISTURBANCE = 0.5


#: Limits of ζ over what it has to become, where the inputs have none.
_SPARE = 1.5


def refuse_integral(loop: ClosedLoop, casimirs: tuple[sp.Expr, ...], phi_is_sum: bool) -> None:
    """Refuse what integral action on the position does not cover.

    Raises
    ------
    OptionError
        With the reason.
    """
    reason = local_integral_obstacle(loop, casimirs, phi_is_sum)
    if reason is not None:
        raise OptionError(
            "usage",
            f"--integral: {reason}",
            "It takes a mechanical plant with measured velocities and constant B, the published "
            "loop and Φ = H + Hc + C.",
        )


def with_integral(
    design: Design,
    tau: float | None = None,
    plants: Plants | None = None,
    disturbance: Sequence[Range] = (),
) -> Design:
    """The design with integral action; τ as given, in s, else chosen.

    With `plants` the damping is enough for every inertia at the ends of their ranges, and with
    `disturbance`, a range for each input, ζ has the room for every one of these.

    Raises
    ------
    OptionError
        Where the plant is not covered, its springs at the target are too weak for any τ, or the
        inputs for the disturbances.
    """
    refuse_integral(design.loop, design.casimirs.functions, design.form.phi is None)
    if design.form.betas:
        raise OptionError(
            "usage", "--integral: C = K(Σ βᵢ(cᵢ)) is not covered", "Use --casimir-form joint."
        )
    times = _TIMES if tau is None else np.array([tau / design.units.time])
    full = 2 * design.loop.plant.m == design.loop.plant.n
    best = (_best if full else _best_near)(design, plants, times)
    damping = uncoupled(best.D, best.Dc) * damping_units(design.loop, design.units)
    units = design.units
    output = units.energy / units.input
    return replace(
        design,
        damping=damping,
        integral=Integral(
            tau=best.tau * units.time,
            gain=best.gain * units.input / (output * units.time),
            limit=_limits(design, _needed(design, plants, disturbance)),
        ),
    )


def _best(design: Design, plants: Plants | None, times: Vector) -> _Found:
    """The fastest of those whose damping makes W fall."""
    loop = _Linear.of(design, plants)
    tried = [found for time in times if (found := loop.at(float(time))) is not None]
    if not tried:
        raise OptionError(
            "usage",
            "--integral: at the target no damping makes W fall: V is not stiff enough there",
            "Use --global, or give larger --damping and --controller-damping.",
        )
    return max(tried, key=lambda found: found.rate)


def _best_near(design: Design, plants: Plants | None, times: Vector) -> _Found:
    """With fewer inputs than coordinates: the fastest linearisation, for the slowest plant."""
    own, ends = lagrangian(design.loop, design.units), _at_the_ends(design, plants)
    varied = own if plants is None else lagrangian(design.loop, design.units, plants)
    star = design.natural.x_star[: design.loop.plant.n // 2]
    held = varied is not None and all(is_zero(v) is True for v in varied.unheld(star))
    if own is None or not held:
        raise OptionError(
            "usage",
            "--integral: for some parameters of their ranges no input holds the target, so that "
            "no integral can",
            "Ask for a smaller list of `uncertain` parameters, or another target.",
        )
    loops = [_Linear.near(design, plant) for plant in [own, *ends]]
    D, Dc = loops[0].D, loops[0].Dc
    spring = loops[0].spring
    tried = [
        _Found(float(time), D, Dc, gain, min(loop.rate(time, D, Dc, gain) for loop in loops))
        for time, c in product(_rounded(times), _GAINS)
        for gain in [_rounded(c * spring / time)]
    ]
    best = max(tried, key=lambda found: found.rate)
    if not best.rate > 0:
        raise OptionError(
            "usage",
            "--integral: no τ and gain that were tried make the loop near the target decay",
            "Choose a structure whose loop attracts with a rate, or leave --integral out.",
        )
    return best


def _needed(design: Design, plants: Plants | None, disturbance: Sequence[Range]) -> Vector:
    """The least and greatest ζ* at the ends of all ranges, (2, m): d less what ∇U is wrong by."""
    sides = [[float(v) for v in side] for side in disturbance]
    pushed = np.array(sides or [[0.0, 0.0]] * design.loop.plant.m).T
    ends = _at_the_ends(design, plants)
    own = lagrangian(design.loop, design.units)
    if own is None or not ends:
        return pushed
    star = design.natural.z_star[: len(own.q)][None]
    weights = np.array(
        [_at(plant, sp.Matrix(gradient(plant.U, plant.q)), star)[0, :, 0] for plant in [own, *ends]]
    )
    across = np.linalg.pinv(_constant(own.B))
    wrong = (across @ (weights - weights[0]).T).T * design.units.input
    return np.asarray(pushed - np.array([wrong.max(axis=0), wrong.min(axis=0)]), float)


def _limits(design: Design, needed: Vector) -> Vector:
    """Half of the least room that the inputs have at the target, else what a large input is.

    More where ζ has to become what is `needed`, (2, m), least and greatest.
    """
    limits, reach = design.loop.plant.u_limits, np.abs(needed).max(axis=0)
    if limits is None:
        return _rounded(np.maximum(design.sizes.input, _SPARE * reach))
    n = design.loop.plant.n
    held = design.lyapunov.control_law(design.z_star[:n], design.xi_star)[0]
    low, high = np.array(limits, float).T
    room = np.minimum(held - low, high - held)
    if np.any(room <= 0):
        raise OptionError(
            "usage",
            f"--integral: the input that holds the target, {held.tolist()}, is beyond u_limits",
            "Choose a target that the inputs can hold.",
        )
    left = np.minimum(held - needed[1] - low, high - held + needed[0])
    if np.any(left <= 0):
        raise OptionError(
            "usage",
            "--integral: not all disturbances and parameters of their ranges can be held: u at "
            f"rest would be up to {(held - needed[0]).tolist()}, down to "
            f"{(held - needed[1]).tolist()}",
            "Ask for smaller ranges, or give larger u_limits.",
        )
    spared = np.where(reach > 0, reach + _FOR_DISTURBANCE * left, 0.0)
    return _rounded(np.maximum(_FOR_DISTURBANCE * room, spared))


@dataclass(frozen=True, eq=False)
class _Found:
    """One τ with its damping and gain, natural units."""

    tau: float
    D: Vector
    Dc: Vector
    gain: Vector  # (m,)
    rate: float  # the slowest mode decays so fast


@dataclass(frozen=True, eq=False)
class _Linear:
    """The loop at the target in natural units; springs h of Hc and k of K, both in GcBᵀe."""

    M: Vector
    worst: Vector  # (samples, k, k) M + ½Σ eᵢ∂ᵢM
    stiffness: Vector
    R: Vector
    B: Vector
    Gc: Vector
    h: Vector
    k: Vector
    D: Vector  # of the design
    Dc: Vector

    @classmethod
    def of(cls, design: Design, plants: Plants | None) -> _Linear:
        """From the Hessian of V and the plant."""
        natural, plant = design.natural, lagrangian(design.loop, design.units)
        if plant is None:
            raise ValueError("the states are measured")
        count, n = len(plant.q), natural.loop.plant.n
        star = natural.z_star[:count]
        P = natural.lyapunov.hessian(natural.z_star)
        Gc = _constant(natural.loop.controller.Gc)
        slopes = sp.Matrix(
            [[sp.diff(c, s) for s in natural.loop.z] for c in natural.casimirs.functions]
        )
        N_x, N_xi = _constant(slopes[:, :count]), _constant(slopes[:, n:])
        stiffness = _at(plant, sparse_hessian(plant.U, plant.q), star[None])[0]
        bends = np.linalg.solve(N_x.T, P[:count, :count] - stiffness)  # N_xᵀ ∇²K N_x
        bends = np.linalg.solve(N_x.T, bends.T)
        k = N_xi.T @ ((bends + bends.T) / 2) @ N_xi
        m = natural.loop.plant.m
        return cls(
            M=_at(plant, plant.M, star[None])[0],
            worst=np.concatenate(
                [
                    _bent(at, star, natural.sizes.state[:count])
                    for at in [plant, *_at_the_ends(design, plants)]
                ]
            ),
            stiffness=stiffness,
            R=_constant(plant.R),
            B=_constant(plant.B),
            Gc=Gc,
            h=P[n:, n:] - k,
            k=k,
            D=natural.damping[:m, :m],
            Dc=natural.damping[m:, m:],
        )

    @classmethod
    def near(cls, design: Design, plant: Lagrangian) -> _Linear:
        """The same of a plant with fewer inputs than coordinates, of M, U and R of its own."""
        natural, k, m = design.natural, len(plant.q), design.loop.plant.m
        n, star = 2 * k, natural.z_star[:k][None]
        P = natural.lyapunov.hessian(natural.z_star)
        B, Gc = _constant(plant.B), _constant(natural.loop.controller.Gc)
        bends = -P[n:, :k] @ np.linalg.pinv(Gc @ B.T)  # c = N_ξ(ξ − GcBᵀq)
        bends = (bends + bends.T) / 2
        M, D = _at(plant, plant.M, star)[0], natural.damping
        return cls(
            M=M,
            worst=M[None],
            stiffness=_at(plant, sparse_hessian(plant.U, plant.q), star)[0],
            R=_constant(plant.R),
            B=B,
            Gc=Gc,
            h=P[n:, n:] - bends,
            k=bends,
            D=(D[:m, :m] + D[:m, :m].T) / 2,
            Dc=(D[m:, m:] + D[m:, m:].T) / 2,
        )

    @property
    def spring(self) -> Vector:
        """What holds the coordinates of each input, others free to follow; (m,), above 0."""
        Y = self.B @ self.Gc.T
        series = np.linalg.inv(np.linalg.inv(self.h) + np.linalg.inv(self.k))
        S = self.stiffness + Y @ series @ Y.T
        softness = np.diag(self.B.T @ np.linalg.pinv(S) @ self.B)
        return np.asarray(1 / np.maximum(np.abs(softness), np.finfo(float).tiny), float)

    def at(self, tau: float) -> _Found | None:
        """The least damping for τ that is not below the design's, and the best gain."""
        BGc = self.B @ self.Gc.T
        both = np.linalg.inv(self.h + self.k)
        share = self.h @ both
        series = (share @ self.k + (share @ self.k).T) / 2
        S = self.stiffness + BGc @ series @ BGc.T
        if np.linalg.eigvalsh(S)[0] <= 0:
            return None
        inverse = np.linalg.inv(self.B)
        needed = inverse @ (self.worst / tau - self.R) @ inverse.T
        D = _above(self.D, _ROOM * needed)
        across = BGc @ share
        inner = across.T @ np.linalg.solve(S, across) / (4 * tau)
        own = np.linalg.inv(self.Gc)
        Dc = _above(self.Dc, _INNER_ROOM * (own @ inner @ own.T)[None])
        spring = np.diag(inverse @ S @ inverse.T) / tau
        rates = [self.rate(tau, D, Dc, c * spring) for c in _GAINS]
        best = int(np.argmax(rates))
        return _Found(
            float(_rounded(np.array([tau]))[0]), D, Dc, _rounded(_GAINS[best] * spring), rates[best]
        )

    def rate(self, tau: float, D: Vector, Dc: Vector, gain: Vector) -> float:
        """−(largest real part) of the linearised loop in (e, q̇, ξ̃, ζ)."""
        (k, m), inertia = self.B.shape, np.linalg.inv(self.M)
        zero, wide, eye = np.zeros((m, m)), np.zeros((k, m)), np.eye(k)
        w_e, w_xi = -self.Gc.T @ self.k @ self.Gc @ self.B.T, self.Gc.T @ (self.h + self.k)
        damped = self.B @ D @ self.B.T + self.R
        rows = [
            [np.zeros((k, k)), eye, wide, wide],
            [-inertia @ self.stiffness, -inertia @ damped,
             -inertia @ self.B @ self.Gc.T @ self.h, -inertia @ self.B],
            [-self.Gc @ Dc @ w_e, self.Gc @ self.B.T, -self.Gc @ Dc @ w_xi, zero],
            [gain[:, None] * self.B.T, tau * gain[:, None] * self.B.T, zero, zero],
        ]  # fmt: skip
        return -float(np.linalg.eigvals(np.block(rows)).real.max())


def _above(own: Vector, needed: Vector) -> Vector:
    """A diagonal matrix that is ⪰ matrices (S, m, m), by its rows, and no less than its own."""
    rows = np.abs(needed).sum(axis=-1).max(axis=0)
    return np.diag(_rounded(np.maximum(np.diag(own), rows)))


def _rounded(values: Vector) -> Vector:
    return np.array([float(f"{v:.3g}") for v in values])


def _bent(plant: Lagrangian, star: Vector, size: Vector) -> Vector:
    """M + ½Σ eᵢ∂ᵢM at positions within one size, (samples, k, k)."""
    q = star + size * (2 * quasi_random(_SAMPLES, len(star), 0) - 1)
    M = sp.Matrix(plant.M)
    total = _at(plant, M, q)
    for i, s in enumerate(plant.q):
        total = total + 0.5 * (q - star)[:, i, None, None] * _at(plant, M.diff(s), q)
    return total


def _at_the_ends(design: Design, plants: Plants | None) -> list[Lagrangian]:
    """The plants at all ends of the ranges of up to so many parameters."""
    if plants is None:
        return []
    varied = lagrangian(design.loop, design.units, plants)
    if varied is None:
        raise OptionError(
            "usage",
            f"--integral: {', '.join(plants.ranges)} stand in J or G, or H is not quadratic in p",
            "Uncertain parameters of integral action are those of inertia, potential and friction.",
        )
    names = list(varied.ranges)[:_MOST_ENDS]
    rest = {s: side[0] for s, side in varied.ranges.items() if s not in names}
    ends = product(*(varied.ranges[s] for s in names))
    found = []
    for values in ends:
        known = {**rest, **dict(zip(names, values, strict=True))}
        M, R = varied.M.subs(known), varied.R.subs(known)
        found.append(replace(varied, M=M, R=R, U=varied.U.subs(known), ranges={}))
    return found


def _at(plant: Lagrangian, matrix: sp.MatrixBase, q: Vector) -> Vector:
    """A matrix of q at positions (S, k), (S, rows, columns)."""
    function = casadi_function("matrix", plant.q, matrix)
    return np.array([np.asarray(function(row), float) for row in q])


def _constant(matrix: sp.MatrixBase) -> Vector:
    return np.array(sp.Matrix(matrix).evalf().tolist(), float)
