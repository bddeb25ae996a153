"""What is proved of set-points at run time, as functions of what is measured.

For every r of the range and every θ that may be told, {V(·; r, θ) − V(r) ≤ c} over the box of the
certificate holds solutions, so that whether (x, ξ) is in it decides where r may go.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np

from necc_casadi.arrays import Vector
from necc_casadi.certificate.claims.certificate import Certificate
from necc_casadi.certificate.claims.claim import Claim
from necc_casadi.designs.design import Design
from necc_casadi.lyapunov.sympy2casadi import casadi_function
from necc_casadi.model.measurement import Measurement
from necc_casadi.model.setpoints import SetPoints, set_points
from necc_casadi.symbolic.floats import to_floats

__all__ = ["LevelSet", "level_set"]


@dataclass(frozen=True, eq=False)
class LevelSet:
    """The set of a design at each set-point r (k,) and θ that is told (p,); units of the model."""

    design: Design
    claim: Claim

    @cached_property
    def points(self) -> SetPoints:
        """Set-points and parameters as symbols."""
        made = self.design
        return set_points(made.loop.plant, made.z_star[: self.k], made.setpoints, made.told)

    @property
    def k(self) -> int:
        """Coordinates."""
        return self.design.loop.plant.n // 2

    @property
    def q_star(self) -> Vector:
        """The target of the design, (k,)."""
        return self.design.z_star[: self.k]

    @property
    def level(self) -> float:
        """V above its value at r is at most this."""
        return float(self.claim.data["level"] * self.design.units.energy)

    @property
    def half(self) -> Vector:
        """Half widths of the box of (q, ξ), (k + nc,)."""
        n, units = self.design.loop.plant.n, self.design.units
        size = np.concatenate([units.state[: self.k], units.state[n:]])
        return np.asarray(np.array(self.claim.data["half_widths"]) * size, float)

    @property
    def sides(self) -> tuple[Vector, Vector]:
        """The least and the greatest set-point, (k,) each."""
        low, high = np.array([to_floats(side) for side in self.points.ranges]).T
        return low, high

    @property
    def told(self) -> tuple[Vector, Vector, Vector]:
        """The least, the greatest and the model's own of what is told, (p,) each."""
        pairs = np.array([to_floats(side) for side in self.points.told]).reshape(-1, 2)
        return pairs[:, 0], pairs[:, 1], to_floats(self.points.nominal)

    @cached_property
    def rest(self) -> float:
        """V less H at the target: what Hc and K are at rest."""
        known, still = Measurement(self.design.loop.plant), np.zeros(self.k)
        H = casadi_function("H", known.y, [known.energy])
        at_rest = float(H(np.concatenate([self.q_star, still])))
        return self.design.V(self.design.z_star) - at_rest

    @cached_property
    def seen(self) -> ca.Function:
        """(x, r) -> what the law sees, (n,): as if the set-point were the target."""
        return self._shifted(-1)

    @cached_property
    def unseen(self) -> ca.Function:
        """(What the law sees, r) -> x, (n,)."""
        return self._shifted(1)

    def _shifted(self, sign: int) -> ca.Function:
        x, r = ca.SX.sym("x", 2 * self.k), ca.SX.sym("r", self.k)
        shift = sign * (r - ca.DM(self.q_star))
        here = ca.vertcat(x[: self.k] + shift, x[self.k :])
        return ca.Function("seen", [x, r], [here])

    @cached_property
    def forward(self) -> ca.Function:
        """(r, θ) -> what is added to u, (m,)."""
        points = self.points
        ahead = casadi_function("forward", (*points.r, *points.theta), points.feedforward)
        r, theta = ca.SX.sym("r", self.k), ca.SX.sym("theta", len(points.theta))
        return ca.Function("forward", [r, theta], [ahead(ca.vertcat(r, theta))])

    @cached_property
    def energy(self) -> ca.Function:
        """(What the law sees, r, θ) -> H above its value at rest, less r's part of its slope."""
        points, known = self.points, Measurement(self.design.loop.plant)
        q, rates = known.y[: self.k], known.y[self.k :]
        above = casadi_function(
            "above", (*known.y, *points.r, *points.theta), [points.energy(q, rates)]
        )
        at, r = ca.SX.sym("at", 2 * self.k), ca.SX.sym("r", self.k)
        theta = ca.SX.sym("theta", len(points.theta))
        return ca.Function(
            "energy", [at, r, theta], [above(ca.vertcat(self.unseen(at, r), r, theta))]
        )


def level_set(design: Design, certificate: Certificate | None) -> LevelSet | None:
    """What is proved of a design whose set-point moves, or that is told parameters; else None."""
    if certificate is None or not (design.setpoints or design.told):
        return None
    claims = certificate.claims
    claim = next((c for c in claims if c.name == "setpoints" and c.holds), None)
    return None if claim is None else LevelSet(design, claim)
