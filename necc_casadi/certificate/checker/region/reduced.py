"""w(s) = min V(s, ·) over cells, once more in Arb balls: the formulas stand in docs/theory.md.

Where V is near its minimum over e is guessed by Newton's method in plain numbers; the guess is not
trusted. On the cell, V(s, ê(s) + d) ≥ V(s, ê(s)) + V_eᵀd + ½|d|²_F for every d, which bounds both
how far below the sheet ê(s) = ê + A(s − ŝ) the minimum can lie and how far away.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from flint import arb, arb_mat

from necc_casadi.certificate.checker.arithmetic.balls import Box, ball, ends
from necc_casadi.certificate.checker.arithmetic.definite import middle_of, positive
from necc_casadi.certificate.checker.arithmetic.potential import Energy
from necc_casadi.certificate.claims.regions import Side

__all__ = ["Cover", "Reduced"]

Numbers = np.ndarray[Any, Any]

#: The most that the inverse factor of F may be off, and what makes up for it.
_SLIP, _MADE_UP = 1e-9, 1e-8
#: Newton's steps at most, and the last one: a hint that is off by ε costs ε² of w.
_STEPS, _STILL = 40, 1e-6
#: The room around the sheet at first, as a share of the cell's half-width; tries to widen it.
_NEAR, _TRIES = 0.2, 4


class Cover(NamedTuple):
    """What is known of w on a cell."""

    low: arb  # w is at least this
    grad: list[arb]  # ∇w, (ds,)
    turned: list[arb]  # ∇w along the eigenvectors of its Hessian
    schur: arb_mat  # ⪯ ∇²w
    e: list[arb]  # holds argmin V(s, ·), (de,)

    @property
    def regular(self) -> bool:
        """Whether ∇w cannot vanish."""
        return any(bool(g > 0) or bool(g < 0) for g in (*self.grad, *self.turned))

    @property
    def convex(self) -> bool:
        """Whether ∇²w ≻ 0."""
        return positive(self.schur, 0)


class Reduced:
    """V with the states e minimised out; V_ee ⪰ F is proved elsewhere.

    Where a tube of e is named, it is proved there, and w is the least of V(s, ·) over it.
    """

    def __init__(
        self,
        energy: Energy,
        kept: Sequence[int],
        floor: Sequence[Sequence[float]],
        start: Sequence[float],  # of Newton's method, in the states of `energy`
        tube: Sequence[Side] = (),  # a side for each of e; empty: all e
    ) -> None:
        self.energy, self._floor, self._start, self.tube = energy, floor, start, tuple(tube)
        self.s = list(kept)
        self.e = [i for i in range(energy.d) if i not in self.s]
        self.factor = self._factor(np.array(floor, float).reshape(len(self.e), len(self.e)))
        self.widths = [self._width(k) for k in range(len(self.e))]
        y = np.array(start, float)
        zero = np.zeros((len(self.e), len(self.s)))
        self._known: dict[Box, Cover | None] = {}
        self._hints: dict[tuple[float, ...], tuple[Numbers, Numbers] | None] = {}
        self._last: tuple[Numbers, Numbers, Numbers] = (y[self.s], y[self.e], zero)

    def over(self, energy: Energy) -> Reduced:
        """The same for another V with the same V_ee: what was guessed may serve there too."""
        other = Reduced(energy, self.s, self._floor, self._start, self.tube)
        other._hints = self._hints
        return other

    def holding(self, position: int) -> Reduced:
        """The same with one state more that is not minimised out."""
        rows = [k for k, i in enumerate(self.e) if i != position]
        floor = [[self._floor[a][b] for b in rows] for a in rows]
        tube = [self.tube[a] for a in rows] if self.tube else ()
        return Reduced(self.energy, sorted([*self.s, position]), floor, self._start, tube)

    def within_tube(self, e: Sequence[arb]) -> bool:
        """Whether e is inside the tube, off its sides."""
        return not self.tube or all(
            bool(lo < v) and bool(v < hi) for v, (lo, hi) in zip(e, self.tube, strict=True)
        )

    def convex(self, cell: Box) -> bool:
        """Whether V(s, ·) has a critical point and ∇²w ≻ 0 on a cell."""
        if not self.e:  # w is V, of whose Hessian more is known than entry by entry
            return positive(self.energy.hessian(cell), 0)
        cover = self.cover(cell)
        return cover is not None and cover.convex and self.within_tube(cover.e)

    def _factor(self, F: Numbers) -> arb_mat | None:
        """Lᵢ with LᵢFLᵢᵀ ⪰ (1 − 1e-9)I."""
        if not self.e:
            return None
        try:
            inverse = np.linalg.inv(np.linalg.cholesky(F))
        except np.linalg.LinAlgError:
            raise ValueError("the floor of V_ee is not positive definite") from None
        Li = arb_mat(inverse.tolist())
        if not positive(Li * arb_mat(F.tolist()) * Li.transpose(), 1 - _SLIP):
            raise ValueError("the floor of V_ee is ill-conditioned")
        return Li

    def _width(self, k: int) -> arb:
        """At least √(F⁻¹)ₖₖ."""
        column = [self._entry(i, k) for i in range(len(self.e))]
        return (sum((v * v for v in column), arb(0)) * (1 + _MADE_UP)).sqrt().upper()

    def _entry(self, i: int, k: int) -> arb:
        return arb(0) if self.factor is None else self.factor[i, k]

    def cover(self, cell: Box) -> Cover | None:
        """W, ∇w and ∇²w on a cell of s; None where the sheet cannot be held."""
        if cell not in self._known:
            self._known[cell] = self._found(cell)
        return self._known[cell]

    def _found(self, cell: Box) -> Cover | None:
        middle = [lo / 2 + hi / 2 for lo, hi in cell]
        steps = [ball(lo, hi) - arb(m) for (lo, hi), m in zip(cell, middle, strict=True)]
        half = max((float(s.abs_upper()) for s in steps), default=0.0)
        at = tuple(middle)
        if at not in self._hints:
            self._hints[at] = self._hint(np.array(middle))
        hint = self._hints[at]
        if hint is None:
            return None
        e_hat, A = hint
        room = _NEAR * half + 1e-12
        for _ in range(_TRIES):
            cover, distance = self._around(cell, middle, steps, e_hat, A, room)
            if cover is not None:
                return cover
            if not distance < float("inf"):
                return None
            room = 1.5 * distance
        return None

    def _around(
        self,
        cell: Box,
        middle: Sequence[float],
        steps: Sequence[arb],
        e_hat: Numbers,
        A: Numbers,
        room: float,
    ) -> tuple[Cover | None, float]:
        """The cover, if the minimum stays within `room` of the sheet, and how far it may be."""
        s, e = self.s, self.e
        slopes = [[arb(float(v)) for v in row] for row in A]
        sheet = [
            arb(float(m)) + sum((a * d for a, d in zip(row, steps, strict=True)), arb(0))
            for m, row in zip(e_hat, slopes, strict=True)
        ]
        if not self.within_tube(sheet):
            return None, float("inf")
        box, at = self._boxes(cell, middle, e_hat, [v + ball(-room, room) for v in sheet])
        value, grad = self.energy.value_and_gradient(at)
        H = self.energy.hull(box)
        de, ds = range(len(e)), range(len(s))
        V_es = [[H[i][j] for j in s] for i in e]
        V_ee = [[H[i][j] for j in e] for i in e]
        B = _sum(V_es, _product(V_ee, slopes))
        turned_es = _product(_flipped(slopes, len(s)), B)
        G = _sum([[H[i][j] for j in s] for i in s], turned_es)
        G = _sum(G, _product([[H[i][j] for j in e] for i in s], slopes))
        along = [grad[i] for i in e]
        slope = [grad[s[i]] + _dot([slopes[k][i] for k in de], along) for i in ds]
        gamma = [grad[e[k]] + _dot(B[k], steps) for k in de]
        scaled = [_dot([self._entry(k, m) for m in de], gamma) for k in de]
        square = sum((v.abs_upper() ** 2 for v in scaled), arb(0)) * (1 + _MADE_UP)
        if not square.is_finite():
            return None, float("inf")
        off = [(square.sqrt() * width).upper() for width in self.widths]
        farthest = max((float(v) for v in off), default=0.0)
        if not all(bool(v <= room) for v in off):
            return None, farthest
        errors = [v * ball(-1.0, 1.0) for v in off]
        drift = [_dot([B[k][i] for k in de], errors) for i in ds]
        gradient = [slope[i] + _dot(G[i], steps) + drift[i] for i in ds]
        low = (value - square / 2 + _least(slope, G, steps)).lower()
        turned = self._turned(slope, G, steps, drift)
        e_range = [v + error for v, error in zip(sheet, errors, strict=True)]
        return Cover(low, gradient, turned, self._schur(G, B), e_range), farthest

    def _turned(
        self, slope: list[arb], G: list[list[arb]], steps: Sequence[arb], drift: list[arb]
    ) -> list[arb]:
        middle = np.array([[float(v.mid()) for v in row] for row in G])
        if not G or not np.isfinite(middle).all():
            return []
        result = []
        for column in np.linalg.eigh((middle + middle.T) / 2)[1].T:
            t = [arb(float(v)) for v in column]
            along = [_dot(t, [row[j] for row in G]) for j in range(len(G))]
            result.append(_dot(t, slope) + _dot(along, steps) + _dot(t, drift))
        return result

    def _schur(self, G: list[list[arb]], B: list[list[arb]]) -> arb_mat:
        if self.factor is None or not G:
            return arb_mat(G)
        scaled = self.factor * arb_mat(B)
        return arb_mat(G) - scaled.transpose() * scaled * arb(1 + _MADE_UP)

    def _boxes(
        self, cell: Box, middle: Sequence[float], e_hat: Numbers, e: Sequence[arb]
    ) -> tuple[Box, Box]:
        """The box around the sheet, and its middle."""
        box: list[tuple[float, float]] = [(0.0, 0.0)] * self.energy.d
        at = list(box)
        for k, i in enumerate(self.s):
            box[i], at[i] = cell[k], (middle[k], middle[k])
        for k, i in enumerate(self.e):
            box[i], at[i] = ends(e[k]), (float(e_hat[k]),) * 2
        return tuple(box), tuple(at)

    def _hint(self, s: Numbers) -> tuple[Numbers, Numbers] | None:
        """A guess of argmin V(s, ·) and of its derivative, from the last one that was asked for."""
        if not self.e:
            return np.zeros(0), np.zeros((0, len(self.s)))
        at, e, tangent = self._last
        e = np.asarray(e + tangent @ (s - at))
        for _ in range(_STEPS):
            y = self._boxes(tuple((v, v) for v in s), s.tolist(), e, [arb(float(v)) for v in e])[1]
            _, grad = self.energy.value_and_gradient(y)
            H = middle_of(arb_mat(self.energy.hull(y)))
            g = np.array([float(grad[i].mid()) for i in self.e])
            ee, es = H[np.ix_(self.e, self.e)], H[np.ix_(self.e, self.s)]
            if not (np.isfinite(H).all() and np.isfinite(g).all()):
                return None
            try:
                step = -np.linalg.solve(ee, g)
            except np.linalg.LinAlgError:
                return None
            e = e + step
            if np.abs(step).max() <= _STILL * (1 + np.abs(e).max()):
                break
        tangent = -np.linalg.solve(ee, es)
        self._last = (s, e, tangent)
        return e, tangent


Matrix = list[list[arb]]


def _product(A: Matrix, B: Matrix) -> Matrix:
    columns = list(zip(*B, strict=True))
    return [[_dot(row, column) for column in columns] for row in A]


def _sum(A: Matrix, B: Matrix) -> Matrix:
    if not B or not B[0]:
        return A
    return [[x + y for x, y in zip(u, v, strict=True)] for u, v in zip(A, B, strict=True)]


def _flipped(A: Matrix, columns: int) -> Matrix:
    return [[row[j] for row in A] for j in range(columns)]


def _dot(a: Sequence[arb], b: Sequence[arb]) -> arb:
    return sum((x * y for x, y in zip(a, b, strict=True)), arb(0))


def _least(g: Sequence[arb], G: list[list[arb]], steps: Sequence[arb]) -> arb:
    """A lower bound of gᵀδ + ½δᵀGδ for δ in the steps, balls around 0."""
    total = arb(0)
    for i, step in enumerate(steps):
        half, steep, bend = step.abs_upper(), g[i].abs_upper(), G[i][i].lower()
        if bool(bend > 0) and bool(steep < bend * half):
            total = total - steep * steep / (2 * bend)
        else:
            total = total + (bend * half * half / 2 - steep * half).min(arb(0))
        for j in range(i):
            total = total + G[i][j] * step * steps[j]
    return total
