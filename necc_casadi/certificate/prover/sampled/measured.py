"""What the C code takes for the states, over boxes: y = x, or y = (q, q̇) with p = M(q)q̇.

y is measured with noise and rounded, ξ is rounded. By the mean value

    x̌ − x = M̃ (y̌ − y),    M̃ in the hull of ∂(q, M(q)q̇)/∂(q, q̇) between y and y̌

References
----------
docs/theory.md#rounding-noise-and-delay.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import sympy as sp

from necc_casadi.arrays import Vector
from necc_casadi.certificate.prover.arithmetic.boxes import matrix_enclosure
from necc_casadi.certificate.prover.arithmetic.intervals import Interval, matmul
from necc_casadi.certificate.prover.units import units_of
from necc_casadi.designs.design import Design
from necc_casadi.model.rescale import rescaled_inertia

__all__ = ["Measured", "Taken"]


#: More than what is left out of second order.
_SECOND = 1 + 1e-6


@dataclass(frozen=True, eq=False)
class Taken:
    """What the code takes for (x, ξ) of boxes; natural units."""

    states: Interval  # where it is, (B, N)
    errors: Vector  # how far (y, ξ) is off at most, (B, N)
    turn: Interval | None  # ∂(x, ξ)/∂(y, ξ) on the way, (B, N, N); None: y = x

    def moved(self, slopes: Interval, errors: Vector) -> Vector:
        """How far what has slopes (B, k, N) in (x, ξ) is off by errors of (y, ξ): (B, k)."""
        slopes = slopes if self.turn is None else matmul(slopes, self.turn)
        off: Vector = (slopes.magnitude @ errors[..., None])[..., 0]
        return off


@dataclass(frozen=True, eq=False)
class Measured:
    """What the controller of a design measures, over boxes in natural units."""

    design: Design  # in the units of its model

    @property
    def units(self) -> Vector:
        """What 1 is of (y, ξ), (N,)."""
        units, n = units_of(self.design), self.design.loop.plant.n
        own = units.measured(n, self.design.measurement.of_velocities)
        return np.array([*own, *units.state[n:]])

    def over(self, Z: Interval) -> Interval:
        """(y, ξ) of boxes of (x, ξ), (B, N)."""
        if self._inertia is None:
            return Z
        k, n = self._k, 2 * self._k
        rates = matrix_enclosure(self._rates, self._z, Z)[..., 0]
        parts = Z[:, :k], rates, Z[:, n:]
        return Interval(*(np.concatenate([getattr(v, e) for v in parts], 1) for e in ("lo", "hi")))

    def taken(self, Z: Interval, noise: Vector, unit: float) -> Taken:
        """Of boxes of (x, ξ); noise of y, (n,); unit is half the spacing of numbers next to 1."""
        y = self.over(Z)
        noise = np.concatenate([noise, np.zeros(Z.shape[-1] - len(noise))])
        off: Vector = (noise + 2 * unit * (y.magnitude + noise)) * _SECOND + np.finfo(float).tiny
        if self._inertia is None:
            return Taken(Interval(Z.lo - off, Z.hi + off), off, None)
        turn = matrix_enclosure(self._slopes, self._y, Interval(y.lo - off, y.hi + off))
        far = (turn.magnitude @ off[..., None])[..., 0] * _SECOND
        return Taken(Interval(Z.lo - far, Z.hi + far), off, turn)

    @cached_property
    def _inertia(self) -> sp.ImmutableMatrix | None:
        """M̂."""
        return rescaled_inertia(self.design.loop, self.design.units)

    @cached_property
    def _rates(self) -> sp.Matrix:
        """q̇ at x, (k, 1)."""
        return sp.Matrix(self.design.natural.loop.plant.drift[: self._k, 0])

    @cached_property
    def _y(self) -> list[sp.Symbol]:
        """(q, q̇, ξ)."""
        k, z = self._k, self._z
        return [*z[:k], *(sp.Dummy(s.name, real=True) for s in z[:k]), *z[2 * k :]]

    @cached_property
    def _slopes(self) -> sp.Matrix:
        """∂(q, M̂q̇, ξ)/∂(q, q̇, ξ)."""
        k, y = self._k, self._y
        M = sp.eye(k) if self._inertia is None else sp.Matrix(self._inertia)
        state = [*y[:k], *(M * sp.Matrix(y[k : 2 * k])), *y[2 * k :]]
        return sp.Matrix(state).jacobian(y)

    @property
    def _z(self) -> list[sp.Symbol]:
        return list(self.design.natural.loop.z)

    @property
    def _k(self) -> int:
        return self.design.loop.plant.n // 2
