"""Matrices of closed forms to the first order in their variables, in Arb balls.

    F(m + δ) = F(m) + Σ Fₖ(m) δₖ + ½ δᵀF″δ,   F″ enclosed over all m + δ,

with δ = hε + d: numbers |εₖ| ≤ 1 that are the box, and a drift d from there.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations_with_replacement, count, pairwise, product

import sympy as sp
from flint import arb, arb_mat

from necc_casadi.certificate.checker.arithmetic.balls import Box, ball
from necc_casadi.certificate.checker.arithmetic.tapes import Tape
from necc_casadi.certificate.checker.sampled.linear import Linear

__all__ = ["Linearised"]


#: Pieces of a box on which F″ is enclosed, along one or two variables of denominators.
_PIECES = {1: 8, 2: 3}


class Linearised:
    """A matrix in some variables; its entries that vary are enclosed to the first order."""

    def __init__(self, matrix: sp.Matrix, symbols: Sequence[sp.Symbol], symmetric: bool) -> None:
        self.shape, self.d, self.symmetric = matrix.shape, len(symbols), symmetric
        rows, columns = matrix.shape
        self._places = [(i, j) for i in range(rows) for j in range(i if symmetric else 0, columns)]
        entries = [sp.sympify(matrix[place]) for place in self._places]
        firsts = [[sp.diff(e, s) for s in symbols] for e in entries]
        self._pairs = list(combinations_with_replacement(range(self.d), 2))
        seconds = [[sp.diff(f[k], symbols[n]) for k, n in self._pairs] for f in firsts]
        self._at = Tape([v for e, f in zip(entries, firsts, strict=True) for v in (e, *f)], symbols)
        self._over = Tape(
            [v for e, s in zip(entries, seconds, strict=True) for v in (e, *s)], symbols
        )
        powers = [p for e in entries for p in e.atoms(sp.Pow) if p.exp.is_negative]
        below = [k for k, s in enumerate(symbols) if any(p.base.has(s) for p in powers)]
        self._cut = below if len(below) in _PIECES else []

    def __call__(
        self, box: Box, reached: Box, names: Sequence[int], fresh: count[int], share: arb | int = 1
    ) -> Linear:
        """Over a box and wherever drifts lead from there, its means too; a name per variable.

        `share` is how much of a drift that may be 0 the mean of the places has at most.
        """
        halves = [(arb(hi) - arb(lo)) / 2 for lo, hi in box]
        drifts = [
            (share * (arb(a) - arb(lo)), share * (arb(b) - arb(hi)))
            for (lo, hi), (a, b) in zip(box, reached, strict=True)
        ]
        middle = [
            arb(lo) / 2 + arb(hi) / 2 + (a + b) / 2
            for (lo, hi), (a, b) in zip(box, drifts, strict=True)
        ]
        reach = [(ball(*side) - m).abs_upper() for side, m in zip(reached, middle, strict=True)]
        moved = [((b - a) / 2).abs_upper() for a, b in drifts]
        at, over = self._at(middle), self._enclosed(reached)
        center = arb_mat(*self.shape)
        parts = {name: arb_mat(*self.shape) for name in names}
        size, many = 1 + self.d, 1 + len(self._pairs)
        for e, place in enumerate(self._places):
            value, slopes = at[e * size], at[e * size + 1 : (e + 1) * size]
            whole, bends = over[e * many], over[e * many + 1 : (e + 1) * many]
            rest = sum((abs(f) * m for f, m in zip(slopes, moved, strict=True)), arb(0))
            for (k, n), bend in zip(self._pairs, bends, strict=True):
                rest = rest + bend.abs_upper() * reach[k] * reach[n] / (2 if k == n else 1)
            rest = rest.upper()
            if not bool(rest * 2 <= whole.rad()):  # as wide as what it would be apart
                value, rest, slopes = whole.mid(), whole.rad(), [arb(0)] * self.d
            self._put(center, place, value)
            for name, slope, half in zip(names, slopes, halves, strict=True):
                self._put(parts[name], place, slope * half)
            if not bool(rest == arb(0)):
                own = parts[next(fresh)] = arb_mat(*self.shape)
                self._put(own, place, rest)
        return Linear(center, parts)

    def _put(self, matrix: arb_mat, place: tuple[int, int], value: arb) -> None:
        i, j = place
        matrix[i, j] = value
        if self.symmetric:
            matrix[j, i] = value

    def _enclosed(self, box: Box) -> list[arb]:
        """Entries and F″ over a box, in pieces."""
        found: list[arb] | None = None
        for piece in self._pieces(box):
            values = self._over([ball(*side) for side in piece])
            found = values if found is None else list(map(arb.union, found, values))
        return found or []

    def _pieces(self, box: Box) -> Iterator[Box]:
        sides = [[side] for side in box]
        for k in self._cut:
            (lo, hi), parts = box[k], _PIECES[len(self._cut)]
            ends = [lo + (hi - lo) * (i / parts) for i in range(parts)] + [hi]
            sides[k] = list(pairwise(ends))
        return product(*sides)
