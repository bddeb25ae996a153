"""How a network rises around a point, by curvature on shells, proved again in balls."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

from flint import arb, arb_mat

from necc_casadi.certificate.checker.arithmetic.balls import Box, ball, by_bisection, ends
from necc_casadi.certificate.checker.arithmetic.definite import norm, positive
from necc_casadi.certificate.checker.arithmetic.networks import Net

__all__ = ["Shells"]


#: How often a box may be halved before a test on it counts as failed.
_DEPTH = 16


class Shells:
    """Shells |A(v − v̄)| ≤ radii with ν AᵀA ⪯ ∇²f ⪯ above AᵀA."""

    def __init__(
        self, net: Net, middle: Sequence[float], A: arb_mat, radii: Sequence[float],
        nu: Sequence[float], above: float,
    ) -> None:  # fmt: skip
        self.net, self.middle, self.A, self.P = net, middle, A, A.transpose() * A
        self.radii, self.nu, self.above = radii, nu, above
        self.bottom, gradient, _ = net(tuple((v, v) for v in middle))
        slope = (A.inv().transpose() * arb_mat([[g] for g in gradient])).tolist()
        self.slope = norm([row[0] for row in slope])

    def holds(self) -> bool:
        """Whether the curvature is as claimed, and f rises along rays from the first shell on."""
        increasing = all(a < b for a, b in pairwise([0.0, *self.radii]))
        if not (increasing and len(self.radii) == len(self.nu) > 0 and self.nu[0] > 0):
            return False
        slopes = [end for *_, end in self._shells()]
        return all(bool(s > 0) for s in slopes) and by_bisection(self._box(), self._curved, _DEPTH)

    def dip(self) -> arb:
        """How far f may fall below f(v̄)."""
        return arb(self.slope * self.slope / (2 * arb(self.nu[0])))

    def at(self, rho: arb) -> arb:
        """A lower bound of f − f(v̄) where |A(v − v̄)| ≥ ρ, on the shells; rising but for the dip."""
        best = -self.dip()
        for inner, width, rise, slope, nu, _ in self._shells():
            step = (rho - inner).min(width).max(arb(0))
            value = rise + step * (slope + nu * step / 2)
            best = value if bool(rho > inner) else best
        return best

    def _shells(self) -> list[tuple[arb, arb, arb, arb, arb, arb]]:
        """(inner radius, width, rise and slope there, ν, slope at the end) of each shell."""
        result, rise, slope = [], arb(0), -self.slope
        for (inner, outer), nu in zip(pairwise([0.0, *self.radii]), self.nu, strict=True):
            width, bend = arb(outer) - arb(inner), arb(nu)
            end = slope + bend * width
            result.append((arb(inner), width, rise, slope, bend, end))
            rise, slope = rise + width * (slope + end) / 2, end
        return result

    def _box(self) -> Box:
        half = [arb(self.radii[-1]) * norm(row) for row in self.A.inv().tolist()]
        pairs = zip(self.middle, half, strict=True)
        return tuple(ends(m + h * ball(-1.0, 1.0)) for m, h in pairs)

    def _curved(self, piece: Box) -> bool:
        e = arb_mat([[ball(*b) - m] for b, m in zip(piece, self.middle, strict=True)])
        length = norm([row[0] for row in (self.A * e).tolist()])
        if length > self.radii[-1]:
            return True
        met = [
            nu
            for (a, b), nu in zip(pairwise([0.0, *self.radii]), self.nu, strict=True)
            if not (length < a or length > b)
        ]
        pairs, n = self.net(piece)[2], len(self.middle)
        hess = arb_mat([[pairs[min(i, j), max(i, j)] for j in range(n)] for i in range(n)])
        return positive(hess - self.P * arb(max(met)), 0) and positive(
            self.P * arb(self.above) - hess, 0
        )
