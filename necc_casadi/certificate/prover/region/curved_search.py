"""The obstacle of a region that curved Casimirs shape, in floating point, and the proof below it.

V is minimised on every face from many starts, and its critical points are sought by Newton's
method; what the slope of V leads back from to z̄ is on the border of the region of z̄.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import sympy as sp

from necc_casadi.arrays import Indices, Truth, Vector
from necc_casadi.certificate.claims.curved import CurvedRegion
from necc_casadi.certificate.prover.arithmetic.intervals import Interval
from necc_casadi.certificate.prover.arithmetic.jets import constant
from necc_casadi.certificate.prover.arithmetic.potential import Potential
from necc_casadi.certificate.prover.region.curved import Curved, Face
from necc_casadi.certificate.prover.region.landscape import Landscape
from necc_casadi.certificate.prover.region.obstacle import NEAR_ENOUGH, Obstacle, judged
from necc_casadi.certificate.prover.region.poles import BetweenFaces, denominators, poles_around
from necc_casadi.certificate.prover.region.proof import RegionProof

__all__ = ["CurvedProof", "prove_curved"]

#: Starts per face and for critical points, steps of each, and steps down the slope, none longer.
_STARTS, _STEPS, _DOWN, _SHORT = 40, 40, 60, 0.1
#: Gradients this small, and distances to z̄ this short, in natural units, are none.
_FLAT, _THERE = 1e-7, 1e-3
#: How far off a face points start down.
_NEAR = 1e-4
#: How far from z̄ controller states start, in ranges of f at this height.
_HEIGHT = 1.0
#: Shares of the obstacle's height that are tried.
_SHARES = (0.99, 0.98, 0.97, 0.96, 0.95, 0.9, 0.8, 0.65, 0.5)
#: Near a pass ∂c/∂q is nearly singular where f is nearly h: many cells, and mostly for nothing.
_BESIDE_A_PASS = _SHARES[1:]


class CurvedProof(RegionProof):
    """A region that holds one critical point of V, and what ends it."""

    def __init__(
        self, curved: Curved, region: CurvedRegion, obstacle: Obstacle, place: BetweenFaces
    ) -> None:
        self.curved = curved
        self._region, self._obstacle, self._place = region, obstacle, place

    @property
    def region(self) -> CurvedRegion:
        """Ω as data."""
        return self._region

    @property
    def obstacle(self) -> Obstacle:
        """What Ω stays just below."""
        return self._obstacle

    @property
    def bottom(self) -> float:
        """An upper bound of V(z̄)."""
        return float(self.curved.bottom.hi)

    @property
    def place(self) -> BetweenFaces:
        """All states on Ω, the angles wrapped."""
        return self._place

    @property
    def angles(self) -> tuple[int, ...]:
        """States that may take every value."""
        return tuple(self.curved.potential.active[k] for k in self.curved.angles)


def prove_curved(potential: Potential, z_bar: Interval) -> CurvedProof | None:
    """The region just below its obstacle; None where V is not of this kind, or nothing is proved.

    Parameters
    ----------
    potential
        V with the momenta at rest.
    z_bar
        Holds z̄, (N,).
    """
    curved = Curved.of(potential, z_bar)
    if curved is None:
        return None
    obstacle = _Search(curved).obstacle()
    if obstacle is None:
        return None
    bottom, obstacle = float(curved.bottom.hi), judged(potential, obstacle)
    for share in _BESIDE_A_PASS if obstacle.kind == "critical_point" else _SHARES:
        region = curved.region(bottom + share * (obstacle.level - bottom))
        place = None if region is None else curved.place(region.height)
        if region is not None and place is not None:
            named = obstacle if share >= NEAR_ENOUGH else replace(obstacle, kind="arithmetic")
            return CurvedProof(curved, region, named, place)
    return None


@dataclass(frozen=True, eq=False)
class _Search:
    """Points that go down on the faces, and points that go to critical points, all at once."""

    curved: Curved

    @cached_property
    def _landscape(self) -> Landscape:
        every = tuple(range(len(self.curved.symbols)))
        potential = self.curved.potential
        design = potential.design
        return Landscape(design.lyapunov, design.z_star, potential.active, (), every)

    @cached_property
    def _y_bar(self) -> Vector:
        return self.curved.y_bar.mid

    @cached_property
    def faces(self) -> list[Face]:
        """Faces of q, and values that the controller's states may not take."""
        curved = self.curved
        loop = curved.potential.design.loop
        faces = [face for pair in curved.faces for face in pair]
        factors = denominators([*sp.Matrix(loop.M), *sp.Matrix(loop.ports)]) or []
        for k, s in enumerate(curved.symbols[curved.r :], start=curved.r):
            poles = poles_around(factors, s, float(self._y_bar[k]))
            faces += [Face(k, value, "singularity") for value in poles if value is not None]
            named = loop.plant.domain.get(str(s), ())
            faces += [Face(k, sp.sympify(value), "domain") for value in named]
        return faces

    def obstacle(self) -> Obstacle | None:
        """The lowest that belongs to the component of z̄."""
        rows = np.repeat(np.arange(-1, len(self.faces)), _STARTS)  # −1: free, to critical points
        Y = self._starts(len(rows))
        held = np.zeros(Y.shape, dtype=bool)
        for row, number in enumerate(rows):
            if number >= 0:
                face = self.faces[number]
                held[row, face.state] = True
                Y[row, face.state] = float(constant(face.value).mid)
        Y, V, saddle, way = self._settled(Y, held, rows >= 0)
        inwards = np.sign(self._y_bar - Y) * held * _NEAR * np.maximum(1.0, np.abs(Y))
        nudged = Y + np.where((rows >= 0)[:, None], inwards, way)
        back = self._leads_back(nudged)
        free = rows < 0
        back[free] |= self._leads_back((Y - way)[free])
        heights = np.where(back & (saddle | ~free) & np.isfinite(V), V, np.inf)
        found = [
            o
            for number in range(-1, len(self.faces))
            for o in self._least(number, rows, heights, Y)
        ]
        return min([*found, *self._momenta()], key=lambda o: o.level, default=None)

    def _least(self, number: int, rows: Indices, heights: Vector, Y: Vector) -> list[Obstacle]:
        """What the points of one face, or the free ones, found."""
        at = int(np.argmin(np.where(rows == number, heights, np.inf)))
        if rows[at] != number or not np.isfinite(heights[at]):
            return []
        kind = "critical_point" if number < 0 else self.faces[number].kind
        return [Obstacle(kind, float(heights[at]), self._whole(Y[at]))]

    def _whole(self, y: Vector) -> Vector:
        """All states (N,), the momenta at rest."""
        z = np.zeros(self.curved.potential.design.loop.n)
        z[list(self.curved.potential.active)] = y
        return z

    def _starts(self, count: int) -> Vector:
        """States around the fibre, all over q; each eighth one is near z̄."""
        curved, rng = self.curved, np.random.default_rng(0)
        box = curved.box(_HEIGHT)
        Y = rng.uniform(box.lo, box.hi, (count, len(curved.symbols)))
        Y[:, curved.r :] = (Y[:, curved.r :] + self._y_bar[curved.r :]) / 2
        Y[::8] = self._y_bar + (Y[::8] - self._y_bar) / 4
        return Y

    def _settled(self, Y: Vector, held: Truth, down: Truth) -> tuple[Vector, Vector, Truth, Vector]:
        """Places, V, saddles among them, ways off: after steps `down`, or else to ∇V = 0."""
        length = np.full(len(Y), 0.5)
        best, lowest, trial = Y, np.full(len(Y), np.inf), Y
        step = np.zeros_like(Y)
        for _ in range(_STEPS):
            V, grad, hess = self._landscape.jets(trial)
            better = ~down | (lowest > V)
            best = np.where(better[:, None], trial, best)
            lowest = np.where(better, V, lowest)
            length = np.where(better, np.minimum(0.5, 2 * length), length / 4)
            moves = self._steps(np.where(held, 0.0, grad), hess, held, down)
            step = np.where(better[:, None], moves, step)
            size = np.maximum(np.abs(step).max(1), 1e-300)
            trial = best + step * np.minimum(1.0, length / size)[:, None]
        V, grad, hess = self._landscape.jets(best)
        usable: Truth = np.asarray(np.isfinite(hess).all((1, 2)))
        values, vectors = np.linalg.eigh(np.where(usable[:, None, None], hess, np.eye(Y.shape[1])))
        flat = usable & (np.abs(grad).max(1) < _FLAT) & self._is_between(best, _NEAR)
        saddle = flat & (values[:, 0] < 1e-6 * np.abs(values).max(1))
        return best, V, np.asarray(saddle), 1e-2 * vectors[:, :, 0]

    def _steps(self, grad: Vector, hess: Vector, held: Truth, down: Truth) -> Vector:
        """Newton's steps in what is not held; down the slope curvatures count by their sizes."""
        usable: Truth = np.asarray(np.isfinite(hess).all((1, 2)) & np.isfinite(grad).all(1))
        fixed = held[:, :, None] | held[:, None, :]
        safe = np.where(usable[:, None, None], np.where(fixed, 0.0, hess), 0.0)
        values, vectors = np.linalg.eigh(safe)
        largest = np.maximum(np.abs(values).max(1, keepdims=True), 1e-300)
        size = np.maximum(np.abs(values), 1e-3 * largest)
        signed = np.where(values < 0, -size, size)
        along = (np.swapaxes(vectors, 1, 2) @ grad[..., None])[..., 0]
        along = along / np.where(down[:, None], size, signed)
        return np.where(usable[:, None], -(vectors @ along[..., None])[..., 0], 0.0)

    def _leads_back(self, Y: Vector) -> Truth:
        """Whether the slope of V leads down to z̄, the angles wrapped, between the faces."""
        inside = self._is_between(Y, 0.0)
        nothing, every = np.zeros(Y.shape, dtype=bool), np.ones(len(Y), dtype=bool)
        for _ in range(_DOWN):
            _, grad, hess = self._landscape.jets(Y)
            step = self._steps(grad, hess, nothing, every)
            Y = (
                Y
                + step * np.minimum(1.0, _SHORT / np.maximum(np.abs(step).max(1), 1e-300))[:, None]
            )
            inside = inside & self._is_between(Y, 0.0)
        off = Y - self._y_bar
        off[:, self.curved.angles] = np.angle(np.exp(1j * off[:, self.curved.angles]))
        return np.asarray(inside & (np.abs(off).max(1) < _THERE))

    def _is_between(self, Y: Vector, margin: float) -> Truth:
        """Whether states q are between their faces."""
        box, at = self.curved.box(_HEIGHT), [pair[0].state for pair in self.curved.faces]
        off = margin * np.maximum(1.0, np.abs(Y[:, at]))
        return np.asarray(((Y[:, at] > box.lo[at] + off) & (Y[:, at] < box.hi[at] - off)).all(1))

    def _momenta(self) -> list[Obstacle]:
        """Bounds that the user names for momenta: ½ b²/(A⁻¹)ᵢᵢ above V(z̄), at z̄'s inertia."""
        design, potential = self.curved.potential.design, self.curved.potential
        p = [design.loop.z[i] for i in potential.resting]
        at = dict(zip(design.loop.z, self.curved.z_bar.mid, strict=True))
        result = []
        for k, s in enumerate(p):
            if str(s) in design.loop.plant.domain:
                lo, hi = (float(b) for b in design.loop.plant.domain[str(s)])
                A = np.array(sp.hessian(design.loop.plant.H, p).subs(at).evalf(), float)
                bound, inertia = (lo if -lo < hi else hi), np.linalg.inv(A)
                z = self._whole(self._y_bar)
                z[list(potential.resting)] = inertia[:, k] * bound / inertia[k, k]
                level = float(self.curved.bottom.mid) + bound**2 / (2 * inertia[k, k])
                result.append(Obstacle("domain", level, z))
        return result
