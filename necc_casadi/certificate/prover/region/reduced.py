"""Partial minimisation: enclosures of w(s) = min V(s, ·), its gradient and its Hessian, over cells.

Let y = (s, e) with V_ee(s, e) ⪰ F ≻ 0 for every e. Then V(s, ·) has one critical point ε(s), its
minimum; w(s) = V(s, ε(s)) has ∇w = V_s and ∇²w = V_ss − V_se V_ee⁻¹ V_es there, and s ↦ (s, ε(s))
maps the critical points of w one-to-one onto those of V, index for index
(docs/theory.md#regions-by-partial-minimisation). The component of {V ≤ c} with z̄ is the part of
{V ≤ c} over the component of {w ≤ c} with s̄.

On a cell with middle ŝ the minimum is enclosed around a sheet ê(s) = ê + A(s − ŝ); ê and A come
from floating point and need not be right. With H an enclosure of ∇²V around the sheet,

    B = V_es + V_ee A,      G = V_ss + AᵀB + V_se A            (Hessian along the sheet)
    g = V_s + AᵀV_e,        γ(s) = V_e(ŝ, ê) + B(s − ŝ)        (V_e on the sheet)

strong convexity gives |ε − ê(s)|²_F ≤ |γ|²_F⁻¹, hence

    w ∈ V(ŝ, ê) + gᵀδ + ½δᵀGδ − [0, ½|γ|²_F⁻¹],   ∇w ∈ g + Gδ + Bᵀ(ε − ê),   ∇²w ⪰ G − BᵀF⁻¹B.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np

from necc_casadi.arrays import Indices, Truth, Vector
from necc_casadi.certificate.prover.arithmetic.definite import positive_definite
from necc_casadi.certificate.prover.arithmetic.intervals import (
    Interval,
    concatenate,
    matmul,
    point,
)
from necc_casadi.certificate.prover.arithmetic.potential import Potential
from necc_casadi.certificate.prover.region.landscape import Landscape

__all__ = ["Cover", "Reduced", "quadratic_range"]

#: Cells per evaluation: arrays stay within a processor's cache.
_ROWS = 2048
#: Half-width of the first guess around the sheet, as a share of the cell's; then by what was found.
_NEAR, _WIDER, _TRIES = 0.15, 1.3, 2
#: LᵢFLᵢᵀ ⪰ (1 − _SLIP)I is checked for the computed inverse factor Lᵢ; 1 + _COMPENSATION makes up
#: for it in |γ|² and in (F⁻¹)ᵢᵢ.
_SLIP, _COMPENSATION = 1e-9, 1e-8


@dataclass(frozen=True, eq=False)
class Cover:
    """What is known of w over cells (B,); where `ok` is False, nothing is."""

    ok: Truth  # (B,)
    w: Interval  # (B,)
    grad: Interval  # (B, ds)
    turned: Interval  # (B, ds) ∇w along the eigenvectors of G: sharp in narrow valleys
    schur: Interval  # (B, ds, ds) matrices that are ⪯ ∇²w
    e: Interval  # (B, de) holds ε(s)

    @property
    def regular(self) -> Truth:
        """Cells on which ∇w cannot vanish."""
        parts = (self.grad, self.turned)
        free = np.logical_or.reduce([((g.lo > 0) | (g.hi < 0)).any(-1) for g in parts])
        return np.asarray(self.ok & free)

    @property
    def convex(self) -> Truth:
        """Cells on which ∇²w ≻ 0."""
        return np.asarray(self.ok & positive_definite(self.schur))

    def __getitem__(self, rows: object) -> Cover:
        return Cover(*(getattr(self, f.name)[rows] for f in fields(self)))

    def above(self, other: Cover) -> Cover:
        """Both in one, this one's cells first."""
        pairs = [(getattr(self, f.name), getattr(other, f.name)) for f in fields(self)]
        ok = np.concatenate(pairs[0])
        return Cover(ok, *(concatenate(a, b) for a, b in pairs[1:]))

    def replaced(self, rows: Indices, new: Cover) -> Cover:
        """The cover with some of its rows taken from another."""

        def put(old: Interval, other: Interval) -> Interval:
            lo, hi = old.lo.copy(), old.hi.copy()
            lo[rows], hi[rows] = other.lo, other.hi
            return Interval(lo, hi)

        ok = self.ok.copy()
        ok[rows] = new.ok
        names = [f.name for f in fields(self)][1:]
        return Cover(ok, *(put(getattr(self, n), getattr(new, n)) for n in names))


@dataclass(frozen=True, eq=False)
class Reduced:
    """V with the states e minimised out; F ⪯ V_ee for every e and every s in question.

    With a tube E, for e in that box only: w is the least of V(s, ·) over E.
    """

    potential: Potential
    kept: tuple[int, ...]  # s, positions in potential.active
    gone: tuple[int, ...]  # e
    floor: Vector  # F, (de, de)
    tube: Interval | None = None  # E, (de,); None: all e

    @cached_property
    def landscape(self) -> Landscape:
        """V in floating point."""
        design, active = self.potential.design, self.potential.active
        return Landscape(design.lyapunov, design.z_star, active, self.kept, self.gone)

    @cached_property
    def inverse_factor(self) -> Vector:
        """Lᵢ with LᵢFLᵢᵀ ⪰ (1 − 1e-9)I, (de, de).

        Raises
        ------
        ArithmeticError
            Where F is too ill-conditioned for that.
        """
        Li = np.asarray(np.linalg.inv(np.linalg.cholesky(self.floor)), float)
        if self.gone:
            close = matmul(Li, matmul(self.floor, point(Li.T)))
            if not positive_definite(close[None], 1 - _SLIP)[0]:
                raise ArithmeticError("the floor of V_ee is ill-conditioned")
        return Li

    @cached_property
    def widths(self) -> Vector:
        """Upper bounds of √(F⁻¹)ᵢᵢ, (de,)."""
        squares = point(self.inverse_factor).square().sum(0) * (1 + _COMPENSATION)
        return squares.sqrt().hi

    def cover(self, cells: Interval) -> Cover:
        """w, ∇w and ∇²w over cells (B, ds)."""
        rows = range(0, max(1, cells.shape[0]), _ROWS)
        with np.errstate(all="ignore"):
            parts = [self._enclosed(cells[first : first + _ROWS]) for first in rows]
        result = parts[0]
        for part in parts[1:]:
            result = result.above(part)
        return result

    def fibres(self, cells: Interval, cover: Cover, level: float) -> Interval:
        """Boxes of y (B, d) that hold {V ≤ c} over the cells: |e − ε|ᵢ ≤ √(2(c − w)(F⁻¹)ᵢᵢ)."""
        room = np.maximum(((level - point(cover.w.lo)) * 2.0).hi, 0.0)
        half = (point(room).sqrt()[:, None] * self.widths).hi
        e = cover.e + Interval(-half, half)
        lo, hi = (np.empty((cells.shape[0], len(self.kept) + len(self.gone))) for _ in range(2))
        lo[:, list(self.kept)], hi[:, list(self.kept)] = cells.lo, cells.hi
        lo[:, list(self.gone)], hi[:, list(self.gone)] = e.lo, e.hi
        return Interval(lo, hi)

    def _enclosed(self, cells: Interval) -> Cover:
        half = (cells - cells.mid).magnitude.max(-1, initial=0.0)
        result, rho = self._once(cells, _NEAR * half + 1e-9)
        for _ in range(_TRIES):
            again = np.flatnonzero(~result.ok & np.isfinite(rho).all(-1))
            if again.size == 0 or not self.gone:
                break
            wider = _WIDER * rho[again].max(1) + 1e-12
            found, rho[again] = self._once(cells[again], wider)
            result = result.replaced(again, found)
        return result

    def _within_tube(self, e: Interval) -> Truth:
        """Which boxes (B, de) are in the tube's inside."""
        if self.tube is None:
            return np.ones(e.shape[0], dtype=bool)
        return np.asarray(((self.tube.lo < e.lo) & (e.hi < self.tube.hi)).all(-1))

    def reaches(self, s: Vector, level: float) -> bool:
        """Whether V ≤ c for some e at one of the points s (B, ds), in floats; no proof."""
        found = self.landscape.minima(s)
        return bool(((found.w <= level) & self._within_tube(point(found.e))).any())

    def convex_on(self, cells: Interval) -> bool:
        """Whether V(s, ·) has a critical point and ∇²w ≻ 0 on all cells (B, ds)."""
        cover = self.cover(cells)
        return bool((cover.convex & self._within_tube(cover.e)).all())

    def _once(self, cells: Interval, room: Vector) -> tuple[Cover, Vector]:
        """The enclosure where ε stays within `room` (B,) of the sheet, and how far it may be."""
        s, e = list(self.kept), list(self.gone)
        B, middle = cells.shape[0], cells.mid
        delta = cells - middle
        guess = self.landscape.minima(middle)
        e_hat, A = guess.e, np.nan_to_num(guess.tangent)
        sheet = point(e_hat) + matmul(A, delta[..., None])[..., 0]
        within = self._within_tube(sheet)
        lo, hi = np.empty((B, len(s) + len(e))), np.empty((B, len(s) + len(e)))
        lo[:, s], hi[:, s] = cells.lo, cells.hi
        lo[:, e], hi[:, e] = sheet.lo - room[:, None], sheet.hi + room[:, None]
        at = self.landscape.joined(middle, e_hat)
        both = self.potential.sharp_jet(concatenate(Interval(lo, hi), point(at)))
        hess, value, grad = both.hess[:B], both.value[B:], both.grad[B:]
        H_ss, H_es, H_ee = hess[:, s][:, :, s], hess[:, e][:, :, s], hess[:, e][:, :, e]
        At = np.swapaxes(A, 1, 2)
        B_ = H_es + matmul(H_ee, point(A))
        crossed = matmul(point(At), H_es)
        G = H_ss + crossed + _transposed(crossed) + matmul(point(At), matmul(H_ee, point(A)))
        slope = grad[:, s] + matmul(point(At), grad[:, e][..., None])[..., 0]
        gamma = grad[:, e] + matmul(B_, delta[..., None])[..., 0]
        scaled = matmul(self.inverse_factor, gamma[..., None])[..., 0]
        square = point(scaled.square().sum().hi) * (1 + _COMPENSATION)
        rho: Vector = (square.sqrt()[..., None] * self.widths).hi
        error = Interval(-rho, rho)
        w = value + quadratic_range(slope, G, delta)
        w = w + Interval(-(square * 0.5).hi, np.zeros(B))
        drift = matmul(_transposed(B_), error[..., None])[..., 0]
        gradient = slope + matmul(G, delta[..., None])[..., 0] + drift
        turn = point(_eigenvectors(G))
        turned = (
            matmul(turn, slope[..., None])
            + matmul(matmul(turn, G), delta[..., None])
            + matmul(turn, drift[..., None])
        )[..., 0]
        scaled_B = matmul(self.inverse_factor, B_) * (1 + _COMPENSATION)
        schur = G - matmul(_transposed(scaled_B), scaled_B)
        ok = np.asarray((rho <= room[:, None]).all(-1) & np.isfinite(w.lo) & np.isfinite(w.hi))
        ok &= within
        return Cover(ok, w, gradient, turned, schur, sheet + error), rho


def _transposed(v: Interval) -> Interval:
    return Interval(np.swapaxes(v.lo, -1, -2), np.swapaxes(v.hi, -1, -2))


def _eigenvectors(G: Interval) -> Vector:
    """Rows that diagonalise the middles, (B, d, d); the identity where they are not finite."""
    middle = (G.mid + np.swapaxes(G.mid, -1, -2)) / 2
    usable: Truth = np.asarray(np.isfinite(middle).all((-1, -2)))
    safe = np.where(usable[..., None, None], middle, np.eye(middle.shape[-1]))
    return np.swapaxes(np.linalg.eigh(safe)[1], -1, -2)


def quadratic_range(g: Interval, G: Interval, delta: Interval) -> Interval:
    """gᵀδ + ½δᵀGδ over boxes δ (B, d) around 0, each square exactly."""
    half = delta.magnitude
    total = point(np.zeros(half.shape[0]))
    for i in range(half.shape[1]):
        total = total + _parabola(g[:, i], G[:, i, i], half[:, i])
        for j in range(i):
            total = total + G[:, i, j] * (delta[:, i] * delta[:, j])
    return total


def _parabola(g: Interval, a: Interval, half: Vector) -> Interval:
    """The range of gt + ½at² over |t| ≤ half."""
    lo = _lowest(g.magnitude, a.lo, half)
    return Interval(lo, -_lowest(g.magnitude, -a.hi, half))


def _lowest(steep: Vector, a: Vector, half: Vector) -> Vector:
    """A lower bound of ½at² − steep·t over 0 ≤ t ≤ half.

    The vertex bounds it from below wherever it lies; beyond the end, the end is sharper.
    """
    bowl = a > 0
    safe = np.where(bowl, a, 1.0)
    vertex = (-point(steep).square() / point(safe) * 0.5).lo
    end = (point(half).square() * a * 0.5 - point(steep) * half).lo
    inside = bowl & (steep < safe * half * (1 + 1e-9))
    return np.where(inside, vertex, np.minimum(end, 0.0))
