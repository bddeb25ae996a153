"""How a function rises around a point, by curvature on shells of an ellipsoid, proved in balls.

Where ∇²f ⪰ νAᵀA on the shells |A(v − v̄)| ≤ rⱼ, the slope of f along every ray from v̄ is at least
s(ρ) = ∫₀^ρ ν less the slope at v̄, and f rises by at least ∫₀^ρ s: Taylor's formula along the ray.
Used for a network, and for V with A = Lᵀ.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Protocol

from flint import arb, arb_mat

from necc_casadi.certificate.checker.arithmetic.balls import Box, ball, by_bisection, ends
from necc_casadi.certificate.checker.arithmetic.definite import norm, positive
from necc_casadi.certificate.checker.arithmetic.networks import Net
from necc_casadi.certificate.checker.evidence import Obligation

__all__ = ["Curved", "NetworkCurvature", "Shells"]


#: How often the box around a network's shells may be halved before a test on it counts as failed.
_DEPTH = 16


class Curved(Protocol):
    """A function whose value, slope and curvature are enclosed over boxes."""

    def value(self, box: Box) -> arb:
        """The function itself."""
        ...

    def gradient(self, box: Box) -> list[arb]:
        """Its gradient."""
        ...

    def hessian(self, box: Box, sign: int = 1) -> arb_mat:
        """A matrix below (sign 1) or above (sign −1) its Hessian."""
        ...


class NetworkCurvature:
    """A network as a curved function."""

    def __init__(self, net: Net) -> None:
        self.net = net

    def value(self, box: Box) -> arb:
        """The network itself."""
        return self.net(box)[0]

    def gradient(self, box: Box) -> list[arb]:
        """Its gradient."""
        return self.net(box)[1]

    def hessian(self, box: Box, sign: int = 1) -> arb_mat:
        """Its Hessian, which is below and above itself."""
        pairs, n = self.net(box)[2], len(box)
        return arb_mat([[pairs[min(i, j), max(i, j)] for j in range(n)] for i in range(n)])


class Shells:
    """Shells |A(v − v̄)| ≤ radii with ν AᵀA ⪯ ∇²f ⪯ above AᵀA."""

    def __init__(
        self, f: Curved, middle: Sequence[float], A: arb_mat, radii: Sequence[float],
        nu: Sequence[float], above: float,
    ) -> None:  # fmt: skip
        self.f, self.middle, self.A, self.P = f, middle, A, A.transpose() * A
        self.inverse = A.inv()
        self.radii, self.nu, self.above = radii, nu, above
        at: Box = tuple((v, v) for v in middle)
        self.bottom = f.value(at)
        slope = (self.inverse.transpose() * arb_mat([[g] for g in f.gradient(at)])).tolist()
        self.slope = norm([row[0] for row in slope])

    def holds(self) -> bool:
        """Whether the curvature is as claimed, and f rises along rays from the first shell on."""
        return all(proved() for _, proved in self.obligations("f"))

    def obligations(self, name: str) -> list[Obligation]:
        """What has to be proved of the shells, on the box around them."""

        def curved() -> bool:
            box = self.box(self.radii[-1])
            return by_bisection(box, lambda b: self.bent(b) and self.flat(b), _DEPTH)

        return [
            (f"the shells of {name} are in order", self.increasing),
            (f"{name} rises along rays", self.rises),
            (f"the curvature of {name} on the shells", curved),
        ]

    def increasing(self) -> bool:
        """Whether there are shells, one outside of the other."""
        rising = all(a < b for a, b in pairwise([0.0, *self.radii]))
        return rising and len(self.radii) == len(self.nu) > 0

    def rises(self) -> bool:
        """Whether f rises along rays from the first shell on."""
        return self.nu[0] > 0 and all(bool(end > 0) for *_, end in self._pieces())

    def dip(self) -> arb:
        """How far f may fall below f(v̄)."""
        return arb(self.slope * self.slope / (2 * arb(self.nu[0])))

    def at(self, rho: arb) -> arb:
        """A lower bound of f − f(v̄) where |A(v − v̄)| ≥ ρ, on the shells; rising but for the dip."""
        best = -self.dip()
        for inner, width, rise, slope, nu, _ in self._pieces():
            step = (rho - inner).min(width).max(arb(0))
            value = rise + step * (slope + nu * step / 2)
            best = value if bool(rho > inner) else best
        return best

    def _pieces(self) -> list[tuple[arb, arb, arb, arb, arb, arb]]:
        """(inner radius, width, rise and slope there, ν, slope at the end) of each shell."""
        result, rise, slope = [], arb(0), -self.slope
        for (inner, outer), nu in zip(pairwise([0.0, *self.radii]), self.nu, strict=True):
            width, bend = arb(outer) - arb(inner), arb(nu)
            end = slope + bend * width
            result.append((arb(inner), width, rise, slope, bend, end))
            rise, slope = rise + width * (slope + end) / 2, end
        return result

    def half_axes(self, radius: float | arb) -> list[arb]:
        """Half the sides of the box around the ellipsoid |A(v − v̄)| ≤ radius."""
        return [arb(radius) * norm(row) for row in self.inverse.tolist()]

    def box(self, radius: float) -> Box:
        """The box around the ellipsoid |A(v − v̄)| ≤ radius."""
        pairs = zip(self.middle, self.half_axes(radius), strict=True)
        return tuple(ends(m + h * ball(-1.0, 1.0)) for m, h in pairs)

    def length(self, box: Box) -> arb:
        """|A(v − v̄)| over a box."""
        e = arb_mat([[ball(*b) - m] for b, m in zip(box, self.middle, strict=True)])
        return norm([row[0] for row in (self.A * e).tolist()])

    def bent(self, piece: Box) -> bool:
        """Whether ∇²f ⪰ νAᵀA on the shells that a box meets."""
        length = self.length(piece)
        if length > self.radii[-1]:
            return True
        met = [
            nu
            for (a, b), nu in zip(pairwise([0.0, *self.radii]), self.nu, strict=True)
            if not (length < a or length > b)
        ]
        return positive(self.f.hessian(piece) - self.P * arb(max(met)), 0)

    def flat(self, piece: Box, radius: arb | None = None) -> bool:
        """Whether ∇²f ⪯ above·AᵀA on a box, as far as it is within a radius, that of the last."""
        if self.length(piece) > (arb(self.radii[-1]) if radius is None else radius):
            return True
        return positive(self.P * arb(self.above) - self.f.hessian(piece, -1), 0)
