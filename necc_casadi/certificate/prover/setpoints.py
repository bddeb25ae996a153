"""Set-points at run time: one box and one level for every r of a range, and parameters told.

For each r, V(·; r) falls (decrease) and V − V(r) = ½q̇ᵀMq̇ + E + gᵀe, E = Ũ + K₀ + H₀ about r, where
g is what the training left of the slope at the target. Below the level ∇E has mean slopes ⪰ μI, so
that V has no critical point farther than |g|/μ from rest.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from necc_casadi.arrays import Truth, Vector
from necc_casadi.certificate.claims import statements
from necc_casadi.certificate.claims.claim import Claim
from necc_casadi.certificate.prover.arithmetic.boxes import matrix_enclosure
from necc_casadi.certificate.prover.arithmetic.definite import norm, positive_definite
from necc_casadi.certificate.prover.arithmetic.intervals import Interval, matmul, point
from necc_casadi.certificate.prover.box import beside, searched
from necc_casadi.certificate.prover.remainders import Remainders, transposed
from necc_casadi.designs.design import Design
from necc_casadi.model.lagrangian import Lagrangian, integral_obstacle, lagrangian
from necc_casadi.model.setpoints import moved, set_points
from necc_casadi.symbolic.derivatives import gradient
from necc_casadi.symbolic.expressions import to_text
from necc_casadi.symbolic.floats import to_floats

__all__ = ["prove_setpoints"]


#: Over the bound of the distance, and rounding of slopes of order one: other arithmetic is coarser.
_ROOM, _ROUNDING = 16.0, 2.0**-44


#: Of the least curvature at rest: what mean slopes are above, below the level.
_MU = 0.02


def prove_setpoints(design: Design) -> Claim | None:
    """That one box holds solutions at every set-point of the design; None where it has none.

    And for every value of the parameters that the controller is told.
    """
    if not design.setpoints and design.told is None:
        return None
    loop, told = design.loop, design.told
    obstacle = integral_obstacle(loop, design.casimirs.functions, design.form.phi is None)
    plain, plant = lagrangian(loop, design.units), lagrangian(loop, design.units, told)
    covered = obstacle is None and not design.form.betas and design.integral is None
    if not covered or plain is None or plant is None or plant.R != plain.R:
        return Claim("setpoints", False, statements.SETPOINTS_ARE_NOT_COVERED)
    points = set_points(loop.plant, design.z_star[: loop.plant.n // 2], design.setpoints, told)
    terms = SetPointTerms(design, moved(plant, points, design.units), plain)
    found = None if terms.xi_bar is None else searched(terms)
    if found is None:
        return Claim("setpoints", False, statements.NO_SETPOINTS)
    slack = terms.left_over(found.half_widths)
    level, mu = found.level - slack, terms.mu
    away = float(norm(terms.left)) / mu
    far = _ROOM * away + _ROUNDING / mu
    data: dict[str, float | list[float]] = {
        "level": level,
        "half_widths": [float(v) for v in found.half_widths],
        "mu": mu,
        "away": far,
    }
    kept = [*range(terms.k), *range(loop.plant.n, loop.n)]
    box = {
        loop.states[i]: float(width * design.units.state[i])
        for i, width in zip(kept, found.half_widths, strict=True)
    }
    ranges = {k: tuple(map(to_text, side)) for k, side in design.setpoints.items()}
    known = told.ranges if told is not None else {}
    ranges |= {k: tuple(map(to_text, side)) for k, side in known.items()}
    text = statements.setpoints(level * design.units.energy, box, far, ranges)
    return Claim("setpoints", True, text, data)


class SetPointTerms(Remainders):
    """E and the mean slopes of its gradient over boxes."""

    def __init__(self, design: Design, plant: Lagrangian, nominal: Lagrangian) -> None:
        super().__init__(design, plant)
        self.nominal = nominal  # as it is seen at q*
        names, sizes = design.loop.plant.states, design.units.state
        self._sizes = {name: float(sizes[names.index(name)]) for name in design.setpoints}

    @property
    def rests(self) -> tuple[Vector, Vector]:
        """The ends of the ranges of set-points, (k,) each."""
        low, high, names = self.q_star.copy(), self.q_star.copy(), self.design.loop.plant.states
        for name, side in self.design.setpoints.items():
            i = names.index(name)
            low[i], high[i] = to_floats(side) / self._sizes[name]
        return low, high

    @cached_property
    def left(self) -> Interval:
        """G = ∇U(q*) + N_x∇K at (q*, ξ̄), (k,); the same for every r."""
        tilted = gradient(self.nominal.U, self.nominal.q)
        slope = matrix_enclosure(tilted, self.nominal.q, point(self.q_star[None]))[0, :, 0]
        return slope + self._at_rest.grad[0, : self.k]

    @cached_property
    def mu(self) -> float:
        """Mean slopes are above this, below the level."""
        rest = Interval(np.zeros((1, 2 * self.m)), np.zeros((1, 2 * self.m)))
        theta = point(self.theta.mid[None])
        values = np.linalg.eigvalsh(self._form(beside(rest, theta)).mid[0])
        return max(_MU * float(values[0]), np.finfo(float).tiny)

    def left_over(self, half: Vector) -> float:
        """|gᵀe| in the box is at most this."""
        reach = point(self.left.magnitude * half[: self.k]).sum()
        return float(np.nextafter(reach.hi, np.inf))

    def falls(self, Z: Interval) -> Truth:
        """Whether M ≻ 0 and the mean slopes of ∇E are ⪰ μI on boxes (B, 2m + parameters)."""
        with np.errstate(all="ignore"):
            e, theta = Z[:, : self.k], Z[:, 2 * self.m :]
            at = beside(e + np.broadcast_to(self.q_star, e.shape), theta)
            steep = positive_definite(self._form(Z), self.mu)
            return np.asarray(steep & positive_definite(self.inertia(at, e)[0]))

    def _form(self, Z: Interval) -> Interval:
        """[a + YkYᵀ, −Yk; −kYᵀ, h + k] over boxes, Y = BGcᵀ; (B, 2m, 2m)."""
        a, h, k = self.mean_slopes(Z)
        m, Y = self.m, matmul(self.B, transposed(self.Gc))
        across = -matmul(Y, k)
        corner = a + matmul(matmul(Y, k), transposed(Y))
        lo, hi = (np.zeros((Z.shape[0], 2 * m, 2 * m)) for _ in range(2))
        first, second = slice(m), slice(m, None)
        for rows, columns, block in (
            (first, first, corner), (second, second, h + k),
            (first, second, across), (second, first, transposed(across)),
        ):  # fmt: skip
            lo[:, rows, columns], hi[:, rows, columns] = block.lo, block.hi
        return Interval(lo, hi)
