"""Set-points and parameters at run time in Python: what ``necc_set_target`` does in C."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from typing import Literal, get_args

import casadi as ca
import numpy as np
import numpy.typing as npt

from necc_casadi.arrays import Vector
from necc_casadi.certificate.claims.certificate import Certificate
from necc_casadi.designs.design import Design, refuse_other
from necc_casadi.designs.initial import least_over_xi
from necc_casadi.errors import OptionError
from necc_casadi.export.level_set import level_set

__all__ = ["Answer", "Governor", "Switch"]


#: What becomes of a command: it is the set-point, the set-point went part of the way, it stays, or
#: the command is out of range; of a parameter: what is proved with it does not hold the present.
Answer = Literal["ok", "limited", "refused", "outside", "uncovered"]


#: What becomes of ξ: it stays, u stays, or V(x, ·) is least.
Switch = Literal["keep", "bumpless", "least"]


#: Halvings of the way.
_HALVINGS = 24


#: Steps of Newton's method to the ξ that leaves u as it is, and how near in its size.
_STEPS, _SAME = 20, 1e-14


class Governor:
    """A set-point r that moves only to where the present state is proved to be held.

    ``r`` is the set-point that is applied, (n/2,), ``theta`` what is told of the plant, (p,) in the
    order of ``names``; ``control`` is the law there. ``switch`` says what becomes of ξ.
    """

    def __init__(self, design: Design, certificate: Certificate, switch: Switch = "keep") -> None:
        """For a design with set-points, or parameters that are told, that are proved.

        Raises
        ------
        OptionError
            When they are not, or the certificate is of another design, or there is no such switch.
        """
        refuse_other(design, certificate)
        found = level_set(design, certificate)
        if found is None:
            raise OptionError(
                "usage",
                "certificate: nothing is proved of set-points that move",
                "Name their ranges in the model file: setpoints = {q: (lo, hi)}.",
            )
        if switch not in get_args(Switch):
            raise OptionError(
                "usage", f"switch = {switch!r}", f"Use {', '.join(get_args(Switch))}."
            )
        self.design, self.switch, self._set = design, switch, found
        self._low, self._high = found.sides
        self._least, self._most, theta = found.told
        self.names = tuple(str(s) for s in found.points.theta)
        self.theta: Vector = theta
        self.r: Vector = found.q_star.copy()

    def control(self, x: npt.ArrayLike, xi: npt.ArrayLike) -> tuple[Vector, Vector]:
        """What is measured (n,), ξ (nc,) -> u (m,), ξ̇ (nc,) at the set-point that is applied."""
        u, xi_dot = self.design.control(self._seen(x, self.r), xi)
        return u + self._forward(self.r, self.theta), xi_dot

    def above(
        self,
        x: npt.ArrayLike,
        xi: npt.ArrayLike,
        r: npt.ArrayLike | None = None,
        theta: npt.ArrayLike | None = None,
    ) -> float:
        """V less its value at the set-point, over the proved level; ∞ outside of the box."""
        r = self.r if r is None else np.asarray(r, float)
        theta = self.theta if theta is None else np.asarray(theta, float)
        xi, V, found = np.asarray(xi, float), self.design.lyapunov, self._set
        at = self._seen(x, r)
        away = np.concatenate([at[: found.k] - found.q_star, xi - self.design.xi_star])
        if not np.all(np.abs(away) <= found.half):
            return float("inf")
        still = np.concatenate([at[: found.k], np.zeros(found.k)])  # networks do not know q̇
        shape = V.V(np.concatenate([still, xi])) - float(V.terms.measured.H(still))
        total = float(shape) - found.rest + float(found.energy(at, r, theta))
        return float(total / found.level) if np.isfinite(total) else float("inf")

    def margin(self, x: npt.ArrayLike, xi: npt.ArrayLike) -> float:
        """1 at rest, 0 on the border of what is proved, negative outside; ``necc_margin`` in C."""
        share = self.above(x, xi)
        return 1 - share if np.isfinite(share) else -1.0

    def set_target(self, x: npt.ArrayLike, xi: npt.ArrayLike, r: npt.ArrayLike) -> Answer:
        """Move the set-point towards r (n/2,) as far as is proved from the measured x and ξ.

        For ``switch = "keep"``; :meth:`move` gives the new ξ, too.
        """
        if self.switch != "keep":
            raise OptionError("usage", f"set_target keeps ξ, {self.switch} does not", "Use move.")
        return self.move(x, xi, r)[0]

    def move(self, x: npt.ArrayLike, xi: npt.ArrayLike, r: npt.ArrayLike) -> tuple[Answer, Vector]:
        """The same, and the ξ to go on with, (nc,)."""
        r, xi = np.asarray(r, float), np.asarray(xi, float)
        if not np.all((self._low <= r) & (r <= self._high)):
            return "outside", xi
        if np.array_equal(r, self.r):
            return "ok", xi
        whole = self._admitted(x, xi, r, self.theta)
        if whole is not None:
            self.r = r.copy()
            return "ok", whole
        start, share, step = self.r, 0.0, 1.0
        kept: tuple[Vector, Vector] | None = None
        for _ in range(_HALVINGS):
            step /= 2
            trial = np.clip(start + (share + step) * (r - start), self._low, self._high)
            found = self._admitted(x, xi, trial, self.theta)
            if found is not None:
                share, kept = share + step, (trial, found)
        if kept is None:
            return "refused", xi
        self.r = kept[0]
        return "limited", kept[1]

    def set_parameter(
        self, x: npt.ArrayLike, xi: npt.ArrayLike, theta: npt.ArrayLike
    ) -> tuple[Answer, Vector]:
        """Take what the plant has now (p,); "uncovered": with it the present is not proved held.

        Returns the ξ to go on with, too.
        """
        theta, xi = np.asarray(theta, float), np.asarray(xi, float)
        if not np.all((self._least <= theta) & (theta <= self._most)):
            return "outside", xi
        found = self._admitted(x, xi, self.r, theta)
        after = xi if found is None else found
        covered = found is not None or self.above(x, xi, theta=theta) <= 1
        self.theta = theta.copy()
        return "ok" if covered else "uncovered", after

    def _admitted(self, x: npt.ArrayLike, xi: Vector, r: Vector, theta: Vector) -> Vector | None:
        """ξ with which V is below the level at r and θ; None where it is not."""
        if self.switch == "bumpless":
            wanted = self.control(x, xi)[0] - self._forward(r, theta)
            after = self._bumpless(self._seen(x, r), xi, wanted)
        elif self.switch == "least":
            after = self._least_over_xi(self._seen(x, r), xi)
        else:
            after = xi
        if after is None or not self.above(x, after, r, theta) <= 1:
            return None
        return after

    def _bumpless(self, at: Vector, xi: Vector, wanted: Vector) -> Vector | None:
        """ξ at which the law gives this u (m,) of what it sees; None where none is found."""
        size = self.design.sizes.input + np.abs(wanted)
        for _ in range(_STEPS):
            value, A = (np.asarray(v, float) for v in self._slope_in_xi.call([at, xi]))
            off = value.ravel() - wanted
            if (np.abs(off) / size).sum() <= _SAME:
                return xi
            if not np.isfinite(A).all() or np.linalg.matrix_rank(A) < len(xi):
                return None
            xi = np.asarray(xi - np.linalg.solve(A, off), float)
        return None

    @cached_property
    def _slope_in_xi(self) -> ca.Function:
        """(What the law sees, ξ) -> u and ∂u/∂ξ."""
        terms = self.design.lyapunov.terms
        y, s = ca.MX.sym("y", terms.n), ca.MX.sym("s", terms.nc)
        u = self.design.lyapunov.measured_law_function.call([y, s])[0]
        return ca.Function("u", [y, s], [u, ca.jacobian(u, s)])

    def _least_over_xi(self, at: Vector, xi: Vector) -> Vector:
        natural, n = self.design.natural, self.design.loop.plant.n
        size = self.design.units.state
        start = replace(natural, xi_star=xi / size[n:])
        x = self.design.lyapunov.state(at) / size[:n]
        return np.asarray(least_over_xi(natural.lyapunov, start, x)[0] * size[n:], float)

    def _seen(self, x: npt.ArrayLike, r: Vector) -> Vector:
        """What is measured, as the design sees it from its target."""
        return np.asarray(self._set.seen(np.asarray(x, float), r), float).ravel()

    def _forward(self, r: Vector, theta: Vector) -> Vector:
        return np.asarray(self._set.forward(r, theta), float).ravel()
