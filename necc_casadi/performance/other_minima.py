"""Minima of V below the one at the target: what a simulation from nearby starts need not meet."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import sympy as sp

from necc_casadi.arrays import Truth, Vector
from necc_casadi.designs.design import Design
from necc_casadi.interrupts import interruptible
from necc_casadi.model.samples import quasi_random
from necc_casadi.simulation.convergence import bogacki_shampine

__all__ = ["LowerMinimum", "lower_minimum"]


#: Starts, how far around z̄ they lie in sizes, and at least in turns of an angle.
_STARTS, _SIZES, _TURNS = 96, 4.0, 1.1


#: Steps down the gradient of V, how far they may be wrong, and steps of Newton's method after them.
_STEPS, _TOLERANCE, _POLISH = 120, 0.02, 8


#: A gradient this small, in natural units, is zero; a minimum this far from z̄ is another one.
_ZERO, _APART = 1e-8, 0.1


#: It is lower where V is by more than this share of the energy.
_LOWER = 1e-6


@dataclass(frozen=True)
class LowerMinimum:
    """A minimum of V that lies below V(z̄), in the units of the model."""

    at: Mapping[str, float]  # state → value
    below: float  # V(z̄) − V there


def lower_minimum(design: Design) -> LowerMinimum | None:
    """The lowest minimum of V that a search around z̄ finds below V(z̄), momenta at rest."""
    resting = _AtRest(design.natural, [i for i in range(design.loop.n) if i not in design.momenta])
    natural, active = design.natural, resting.active
    z_bar, size = natural.z_bar[active], natural.sizes.state[active]
    reach = np.maximum(_SIZES * size, _turns(design)[active])
    cube = 2 * quasi_random(_STARTS, len(active), 0) - 1
    with np.errstate(all="ignore"):
        y = resting.polished(resting.downhill(z_bar + cube * reach, size))
        depth = float(resting.values(z_bar[None])[0]) - resting.values(y)
        sound = depth > _LOWER * natural.sizes.energy
        sound &= np.linalg.norm((y - z_bar) / size, axis=1) > _APART
        sound &= resting.is_minimum(y, size)
    if not sound.any():
        return None
    best = int(np.argmax(np.where(sound, depth, -np.inf)))
    place = y[best] * design.units.state[active]
    names = [design.loop.states[i] for i in active]
    at = dict(zip(names, place.tolist(), strict=True))
    return LowerMinimum(at, float(depth[best]) * design.units.energy)


def _turns(design: Design) -> Vector:
    """How far to search in states that H turns with, natural units, (n + nc,)."""
    inside = [f.args[0] for f in design.loop.plant.H.atoms(sp.sin, sp.cos)]
    angles = [s in set().union(*(a.free_symbols for a in inside)) for s in design.loop.z]
    return np.where(angles, 2 * np.pi * _TURNS / design.units.state, 0.0)


@dataclass(frozen=True, eq=False)
class _AtRest:
    """V, in natural units, in the states that are not momenta."""

    design: Design
    active: list[int]

    def _states(self, y: Vector) -> Vector:
        z = np.zeros((len(y), self.design.loop.n))
        z[:, self.active] = y
        return z

    def values(self, y: Vector) -> Vector:
        """V at (B, d), (B,)."""
        return self.design.lyapunov.V(self._states(y))

    def _gradient(self, y: Vector) -> Vector:
        return np.asarray(self.design.lyapunov.gradient(self._states(y))[:, self.active])

    def _hessian(self, y: Vector) -> Vector:
        block = self.design.lyapunov.hessian(self._states(y))
        return np.asarray(block[:, self.active][:, :, self.active])

    def downhill(self, y: Vector, size: Vector) -> Vector:
        """Along ẏ = −S²∇V, S the sizes, from states (B, d)."""
        y, h = y.copy(), np.full(len(y), 1e-2)

        def descent(states: Vector) -> Vector:
            return np.asarray(-self._gradient(states) * size**2)

        slope = descent(y)
        for _ in range(_STEPS):
            with interruptible():
                end, end_slope, difference = bogacki_shampine(descent, y, slope, h)
            error = np.abs(difference / (_TOLERANCE * size)).max(1)
            good = error <= 1
            y[good], slope[good] = end[good], end_slope[good]
            growth = np.clip(0.9 * np.fmax(error, 1e-9) ** (-1 / 3), 0.2, 5.0)
            h = h * np.where(np.isfinite(error), growth, 0.2)
        return y

    def polished(self, y: Vector) -> Vector:
        """Some steps of Newton's method, where they are possible."""
        y = y.copy()
        for _ in range(_POLISH):
            grad, hess = self._gradient(y), self._hessian(y)
            finite = np.isfinite(hess).all((1, 2)) & np.isfinite(grad).all(1)
            usable = np.asarray(finite, bool)
            usable[usable] &= np.linalg.det(hess[usable]) != 0
            y[usable] -= np.linalg.solve(hess[usable], grad[usable][..., None])[..., 0]
        return y

    def is_minimum(self, y: Vector, size: Vector) -> Truth:
        """Whether V has a nondegenerate minimum at each of (B, d)."""
        grad, hess = self._gradient(y), self._hessian(y)
        flat = _ZERO * self.design.sizes.energy
        still: Truth = np.abs(grad * size).max(1) <= flat
        finite = np.asarray(np.isfinite(hess).all((1, 2)), bool)
        safe = np.where(finite[:, None, None], hess, 0.0) * np.outer(size, size)
        curved: Truth = np.linalg.eigvalsh(safe)[:, 0] > 0
        return np.asarray(still & finite & curved, bool)
