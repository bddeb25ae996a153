"""What the C code takes for the states, over a box in Arb balls: y = x, or y = (q, q̇), p = M(q)q̇.

The equations are those of docs/theory.md#rounding-noise-and-delay.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import sympy as sp
from flint import arb, arb_mat

from necc_casadi.certificate.checker.arithmetic.balls import Box, ball, ends
from necc_casadi.certificate.checker.arithmetic.tapes import Tape
from necc_casadi.certificate.checker.model import StoredDesign

__all__ = ["MeasuredProof", "TakenBox"]


@dataclass(frozen=True)
class TakenBox:
    """What the code takes for (x, ξ) of a box."""

    states: Box  # where it is
    errors: list[arb]  # how far (y, ξ) is off at most
    turn: arb_mat | None  # ∂(x, ξ)/∂(y, ξ) on the way; None: y = x

    def moved(self, slopes: Sequence[Sequence[arb]], errors: Sequence[arb]) -> list[arb]:
        """How far what has these slopes in (x, ξ) is off at most by errors of (y, ξ)."""
        rows = arb_mat([list(row) for row in slopes])
        return _magnitude(rows if self.turn is None else rows * self.turn, errors)


class MeasuredProof:
    """What the controller of a stored design measures, in natural units."""

    def __init__(self, model: StoredDesign) -> None:
        self.model = model
        self.velocities = model.inertia is not None
        self.units = (
            *model.units.measured(model.n, self.velocities),
            *model.units.state[model.n : len(model.z)],
        )
        if model.inertia is None:
            return
        x, k = model.z[: model.n], model.n // 2
        gradient = sp.Matrix([sp.diff(model.H, s) for s in x])
        self._rates = Tape(list((model.J - model.R)[:k, :] * gradient), x)
        rates = [sp.Dummy(real=True) for _ in range(k)]
        state = sp.Matrix([*x[:k], *(model.inertia * sp.Matrix(rates))])
        self._slopes = Tape(list(state.jacobian([*x[:k], *rates])), [*x[:k], *rates])

    def over(self, box: Box) -> list[arb]:
        """(y, ξ) of a box of (x, ξ)."""
        values, n = [ball(*side) for side in box], self.model.n
        if not self.velocities:
            return values
        return [*values[: n // 2], *self._rates(values[:n]), *values[n:]]

    def taken(self, box: Box, noise: Sequence[float], unit: arb) -> TakenBox:
        """Of a box of (x, ξ), with noise of y; unit: half the spacing of the numbers next to 1."""
        y, n, size = self.over(box), self.model.n, len(box)
        off = [arb(v) for v in (*noise, *[0.0] * (size - n))]
        off = [(r + 2 * unit * (v.abs_upper() + r)).upper() for r, v in zip(off, y, strict=True)]
        if not self.velocities:
            return TakenBox(_widened(box, off), off, None)
        between = [v + ball(-1.0, 1.0) * r for v, r in zip(y, off, strict=True)]
        slopes = self._slopes(between[:n])
        rows = [[*slopes[i * n : (i + 1) * n], *[arb(0)] * (size - n)] for i in range(n)]
        rows += [[arb(int(i == j)) for j in range(size)] for i in range(n, size)]
        turn = arb_mat(rows)
        return TakenBox(_widened(box, _magnitude(turn, off)), off, turn)


def _widened(box: Box, off: Sequence[arb]) -> Box:
    pairs = zip(box, off, strict=True)
    return tuple(ends(ball(*side) + ball(-1.0, 1.0) * r) for side, r in pairs)


def _magnitude(A: arb_mat, errors: Sequence[arb]) -> list[arb]:
    """|A| times errors."""
    return [
        sum((v.abs_upper() * e for v, e in zip(row, errors, strict=True)), arb(0)).upper()
        for row in A.tolist()
    ]
