"""Transport along the Casimirs, proved again: boxes that the plant's states cannot leave.

Picard–Lindelöf: where q₀ + [0, h]·A(Q)B⁻¹v ⊂ Q, the solution that starts in q₀ stays in Q.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise, product

from flint import arb, arb_mat

from necc_casadi.certificate.checker.arithmetic.balls import ball, times
from necc_casadi.certificate.checker.arithmetic.definite import norm, solve
from necc_casadi.certificate.checker.arithmetic.tapes import Tape

__all__ = ["Transport"]


#: Cells per axis on each face of the cube of directions, how often they may be halved, and pieces
#: of a box per axis.
_CONES, _CUTS, _PIECES = 4, 3, 3


#: Tries of Picard's condition.
_PICARD = 6


Balls = list[arb]


@dataclass(frozen=True)
class Transport:
    """Ways ξ̄ + sA_H⁻¹v of dq = A(q)B(ξ)⁻¹dξ, in steps of |η| = |A_H(ξ − ξ̄)|."""

    along: Tape  # A(q), by rows
    across: Tape  # B(ξ)
    cut: Sequence[int]  # entries of q that A depends on
    xi_bar: Sequence[float]
    inverse: arb_mat  # A_H⁻¹
    radii: Sequence[arb]
    starts: Sequence[Balls]  # boxes of q where a way begins that gets into each step

    def hull(self, inside: Callable[[Balls], bool]) -> Balls | None:
        """A box with `inside` that holds q on every way; None where none is found."""
        found = None
        for v in _cube(len(self.xi_bar)):
            part = self._on(v, inside, _CUTS)
            if part is None:
                return None
            found = part if found is None else _hull(found, part)
        return found

    def _on(self, v: Balls, inside: Callable[[Balls], bool], cuts: int) -> Balls | None:
        """The same for a cone of directions, cut where it has to be."""
        found = self._reached(v, inside)
        if found is not None or cuts == 0:
            return found
        for part in product(*(_halves(x) if x.rad() > 0 else [x] for x in v)):
            other = self._on(list(part), inside, cuts - 1)
            if other is None:
                return None
            found = other if found is None else _hull(found, other)
        return found

    def _reached(self, v: Balls, inside: Callable[[Balls], bool]) -> Balls | None:
        shortest = norm(v).lower()
        direction = [row[0] for row in (self.inverse * arb_mat([[x] for x in v])).tolist()]
        found, moved = None, [arb(0)] * len(self.starts[0])
        for (inner, outer), begin in zip(pairwise(self.radii), self.starts, strict=True):
            s = (inner / shortest).union(outer / shortest)
            place = [c + d * s for c, d in zip(self.xi_bar, direction, strict=True)]
            turned = solve(arb_mat(len(direction), len(direction), self.across(place)), direction)
            width = (outer - inner) / shortest
            origin = [b + m for b, m in zip(begin, moved, strict=True)]
            step = None if turned is None else _step(self.along, self.cut, origin, turned, width)
            if step is None or not inside(step[0]):
                return None
            moved = [m + c for m, c in zip(moved, step[1], strict=True)]
            found = step[0] if found is None else _hull(found, step[0])
        return found


def _cube(d: int) -> list[Balls]:
    """Cells on the surface of ‖v‖∞ = 1."""
    edges = [ball(-1 + 2 * k / _CONES, -1 + 2 * (k + 1) / _CONES) for k in range(_CONES)]
    faces = [list(cell) for cell in product(edges, repeat=d - 1)]
    return [
        [*face[:axis], arb(sign), *face[axis:]]
        for axis in range(d)
        for sign in (-1, 1)
        for face in faces
    ]


def _halves(x: arb) -> Balls:
    middle = arb(x.mid())
    return [x.lower().union(middle), middle.union(x.upper())]


def _step(
    rates: Tape, used: Sequence[int], origin: Balls, turned: Balls, width: arb
) -> tuple[Balls, Balls] | None:
    """(q during a step, its change at the end) by Picard's condition."""
    span = arb(0).union(width.upper())
    rate, Q = _rate(rates, origin, turned, ()), origin
    for _ in range(_PICARD):
        reached = [o + r * span for o, r in zip(origin, rate, strict=True)]
        if all(a.contains(b) for a, b in zip(Q, reached, strict=True)):
            return reached, [r * width for r in rate]
        Q = [x.union(y) + y.rad() * ball(-0.2, 0.2) for x, y in zip(Q, reached, strict=True)]
        rate = _rate(rates, Q, turned, used)
    return None


def _rate(rates: Tape, Q: Balls, turned: Balls, used: Sequence[int]) -> Balls:
    """A(q)B(ξ)⁻¹v over a box, cut along some axes for sharpness."""
    axes = [_pieces(x) if k in used else [x] for k, x in enumerate(Q)]
    result, n = list[arb](), len(turned)
    for piece in product(*axes):
        A = rates(piece)
        rows = [A[i * n : (i + 1) * n] for i in range(len(Q))]
        rate = [sum(map(times, row, turned), arb(0)) for row in rows]
        result = _hull(result, rate) if result else rate
    return result


def _pieces(x: arb) -> Balls:
    lo, width = x.lower(), x.upper() - x.lower()
    cuts = [lo + width * k / _PIECES for k in range(_PIECES + 1)]
    return [a.union(b) for a, b in pairwise(cuts)]


def _hull(a: Balls, b: Balls) -> Balls:
    return [x.union(y) for x, y in zip(a, b, strict=True)]
