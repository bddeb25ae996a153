"""Regions where curved Casimirs alone shape V; what is claimed stands in the claims.

At a critical point ∇CᵀM = 0, M = Jcl − Rcl, so that ∇(H + Hc)ᵀM = 0; with p = 0 this is
∇HcᵀM_ξ = 0, M_ξ the rows of ξ, hence ξ = ξ̄ where a block of M_ξ is regular. On that fibre
∂c/∂qᵀ∇K = 0, and where ∂c/∂q is regular the point is a nondegenerate minimum of V. Where none of
the component comes near the faces of q its image with the angles wrapped is compact; −∇V contracts
it to one minimum, and it is a copy of that image.

No network is evaluated but at z̄. What is proved over cells is f > h on the faces, where c may
depend on fewer states, and f > h or det ∂c/∂q ≠ 0 on the fibre.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations
from typing import Literal

import numpy as np
import sympy as sp

from necc_casadi.arrays import Truth, Vector
from necc_casadi.certificate.claims.curved import CurvedRegion, Faces
from necc_casadi.certificate.prover.arithmetic.boxes import matrix_enclosure, subdivide
from necc_casadi.certificate.prover.arithmetic.definite import positive_definite, regular
from necc_casadi.certificate.prover.arithmetic.hessian_floor import hessian_floor
from necc_casadi.certificate.prover.arithmetic.intervals import (
    Interval,
    concatenate,
    matmul,
    point,
    stack,
)
from necc_casadi.certificate.prover.arithmetic.jets import (
    Jet,
    constant,
    coordinates,
    expression_jets,
    expression_values,
)
from necc_casadi.certificate.prover.arithmetic.potential import Potential
from necc_casadi.certificate.prover.arithmetic.smooth import written
from necc_casadi.certificate.prover.region.bounds import bounds_of
from necc_casadi.certificate.prover.region.poles import (
    Between,
    BetweenFaces,
    denominators,
    poles_around,
)
from necc_casadi.certificate.prover.region.reduced import quadratic_range
from necc_casadi.lyapunov.networks import Network
from necc_casadi.symbolic.expressions import to_text
from necc_casadi.symbolic.zero import is_zero

__all__ = ["Curved", "Face"]

#: Widths of a momentum's range that are tried, by what it is at the middles of the cells.
_WIDER = (1.001, 1.01, 1.05, 1.2, 1.5, 2.0, 4.0)
#: Half a period, a little more than π; room for other arithmetic in ranges and floors.
_HALF_PERIOD, _EASE = 3.1415927, 1e-6
#: Cells per axis at first, cells in one evaluation, cells and rounds at most.
_FIRST, _ROWS, _MOST, _ROUNDS = 6, 2048, 60_000, 40


@dataclass(frozen=True)
class Face:
    """A value that a state q may not cross."""

    state: int  # position among the active states
    value: sp.Expr
    kind: Literal["singularity", "domain"]  # a pole of the loop, or a bound of the user's


@dataclass(frozen=True, eq=False)
class Curved:
    """V of a design in the coordinates y = (q, ξ), and what does not depend on the level."""

    potential: Potential
    z_bar: Interval  # (N,)
    floor_k: Vector  # (r,)
    floor_h: Vector  # (nc,)
    faces: tuple[tuple[Face, Face], ...]
    columns: tuple[int, ...]
    casimirs: tuple[sp.Expr, ...]

    @classmethod
    def of(cls, potential: Potential, z_bar: Interval) -> Curved | None:
        """None where V is not of this kind."""
        design = potential.design
        loop, form, functions = design.loop, design.form, design.casimirs.functions
        r, active = len(functions), potential.active
        square = r + loop.controller.nc == len(active)
        if not (square and potential.energy.is_number) or form.phi is not None or form.betas:
            return None
        of_hc, of_k = form.split(design.weights)[:2]
        k, h = _diagonal_below(form.k, of_k), _diagonal_below(form.hc, of_hc)
        columns = _regular_columns(potential, z_bar)
        if k is None or h is None or columns is None:
            return None
        faces = _faces(potential, z_bar)
        return None if faces is None else cls(potential, z_bar, k, h, faces, columns, functions)

    @property
    def r(self) -> int:
        """Number of states q and of Casimirs."""
        return len(self.casimirs)

    @cached_property
    def symbols(self) -> list[sp.Symbol]:
        """The states y = (q, ξ)."""
        return [self.potential.design.loop.z[i] for i in self.potential.active]

    @cached_property
    def y_bar(self) -> Interval:
        """Holds z̄ in the active states, (d,)."""
        return self.z_bar[list(self.potential.active)]

    @cached_property
    def bottom(self) -> Interval:
        """V(z̄)."""
        return self.potential.jet(self.y_bar[None]).value[0]

    @cached_property
    def c_bar(self) -> Interval:
        """c(z̄), where K is least, (r,)."""
        values = {s: self.y_bar[k] for k, s in enumerate(self.symbols)}
        return stack(expression_values(list(self.casimirs), values))

    @cached_property
    def angles(self) -> list[int]:
        """States q between no faces, positions in y."""
        faced = {lower.state for lower, _ in self.faces}
        return [k for k in range(self.r) if k not in faced]

    # --- ranges -----------------------------------------------------------------------------------

    def half(self, height: float) -> Vector:
        """|ξᵢ − ξ̄ᵢ| on f ≤ h is at most √(2h/Fᵢ), (nc,)."""
        return np.asarray(np.sqrt(2 * height / self.floor_h) * (1 + _EASE), float)

    def box(self, height: float) -> Interval:
        """A box (d,) of y with Ω in it, the angles wrapped."""
        lo, hi = np.full(len(self.symbols), -_HALF_PERIOD), np.full(len(self.symbols), _HALF_PERIOD)
        for lower, upper in self.faces:
            lo[lower.state], hi[lower.state] = constant(lower.value).lo, constant(upper.value).hi
        xi = self.y_bar[self.r :] + Interval(-self.half(height), self.half(height))
        lo[self.r :], hi[self.r :] = xi.lo, xi.hi
        return Interval(lo, hi)

    # --- proofs -----------------------------------------------------------------------------------

    def region(self, level: float) -> CurvedRegion | None:
        """The region below a level; None where it is not proved."""
        height = float((level - self.bottom).hi)
        if not level > self.bottom.hi:
            return None
        with np.errstate(all="ignore"):
            if not self._proved(height):
                return None
        return CurvedRegion(
            level, self.potential.active, tuple(self.floor_k.tolist()),
            tuple(self.floor_h.tolist()), height,
            tuple(Faces(a.state, to_text(a.value), to_text(b.value)) for a, b in self.faces),
            self.columns, tuple(self.y_bar.mid.tolist()),
        )  # fmt: skip

    def _proved(self, height: float) -> bool:
        faces = [face for pair in self.faces for face in pair]
        return (
            self._is_defined(height)
            and self._stays_in_bounds(height)
            and self._is_stiff(height)
            and all(self.face_is_above(face, height) for face in faces)
            and self._fibre_is_regular(height)
        )

    def _is_defined(self, height: float) -> bool:
        """Whether everything is smooth, and the block of M_ξ regular, where Ω may be.

        The Casimirs are looked at on the faces too, where f is.
        """
        place = self.place(height)
        if place is None:
            return False
        box, inside = self.box(height), place.between
        closed = replace(inside, ends={}, sides={s: box[k] for k, s in enumerate(self.symbols)})
        smooth = inside.is_smooth(written(self.potential.design), place.middle)
        block = _block(self.potential, self.columns)
        return smooth and closed.is_smooth(self.casimirs, place.middle) and place.regular(block)

    def place(self, height: float) -> BetweenFaces | None:
        """All states on Ω (N,), q between its faces; None where a momentum is not bounded."""
        design, p = self.potential.design, self._reach_of_momenta(height)
        if p is None:
            return None
        inner, lo, hi = self.box(height), np.zeros(design.loop.n), np.zeros(design.loop.n)
        lo[list(self.potential.active)], hi[list(self.potential.active)] = inner.lo, inner.hi
        lo[list(self.potential.resting)], hi[list(self.potential.resting)] = -p, p
        room = _EASE * (hi - lo)
        box = Interval(lo - room, hi + room)
        ends = {self.symbols[a.state]: (a.value, b.value) for a, b in self.faces}
        sides = {s: box[i] for i, s in enumerate(design.loop.z) if s not in ends}
        turning = tuple(self.symbols[k] for k in self.angles)
        return BetweenFaces(design.loop.z, box, Between(ends, sides, turning))

    def _stays_in_bounds(self, height: float) -> bool:
        """Whether ξ stays in the user's domain; the momenta are looked at with their inertia."""
        loop, box = self.potential.design.loop, self.box(height)
        for k, s in enumerate(self.symbols):
            if k >= self.r and str(s) in loop.plant.domain:
                lo, hi = map(constant, map(sp.sympify, loop.plant.domain[str(s)]))
                if not (lo.hi < box.lo[k] and box.hi[k] < hi.lo):
                    return False
        return True

    def _is_stiff(self, height: float) -> bool:
        """A ≻ 0, and ½ pᵀAp > h where a momentum leaves the user's domain."""
        if not self.potential.resting:
            return True
        inertia = self._inertia(height)
        if inertia is None:
            return False
        bounds = bounds_of(self.potential.design)[list(self.potential.resting)]
        reach = np.minimum(-bounds.lo, bounds.hi)
        return all(_keeps(inertia, k, height, b) for k, b in enumerate(reach))

    def _reach_of_momenta(self, height: float) -> Vector | None:
        """|pᵢ| ≤ √(2h (A⁻¹)ᵢᵢ) on Ω, (resting,); None where A ≻ 0 is not proved."""
        if not self.potential.resting:
            return np.zeros(0)
        inertia = self._inertia(height)
        if inertia is None or not positive_definite(inertia).all():
            return None
        least = np.linalg.inv(inertia.mid)
        result = np.sqrt(2 * height * np.einsum("bii->bi", least).max(0))
        for k in range(len(result)):
            wider = (float(result[k] * w) for w in _WIDER)
            kept = next((b for b in wider if _keeps(inertia, k, height, b)), None)
            if kept is None:
                return None
            result[k] = kept
        return np.asarray(result, float)

    def _inertia(self, height: float) -> Interval | None:
        """A = ∂²H/∂p² over cells of the states q and ξ that it depends on, (B, r, r)."""
        loop, box = self.potential.design.loop, self.box(height)
        A = sp.hessian(loop.plant.H, [loop.z[i] for i in self.potential.resting])
        used = [k for k, s in enumerate(self.symbols) if A.has(s)]
        angles = (self.symbols[k] for k in used if k in self.angles)
        turned = [A.subs(s, s + 2 * sp.pi) - A for s in angles]
        if not all(is_zero(e) is True for matrix in turned for e in matrix):
            return None
        parts = max(4, int(4096 ** (1 / max(1, len(used)))))
        cells = subdivide(box[np.array(used, dtype=int)], parts)
        return matrix_enclosure(A, [self.symbols[k] for k in used], cells)

    def face_is_above(self, face: Face, height: float) -> bool:
        """Whether f > h on a face, for all values of the other states."""
        c, free = self._on_faces[face]
        return self._is_above(c, free, self.box(height)[np.array(free, dtype=int)], height, False)

    @cached_property
    def _on_faces(self) -> dict[Face, tuple[list[sp.Expr], list[int]]]:
        return {face: self._on_face(face) for pair in self.faces for face in pair}

    def _on_face(self, face: Face) -> tuple[list[sp.Expr], list[int]]:
        """The Casimirs on a face, and the states of y that are left.

        Where c does not change along a direction of an angle and another state, that state is
        shifted to 0 by turning the angle, over which c is looked at all around; what f loses with
        a ξ that goes is a square.
        """
        at = {self.symbols[face.state]: face.value}
        c = [sp.trigsimp(sp.expand_trig(e.subs(at))) for e in self.casimirs]
        plain = [e.subs(at) for e in self.casimirs]
        c = [a if is_zero(a - b) is True else b for a, b in zip(c, plain, strict=True)]
        free = [k for k in range(len(self.symbols)) if k != face.state]
        for k in list(free):
            still = all(is_zero(sp.diff(e, self.symbols[k])) is True for e in c)
            shifted = any(a in free and self._are_one(c, a, k) for a in self.angles)
            if (k in self.angles or k >= self.r) and (still or shifted):
                free.remove(k)
                c = [e.subs(self.symbols[k], 0) for e in c]
        return c, free

    def _are_one(self, c: Sequence[sp.Expr], angle: int, k: int) -> bool:
        """Whether c depends on an angle and another state by their sum or difference alone."""
        a, b = self.symbols[angle], self.symbols[k]
        return angle != k and any(
            all(is_zero(sp.diff(e, a) + sign * sp.diff(e, b)) is True for e in c)
            for sign in (1, -1)
        )

    def _fibre_is_regular(self, height: float) -> bool:
        """Whether f > h or det ∂c/∂q ≠ 0 at each q, with ξ = ξ̄."""
        free = list(range(self.r))
        return self._is_above(list(self.casimirs), free, self.box(height)[: self.r], height, True)

    def _is_above(
        self, c: list[sp.Expr], free: list[int], box: Interval, height: float, or_regular: bool
    ) -> bool:
        """Whether f > h over a box of some of the states, or ∂c/∂y in these is regular."""
        cells, seen = subdivide(box, _FIRST), 0
        for _ in range(_ROUNDS):
            left = []
            for first in range(0, cells.shape[0], _ROWS):
                Z = cells[first : first + _ROWS]
                settled, axis = self._settled(c, free, Z, height, or_regular)
                if settled is None:
                    return False
                left.append(_halved(Z[~settled], axis[~settled]))
            seen += cells.shape[0]
            cells = Interval(
                np.concatenate([part.lo for part in left]),
                np.concatenate([part.hi for part in left]),
            )
            if cells.shape[0] == 0:
                return True
            if seen > _MOST:
                break
        return False

    def _settled(
        self, c: list[sp.Expr], free: list[int], Z: Interval, height: float, or_regular: bool
    ) -> tuple[Truth | None, Vector]:
        """Cells (B, free) where it is proved, and the axis to cut the others along.

        None instead of the cells where it does not hold: f ≤ h at the middle of one.
        """
        B, middle = Z.shape[0], Z.mid
        delta = Z - middle
        own = coordinates(concatenate(Z, point(middle)))
        variables: dict[sp.Symbol, Jet | Interval] = {
            self.symbols[k]: own[free.index(k)] if k in free else self.y_bar[k]
            for k in range(len(self.symbols))
        }
        jets = [_as_jet(j, own[0]) for j in expression_jets(c, variables)]  # type: ignore[arg-type]
        terms = [
            (j + (-self.c_bar[i]), w)
            for i, (j, w) in enumerate(zip(jets, self.floor_k, strict=True))
        ]
        terms += [
            (own[free.index(k)] + (-self.y_bar[k]), w)
            for k, w in enumerate(self.floor_h, start=self.r)
            if k in free
        ]
        f = own[0] * 0.0
        for term, weight in terms:
            f = f + term.apply(_square) * (0.5 * float(weight))
        slope, bend = f.grad[B:], f.hess[:B]
        centred = (f.value[B:] + quadratic_range(slope, bend, delta)).lo
        settled = np.maximum(centred, f.value[:B].lo) > height
        half = delta.magnitude
        pulls = slope.magnitude * half + (bend.magnitude * half[:, None, :]).sum(-1) * half
        axis = np.argmax(np.where(np.isfinite(pulls), pulls, np.inf), axis=1)
        if not or_regular and (f.value[B:].hi <= height).any():
            return None, axis
        if or_regular:
            grads = stack([j.grad[:B] for j in jets], 1)
            sharp = stack(
                [j.grad[B:] + matmul(j.hess[:B], delta[..., None])[..., 0] for j in jets], 1
            )
            settled = settled | regular(grads.meet(sharp))
            axis = np.argmax(half, axis=1)
        return np.asarray(settled), axis


def _keeps(inertia: Interval, k: int, height: float, bound: float) -> bool:
    """Whether A ≻ 0, and |p_k| < bound where ½ pᵀAp ≤ h: A − (2h/b²) e_k e_kᵀ ≻ 0."""
    if not bound > 0:
        return False
    needed = np.zeros(inertia.shape[1:])
    needed[k, k] = 2 * height / bound**2 * (1 + _EASE)
    return bool(positive_definite(inertia - needed).all())


def _square(v: Interval) -> tuple[Interval, Interval, Interval]:
    return v.square(), 2.0 * v, point(np.full(v.shape, 2.0))


def _as_jet(part: Jet | Interval, like: Jet) -> Jet:
    return part if isinstance(part, Jet) else like * 0.0 + part


def _halved(cells: Interval, axis: Vector) -> Interval:
    """Cells (B, d) cut in two along an axis (B,) each."""
    rows, middle = np.arange(len(axis)), cells.mid
    low, high = cells.hi.copy(), cells.lo.copy()
    low[rows, axis] = high[rows, axis] = middle[rows, axis]
    return concatenate(Interval(cells.lo, low), Interval(high, cells.hi))


def _diagonal_below(network: Network, weights: Vector) -> Vector | None:
    """A diagonal matrix ≻ 0 below the network's Hessian for all arguments; None where none is."""
    floor = hessian_floor(network, weights)
    middle = np.diag(floor.mid)
    if not (middle > 0).all():
        return None
    scale = np.sqrt(middle)
    beside = np.abs(floor.mid / np.outer(scale, scale)).sum(1) - 1.0
    result = np.asarray(middle * (1 - beside) * (1 - _EASE), float)
    if not (result > 0).all():
        return None
    return result if positive_definite((floor - np.diag(result))[None])[0] else None


def _block(potential: Potential, columns: Sequence[int]) -> sp.Matrix:
    """Columns of the rows of ξ in Jcl − Rcl."""
    loop = potential.design.loop
    rows = list(range(loop.plant.n, loop.n))
    return sp.Matrix(loop.M).extract(rows, list(columns))


def _regular_columns(potential: Potential, z_bar: Interval) -> tuple[int, ...] | None:
    """Columns that make a regular block at z̄; where else it is regular is proved later."""
    loop = potential.design.loop
    values = dict(zip(loop.z, map(sp.Float, z_bar.mid), strict=True))
    numbers = np.array(_block(potential, range(loop.n)).subs(values).evalf(), float)
    best, found = 1e-6, None
    for columns in combinations(range(loop.n), loop.controller.nc):
        size = abs(float(np.linalg.det(numbers[:, columns])))
        if size > best * (1 + 1e-9):
            best, found = size, columns
    return found


def _faces(potential: Potential, z_bar: Interval) -> tuple[tuple[Face, Face], ...] | None:
    """Both faces of each state q that has some; None where one has an end on one side alone."""
    design = potential.design
    loop, functions = design.loop, design.casimirs.functions
    factors = denominators([*sp.Matrix(loop.M), *sp.Matrix(loop.ports)])
    if factors is None:
        return None
    pairs = []
    for k, i in enumerate(potential.active[: len(functions)]):
        symbol, at = loop.z[i], float(z_bar.mid[i])
        ends = [
            None if value is None else Face(k, value, "singularity")
            for value in poles_around(factors, symbol, at)
        ]
        named = loop.plant.domain.get(str(symbol), (None, None))
        for side, value in enumerate(named):
            end = ends[side]
            inside = end is None or (value is not None and (value - end.value > 0) == (side == 0))
            if value is not None and inside:
                ends[side] = Face(k, value, "domain")
        lower, upper = ends
        if lower is not None and upper is not None:
            pairs.append((lower, upper))
        elif (
            lower is not None
            or upper is not None
            or not all(_repeats(c, symbol) for c in functions)
        ):
            return None
    return tuple(pairs)


def _repeats(c: sp.Expr, symbol: sp.Symbol) -> bool:
    return is_zero(c.subs(symbol, symbol + 2 * sp.pi) - c) is True
