"""Set-points that move at run time, proved again: one box and one level for every r."""

from __future__ import annotations

from functools import partial

import sympy as sp
from flint import arb, arb_mat

from necc_casadi.certificate.checker.arithmetic.balls import Box, ball, evaluate
from necc_casadi.certificate.checker.arithmetic.definite import norm, positive
from necc_casadi.certificate.checker.evidence import Checked, Evidence
from necc_casadi.certificate.checker.integral import is_covered
from necc_casadi.certificate.checker.model import StoredDesign
from necc_casadi.certificate.checker.plants import StoredPlants
from necc_casadi.certificate.checker.remainders import MovedPlant, StoredRemainders
from necc_casadi.certificate.claims import statements
from necc_casadi.symbolic.expressions import parse

__all__ = ["check_setpoints"]


def check_setpoints(evidence: Evidence, sound: bool) -> Checked | None:
    """The claim about set-points; None for a design whose set-point does not move.

    `sound`: V falls, and what is measured is proved.
    """
    model = evidence.model
    if not evidence.claimed("setpoints"):
        if not model.setpoints and not model.told_ranges:
            return None
        return Checked("setpoints", False, "nothing is claimed of the set-points that move")
    level, mu, away = (evidence.number("setpoints", key) for key in ("level", "mu", "away"))
    widths = [float(v) for v in evidence.claims["setpoints"].data["half_widths"]]
    kept = [*range(model.n // 2), *range(model.n, len(model.z))]
    sides = zip(kept, widths, strict=False)
    told = {model.states[i]: width * model.units.state[i] for i, width in sides}
    ranges = {**model.setpoints, **model.told_ranges}
    text = statements.setpoints(level * model.units.energy, told, away, ranges)
    covered = ranges and model.integral is None and is_covered(model, coupled=True)
    if not covered or len(widths) != 2 * model.m or not all(v > 0 for v in (*widths, mu)):
        return Checked("setpoints", False, f"{text}; not proved: the plant and loop are covered")
    if not _tells_of_this_plant(model):
        return Checked("setpoints", False, f"{text}; not proved: what is told is of this plant")
    moved = MovedPlant.of(model)
    held = _Held(model, level, moved, mu, widths)
    box: Box = tuple((-v, v) for v in widths) + held.theta
    return Checked.by(
        "setpoints",
        text,
        [
            ("V falls, and what is measured", lambda: sound),
            ("the box keeps the bounds of the model", partial(held.keeps_bounds, box)),
            ("a minimum of Hc + K at q*", lambda: held.xi_bar is not None),
            ("M ≻ 0 in the box", partial(held.has_mass, box)),
            ("V above the level on the sides", partial(held.is_closed, box)),
            ("mean slopes ⪰ μI where V is not", partial(held.falls_in, box)),
            ("the momenta keep the bounds of the model", partial(held.keeps_momenta, box)),
            ("how far from the set-point it rests", lambda: bool(held.away() <= away)),
        ],
    )


def _tells_of_this_plant(model: StoredDesign) -> bool:
    """Parameters that are told stand in M and U alone, and the nominal plant is the design's."""
    if not model.told_ranges:
        return True
    told = StoredPlants(model, model.told_plant, model.told_ranges)
    return set(told.nominal) == set(told.ranges) and told.R == model.R and told.fits(model)


class _Held(StoredRemainders):
    """E and the mean slopes of its gradient over boxes."""

    def __init__(
        self, model: StoredDesign, level: float, moved: MovedPlant, mu: float, widths: list[float]
    ) -> None:
        super().__init__(model, level, moved)
        self.mu = mu
        if self.xi_bar is not None:  # V differs from E by gᵀe
            reach = zip(self.left(), widths, strict=False)
            self.level = self.level + sum((g.abs_upper() * w for g, w in reach), arb(0)).upper()

    @property
    def rests(self) -> list[arb]:
        """Every set-point of its range."""
        model, found = self.model, list(self.q_star)
        for name, side in model.setpoints.items():
            i = model.states.index(name)
            lo, hi = (evaluate(parse(v, {}), {}) / arb(model.units.state[i]) for v in side)
            found[i] = lo.union(hi)
        return found

    def left(self) -> list[arb]:
        """G = ∇U(q*) + N_x∇K at (q*, ξ̄)."""
        model, (_, along) = self.model, self.rest
        U = model.H.subs(dict.fromkeys(model.z[self.k : model.n], 0))
        there = dict(zip(self.q, self.q_star, strict=True))
        slopes = [evaluate(sp.diff(U, s), there) for s in self.q]
        return [a + b for a, b in zip(slopes, along, strict=True)]

    def away(self) -> arb:
        """|g|/μ."""
        return norm(self.left()).upper() / arb(self.mu)

    def is_positive(self, box: Box, stretches: int) -> bool:
        """M ≻ 0, and [a + YkYᵀ, −Yk; −kYᵀ, h + k] ⪰ μI with Y = BGcᵀ."""
        m, e = self.k, [ball(*side) for side in box[: self.k]]
        here = {s: v + d for s, v, d in zip(self.q, self.q_star, e, strict=True)}
        if not positive(self.inertia(here | self.known(box)), 0.0):
            return False
        a, h, k = self.mean_slopes(box, stretches)
        Y = self.B * self.Gc.transpose()
        corner, across = a + Y * k * Y.transpose(), Y * k
        S = arb_mat(2 * m, 2 * m)
        for i in range(m):
            for j in range(m):
                S[i, j], S[m + i, m + j] = corner[i, j], h[i, j] + k[i, j]
                S[i, m + j] = S[m + j, i] = -across[i, j]
        return positive(S, self.mu)
