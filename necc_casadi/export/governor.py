"""The governor of set-points in Python: what ``necc_set_target`` does in C."""

from __future__ import annotations

from typing import Literal

import numpy as np
import numpy.typing as npt

from necc_casadi.arrays import Vector
from necc_casadi.certificate.claims.certificate import Certificate
from necc_casadi.designs.design import Design, refuse_other
from necc_casadi.errors import OptionError
from necc_casadi.lyapunov.sympy2casadi import casadi_function
from necc_casadi.model.setpoints import set_points
from necc_casadi.symbolic.floats import to_floats

__all__ = ["Answer", "Governor"]


#: What becomes of a command: it is the set-point, the set-point went part of the way, it stays, or
#: the command is out of range.
Answer = Literal["ok", "limited", "refused", "outside"]


#: Halvings of the way.
_HALVINGS = 24


class Governor:
    """A set-point r that moves only to where the present state is proved to be held.

    ``r`` is the set-point that is applied, (n/2,); ``control`` is the law there.
    """

    def __init__(self, design: Design, certificate: Certificate) -> None:
        """For a design with set-points that are proved.

        Raises
        ------
        OptionError
            When they are not, or the certificate is of another design.
        """
        refuse_other(design, certificate)
        claim = next((c for c in certificate.claims if c.name == "setpoints" and c.holds), None)
        if claim is None:
            raise OptionError(
                "usage",
                "certificate: nothing is proved of set-points that move",
                "Name their ranges in the model file: setpoints = {q: (lo, hi)}.",
            )
        n, k = design.loop.plant.n, design.loop.plant.n // 2
        self.design, self._k, units = design, k, design.units
        points = set_points(design.loop.plant, design.z_star[:k], design.setpoints)
        self._low, self._high = np.array([to_floats(side) for side in points.ranges]).T
        self._forward = casadi_function("forward", points.r, points.feedforward)
        self._tilt = casadi_function("tilt", points.r, points.tilt)
        self._level = claim.data["level"] * units.energy
        size = np.concatenate([units.state[:k], units.state[n:]])
        self._half = np.array(claim.data["half_widths"]) * size
        self.r: Vector = design.z_star[:k].copy()

    def control(self, x: npt.ArrayLike, xi: npt.ArrayLike) -> tuple[Vector, Vector]:
        """What is measured (n,), ξ (nc,) -> u (m,), ξ̇ (nc,) at the set-point that is applied."""
        u, xi_dot = self.design.control(self._seen(x, self.r), xi)
        return u + np.asarray(self._forward(self.r), float).ravel(), xi_dot

    def above(self, x: npt.ArrayLike, xi: npt.ArrayLike, r: npt.ArrayLike | None = None) -> float:
        """V less its value at the set-point, over the proved level; ∞ outside of the box."""
        r = self.r if r is None else np.asarray(r, float)
        xi, V, k = np.asarray(xi, float), self.design.lyapunov, self._k
        at = self._seen(x, r)
        away = np.concatenate([at[:k] - self.design.z_star[:k], xi - self.design.xi_star])
        if not np.all(np.abs(away) <= self._half):
            return float("inf")
        H, tilt = V.terms.measured.H, np.asarray(self._tilt(r), float).ravel()
        still = np.zeros(k)
        own = float(H(np.asarray(x, float))) - float(H(np.concatenate([r, still])))
        seen = V.V(np.concatenate([V.state(at), xi])) - V.V(self.design.z_star)
        nominal = float(H(at)) - float(H(V.measured(self.design.z_star[: 2 * k])))
        total = float(seen) - nominal + own - float(tilt @ (np.asarray(x, float)[:k] - r))
        return float(total / self._level)

    def set_target(self, x: npt.ArrayLike, xi: npt.ArrayLike, r: npt.ArrayLike) -> Answer:
        """Move the set-point towards r (n/2,) as far as is proved from the measured x and ξ."""
        r = np.asarray(r, float)
        if not np.all((self._low <= r) & (r <= self._high)):
            return "outside"
        if self.above(x, xi, r) <= 1:
            self.r = r.copy()
            return "ok"
        start, share, step, kept = self.r, 0.0, 1.0, None
        for _ in range(_HALVINGS):
            step /= 2
            trial = np.clip(start + (share + step) * (r - start), self._low, self._high)
            if self.above(x, xi, trial) <= 1:
                share, kept = share + step, trial
        if kept is None:
            return "refused"
        self.r = kept
        return "limited"

    def _seen(self, x: npt.ArrayLike, r: Vector) -> Vector:
        """What is measured, as the design sees it from its target."""
        at = np.array(x, float)
        at[: self._k] += self.design.z_star[: self._k] - r
        return at
