"""What the controller measures: the states x, or (q, q̇) of a plant with momenta p = M(q)q̇.

In velocities the energy of a mechanical plant needs no inverse of its inertia:

    H(q, M q̇) = ½q̇ᵀM q̇ + V(q),   ∂H/∂p = q̇,   ∂H/∂q = ∂V/∂q − ½ Σ q̇ᵢq̇ⱼ ∂Mᵢⱼ/∂q
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import sympy as sp

from necc_casadi.errors import ModelError
from necc_casadi.model.plant import Plant
from necc_casadi.symbolic.derivatives import gradient
from necc_casadi.symbolic.linear_algebra import tidy
from necc_casadi.symbolic.zero import is_zero
from necc_casadi.texts import velocity_names

__all__ = ["Measurement", "canonical_inertia"]


_REMEDY = "Leave `measured` out, or write the plant with q, M, V and B."


@dataclass(frozen=True, eq=False)
class Measurement:
    """What the controller of a plant measures, y, (n,), and the plant's terms as functions of y."""

    plant: Plant

    @property
    def of_velocities(self) -> bool:
        """Whether y = (q, q̇); else y = x."""
        return self.plant.inertia is not None

    @property
    def names(self) -> tuple[str, ...]:
        """Of the entries of y."""
        states = self.plant.states
        if not self.of_velocities:
            return states
        coordinates = states[: self.plant.n // 2]
        return (*coordinates, *velocity_names(coordinates))

    @cached_property
    def units(self) -> dict[str, str]:
        """Units of the entries of y that have one, by name; a rate has that of its state per s."""
        known, states = self.plant.units, self.plant.states
        units = {name: known[name] for name in self.names if name in known}
        if self.of_velocities:
            coordinates = states[: self.plant.n // 2]
            for name, rate in zip(coordinates, velocity_names(coordinates), strict=True):
                if name in known:
                    units[rate] = f"{known[name]}/s"
        return units

    @cached_property
    def y(self) -> tuple[sp.Symbol, ...]:
        """(n,) symbols: coordinates are those of the plant, rates stand where momenta do."""
        if not self.of_velocities:
            return self.plant.x
        k = self.plant.n // 2
        return (*self.plant.x[:k], *(sp.Dummy(name, real=True) for name in self.names[k:]))

    @cached_property
    def state(self) -> tuple[sp.Expr, ...]:
        """X at y, (n,): (q, M q̇)."""
        M, k = self.plant.inertia, self.plant.n // 2
        if M is None:
            return self.plant.x
        return (*self.y[:k], *(sp.Matrix(M) * sp.Matrix(self.y[k:])))

    @cached_property
    def output(self) -> tuple[sp.Expr, ...]:
        """Y at x, (n,): (q, ẋ in the rows of q), which no input enters."""
        k = self.plant.n // 2
        if not self.of_velocities:
            return self.plant.x
        return (*self.plant.x[:k], *self.plant.drift[:k, 0])

    @cached_property
    def energy(self) -> sp.Expr:
        """H at y."""
        if self._natural is None:
            return self._there(self.plant.H)
        kinetic, potential = self._natural
        return kinetic + potential

    @cached_property
    def slopes(self) -> tuple[sp.Expr, ...]:
        """∇H at y, (n,)."""
        if self._natural is None:
            return tuple(self._there(slope) for slope in self.plant.grad_H)
        k, (kinetic, potential) = self.plant.n // 2, self._natural
        along_q = gradient(potential - kinetic, self.y[:k])
        return (*along_q, *self.y[k:])

    @cached_property
    def _natural(self) -> tuple[sp.Expr, sp.Expr] | None:
        """½q̇ᵀMq̇ and V, where H is the energy of which M is the inertia."""
        M, plant = self.plant.inertia, self.plant
        if M is None or plant.preliminary is not None:
            return None
        rates = sp.Matrix(self.y[plant.n // 2 :])
        kinetic = sp.expand((rates.T * sp.Matrix(M) * rates)[0, 0]) / 2
        return kinetic, plant.H.subs(dict.fromkeys(plant.x[plant.n // 2 :], 0))

    def _there(self, expr: sp.Expr) -> sp.Expr:
        return expr.xreplace(dict(zip(self.plant.x, self.state, strict=True)))


def canonical_inertia(plant: Plant) -> sp.ImmutableMatrix:
    """M(q) of a plant with x = (q, p), q̇ = ∂H/∂p and H = ½pᵀM⁻¹(q)p + V(q).

    Raises
    ------
    ModelError
        ``model_file`` where it is no such plant.
    """
    k, odd = divmod(plant.n, 2)
    p = plant.x[k:]
    F = plant.J - plant.R
    wanted = sp.Matrix.hstack(sp.zeros(k, k), sp.eye(k))
    rates = not odd and all(is_zero(e) is True for e in F[:k, :] - wanted)
    if not rates or any(is_zero(e) is not True for e in plant.G[:k, :]):
        raise ModelError(
            "model_file",
            f"measured = 'velocity', but {', '.join(map(str, plant.x))} are not (q, p) with "
            "q̇ = ∂H/∂p",
            _REMEDY,
        )
    inverse = sp.hessian(plant.H, p).applyfunc(tidy)
    kinetic = (sp.Matrix(p).T * inverse * sp.Matrix(p))[0, 0] / 2
    rest = plant.H - kinetic
    if inverse.free_symbols & set(p) or any(is_zero(sp.diff(rest, s)) is not True for s in p):
        raise ModelError(
            "model_file",
            f"measured = 'velocity', but H is not quadratic in {', '.join(map(str, p))}",
            _REMEDY,
        )
    if is_zero(inverse.det()) is not False:
        raise ModelError(
            "model_file",
            "measured = 'velocity', but ∂²H/∂p² is not proved to be regular",
            _REMEDY,
        )
    return sp.ImmutableMatrix(inverse.inv().applyfunc(tidy))
