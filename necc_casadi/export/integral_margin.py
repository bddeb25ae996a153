"""How far a state is inside what is proved of integral action: 1 − W/c with the largest W.

ζ* is not known, but between bounds, and W is convex in it: it is largest at one of them
(docs/theory.md#set-points-at-run-time).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np
import numpy.typing as npt

from necc_casadi.arrays import Vector
from necc_casadi.certificate.claims.certificate import Certificate
from necc_casadi.certificate.claims.claim import Claim
from necc_casadi.designs.design import Design
from necc_casadi.designs.initial import least_over_xi
from necc_casadi.designs.integral import Integral
from necc_casadi.lyapunov.sympy2casadi import casadi_function
from necc_casadi.model.integral_energy import KnownEnergy, known_energy
from necc_casadi.model.parametric import Parametric

__all__ = ["IntegralMargin", "integral_margin", "integral_margin_obstacle"]


@dataclass(frozen=True, eq=False)
class IntegralMargin:
    """1 − W/c of a design with integral action, in the units of the model."""

    design: Design
    claim: Claim
    energy: KnownEnergy

    @property
    def integral(self) -> Integral:
        """What is added to the law."""
        if self.design.integral is None:
            raise ValueError("no integral action")
        return self.design.integral

    @property
    def k(self) -> int:
        """Coordinates, and inputs."""
        return self.design.loop.plant.n // 2

    @property
    def q_star(self) -> Vector:
        """Where it rests, (k,)."""
        return self.design.z_star[: self.k]

    @cached_property
    def xi_bar(self) -> Vector:
        """The minimum of Hc(ξ) + K(c(q*, ξ)), (k,)."""
        natural, n = self.design.natural, 2 * self.k
        found = least_over_xi(natural.lyapunov, natural, natural.z_star[:n])[0]
        return np.asarray(found * self.design.units.state[n:], float)

    @property
    def level(self) -> float:
        """W is proved to stay below it."""
        return float(self.claim.data["level"] * self.design.units.energy)

    @property
    def half(self) -> Vector:
        """Half widths of the box of (q, ξ), (2k,)."""
        units, n = self.design.units, 2 * self.k
        size = np.concatenate([units.state[: self.k], units.state[n:]])
        return np.asarray(np.array(self.claim.data["half_widths"]) * size, float)

    @property
    def resting(self) -> tuple[Vector, Vector]:
        """The least and the greatest ζ* that is proved for, (k,) each."""
        sides = self.claim.data.get("resting")
        if sides is None:
            return -self.integral.limit, self.integral.limit
        low, high = (np.array(side) * self.design.units.input for side in zip(*sides, strict=True))
        return low, high

    @property
    def weight(self) -> Vector:
        """½/(Kᵢτ) of (ζ − ζ*)², (k,)."""
        return np.asarray(1 / (2 * self.integral.tau * self.integral.gain), float)

    @property
    def _at_rest(self) -> Vector:
        n = 2 * self.k
        return np.concatenate([self.design.z_star[:n], self.xi_bar])

    @cached_property
    def rest(self) -> float:
        """Hc + K at rest."""
        made, z = self.design, self._at_rest
        return made.V(z) - float(made.lyapunov.terms.H(z[: 2 * self.k]))

    @cached_property
    def known(self) -> ca.Function:
        """What is measured (2k,) -> what of W it alone gives, at each end of what is not known."""
        made, z, k = self.design, self._at_rest, self.k
        slope = np.asarray(made.lyapunov.gradient(z), float)[:k]
        own = np.asarray(made.lyapunov.terms.grad_H(z[: 2 * k]), float).ravel()[:k]
        D = np.asarray(made.damping[:k, :k], float)
        parts = self.energy.parts(self.q_star, self.integral.tau, D, slope - own)
        return casadi_function("known_energy", self.energy.measured.y, parts)

    def __call__(self, x: npt.ArrayLike, xi: npt.ArrayLike, zeta: npt.ArrayLike) -> float:
        """Of what is measured (2k,), ξ and ζ (k,): at most 1, 0 on the border; −1 off the box."""
        x, xi, zeta = (np.asarray(v, float) for v in (x, xi, zeta))
        away = np.concatenate([x[: self.k] - self.q_star, xi - self.xi_bar])
        if not (np.all(np.abs(away) <= self.half) and np.isfinite(zeta).all()):
            return -1.0
        V, (low, high) = self.design.lyapunov, self.resting
        still = np.concatenate([x[: self.k], np.zeros(self.k)])  # networks do not know q̇
        shape = float(V.V(np.concatenate([still, xi]))) - float(V.terms.measured.H(still))
        W = float(np.max(np.asarray(self.known(x), float))) + shape - self.rest
        off = np.maximum(zeta - low, high - zeta)
        W += float(self.weight @ off**2)
        return 1 - W / self.level if np.isfinite(W) else -1.0


def integral_margin_obstacle(
    design: Design, certificate: Certificate, parametric: Parametric | None = None
) -> str | None:
    """Why there is no margin of integral action; None where there is."""
    found = _found(design, certificate, parametric)
    return found if isinstance(found, str) else None


def integral_margin(
    design: Design, certificate: Certificate, parametric: Parametric | None = None
) -> IntegralMargin | None:
    """The margin of a design with integral action; None where there is none.

    Parameters
    ----------
    parametric
        The plant with its parameters as symbols, where the certificate is about many plants.
    """
    found = _found(design, certificate, parametric)
    return None if isinstance(found, str) else found


def _found(
    design: Design, certificate: Certificate, parametric: Parametric | None
) -> IntegralMargin | str:
    claim = next((c for c in certificate.claims if c.name == "integral" and c.holds), None)
    if claim is None or design.integral is None:
        return "nothing is proved of the integral action"
    energy = known_energy(design.loop.plant, claim.data.get("uncertain", {}), parametric)
    return energy if isinstance(energy, str) else IntegralMargin(design, claim, energy)
