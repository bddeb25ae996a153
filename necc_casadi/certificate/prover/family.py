"""A family, proved on boxes of its parameters ϑ: V_ϑ falls, and where its minimum is.

That V_ϑ never increases is algebra with ϑ as symbols. Its minimum z̄(ϑ) is enclosed by Krawczyk's
operator with ϑ as intervals, X = z₀ − Y∇V(z₀; Θ) + (I − Y∇²V(B; Θ))(B − z₀): where X lies inside B,
every V_ϑ has exactly one critical point in B, and it is in X. The slope of the energy is taken from
that at the target, which the set-points do not change, and ∇²Ĥ between there and here; boxes of ϑ
are halved where the test fails.

References
----------
Krawczyk (1969); Moore, Kearfott and Cloud (2009), section 8.2.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import sympy as sp

from necc_casadi.arrays import Truth, Vector
from necc_casadi.certificate.claims.claim import Claim
from necc_casadi.certificate.claims.family import FamilyBox, FamilyClaim, statement
from necc_casadi.certificate.claims.regions import Side
from necc_casadi.certificate.prover.arithmetic.definite import positive_definite
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
)
from necc_casadi.certificate.prover.arithmetic.potential import Potential, target_enclosure
from necc_casadi.certificate.prover.arithmetic.smooth import is_smooth_on, written
from necc_casadi.designs.design import Design
from necc_casadi.designs.family import Family
from necc_casadi.symbolic.derivatives import gradient
from necc_casadi.symbolic.floats import to_float
from necc_casadi.symbolic.semidefinite import is_positive_semidefinite
from necc_casadi.symbolic.zero import is_zero

__all__ = ["Minima", "open_condition", "prove_family"]


#: Boxes of ϑ at most, and halvings of one.
_MOST, _DEPTH = 1024, 12


#: Halvings of a box in whose middle V has no minimum, until it counts as left out.
_BORDER = 6


#: Growths of a box around the minimum, by which factor, and the room that other arithmetic gets.
_GROWTHS, _WIDER, _ROOM = 6, 1.3, 0.02


#: Of a range: how far beyond its ends it is proved, so that what is no double is covered.
_BEYOND = 2.0**-48


#: Newton steps to a guess of the minimum, and one that is rounding; natural units.
_NEWTON_STEPS, _STILL = 12, 1e-13


#: Beyond this a minimum is not looked for; half-width of a box at least; natural units.
_FAR, _LEAST = 1e3, 2.0**-40


#: Rounds in which the boxes are halved whose error is this share of the largest.
_ROUNDS, _NEAR_LARGEST = 7, 0.75


def prove_family(family: Family) -> Claim:
    """V_ϑ falls for every ϑ, and z̄(ϑ) is enclosed on boxes of the ranges; others are named."""
    missing = open_condition(family)
    if missing is not None:
        return Claim("family", False, f"nothing is claimed of the family: {missing}")
    minima = Minima(family)
    whole = minima.ranges
    boxes, left = minima.covered(whole)
    if not boxes:
        text = "the minimum of V is not enclosed for any box of parameters"
        return Claim("family", False, f"nothing is claimed of the family: {text}")
    found = FamilyClaim(
        family.hash,
        tuple(boxes),
        tuple(_sides(left[k]) for k in range(left.shape[0])),
        _error(family, minima, boxes),
    )
    ranges = {p.name: (to_float(p.range[0]), to_float(p.range[1])) for p in family.parameters}
    measured = bool(family.moved.of("uncertain"))
    return Claim("family", True, statement(ranges, found, family.state_units, measured), found.data)


def open_condition(family: Family) -> str | None:
    """Which condition of V̇ ≤ 0 is not proved for every ϑ."""
    loop = family.moved.loop
    if family.design.form.phi is not None:
        return "Φ is a network"
    for c in family.design.casimirs.functions:
        if not all(is_zero(e) is True for e in loop.M.T * gradient(c, loop.z)):
            return f"{c} is not proved a Casimir for every parameter"
    J, R = loop.plant.J, loop.plant.R
    beyond = {
        p.symbol: p.range[0] + sp.Symbol(f"t_{p.name}", real=True) ** 2 for p in family.parameters
    }
    if not all(is_zero(e) is True for e in [*(J + J.T), *(R - R.T)]):
        return "J is not proved skew, or R symmetric, for every parameter"
    if is_positive_semidefinite(sp.Matrix(R.subs(beyond))) is not True:
        return "R ⪰ 0 is not proved for every parameter"
    return None


@dataclass(frozen=True, eq=False)
class _Enclosed:
    """What Krawczyk's operator says of boxes of ϑ (B, k)."""

    proved: Truth  # (B,)
    around: Interval  # (B, N) in which V has one critical point
    inside: Interval  # (B, N) where that is
    plausible: Truth  # (B,) whether V seems to have a minimum at the middle

    def boxes(self, theta: Interval, rows: Truth) -> list[FamilyBox]:
        """Some of them as data."""
        return [
            FamilyBox(_sides(theta[k]), _sides(self.around[k]), _sides(self.inside[k]))
            for k in np.flatnonzero(rows)
        ]


@dataclass(frozen=True, eq=False)
class Minima:
    """z̄(ϑ) over boxes of ϑ, in natural units of the states."""

    family: Family

    @cached_property
    def design(self) -> Design:
        """The design with ϑ in its energy, in natural units."""
        return self.family.symbolic.natural

    @cached_property
    def ranges(self) -> Interval:
        """The box of all ϑ, (k,), a little wider than the ranges."""
        sides = [[constant(v) for v in p.range] for p in self.family.parameters]
        lo = np.array([float(a.lo) for a, _ in sides])
        hi = np.array([float(b.hi) for _, b in sides])
        room = _BEYOND * np.maximum(np.abs(lo), np.abs(hi))
        return Interval(lo - room, hi + room)

    @cached_property
    def networks(self) -> Potential:
        """Hc + K alone."""
        loop = self.design.loop
        nothing = replace(loop, plant=replace(loop.plant, H=sp.Integer(0)))
        return Potential(replace(self.design, loop=nothing))

    @cached_property
    def _at_target(self) -> list[sp.Expr]:
        """∇Ĥ at x*, of ϑ alone, (n,)."""
        plant = self.design.loop.plant
        there = dict(zip(plant.x, self.design.x_star, strict=True))
        return [sp.simplify(e.subs(there)) for e in gradient(plant.H, plant.x)]

    @cached_property
    def _bends(self) -> list[sp.Expr]:
        """∇²Ĥ, row by row, (n²,)."""
        plant = self.design.loop.plant
        return list(sp.hessian(plant.H, plant.x))

    @cached_property
    def target(self) -> Interval:
        """z*, (N,)."""
        return target_enclosure(self.design)

    def slope_at_target(self, theta: Interval) -> Interval:
        """∇Ĥ(x*; Θ) over boxes (B, k), by mean-value forms about their middles, (B, n)."""
        middle = point(theta.mid)
        wide, near = (self._jets(self._at_target, theta), self._jets(self._at_target, middle))
        parts, zero = [], point(np.zeros(theta.shape[0]))
        for w, m in zip(wide, near, strict=True):
            if isinstance(w, Jet) and isinstance(m, Jet):
                parts.append(w.centred(m, theta - middle).value)
            else:
                parts.append(zero + (w if isinstance(w, Interval) else w.value))
        return stack(parts)

    def _jets(self, expressions: list[sp.Expr], theta: Interval) -> list[Jet | Interval]:
        known = dict(zip(self.family.moved.symbols, coordinates(theta), strict=True))
        return expression_jets(expressions, known)

    def _hessian_of_energy(self, Z: Interval, theta: Interval) -> Interval:
        """∇²Ĥ over boxes (B, N) and (B, k), (B, n, n); by mean-value forms."""
        plant, n = self.design.loop.plant, self.design.loop.plant.n
        both = Interval(
            np.concatenate([Z.lo[:, :n], theta.lo], 1), np.concatenate([Z.hi[:, :n], theta.hi], 1)
        )
        middle = point(both.mid)
        symbols = (*plant.x, *self.family.moved.symbols)
        wide, near = (
            expression_jets(self._bends, dict(zip(symbols, coordinates(v), strict=True)))
            for v in (both, middle)
        )
        zero, parts = point(np.zeros(Z.shape[0])), []
        for w, m in zip(wide, near, strict=True):
            if isinstance(w, Jet) and isinstance(m, Jet):
                parts.append(w.centred(m, both - middle).value)
            else:
                parts.append(zero + (w if isinstance(w, Interval) else w.value))
        return stack(parts).reshape(Z.shape[0], n, n)

    def slopes(self, Z: Interval, theta: Interval) -> tuple[Interval, Interval]:
        """∇V and ∇²V over boxes (B, N) and (B, k)."""
        n = self.design.loop.plant.n
        lo, hi = np.minimum(Z.lo, self.target.lo), np.maximum(Z.hi, self.target.hi)
        with np.errstate(all="ignore"):
            between = self._hessian_of_energy(Interval(lo, hi), theta)
            step = (Z - self.target)[:, :n]
            slope = self.slope_at_target(theta) + matmul(between, step[..., None])[..., 0]
            here, H = self.networks.jet(Z), self._hessian_of_energy(Z, theta)
        grad = Interval(here.grad.lo.copy(), here.grad.hi.copy())
        hess = Interval(here.hess.lo.copy(), here.hess.hi.copy())
        total, bends = grad[:, :n] + slope, hess[:, :n, :n] + H
        grad.lo[:, :n], grad.hi[:, :n] = total.lo, total.hi
        hess.lo[:, :n, :n], hess.hi[:, :n, :n] = bends.lo, bends.hi
        return grad, hess

    def _guess(self, theta: Vector) -> tuple[Vector, Vector]:
        """z̄ and ∇²V there at points ϑ (B, k), in floats: (B, N) and (B, N, N)."""
        z = np.asarray(np.repeat(self.target.mid[None], len(theta), 0), float)
        for _ in range(_NEWTON_STEPS):
            grad, hess = self.slopes(point(z), point(theta))
            step = np.linalg.solve(_usable(hess.mid), np.nan_to_num(grad.mid)[..., None])[..., 0]
            z = np.asarray(z - np.clip(step, -1.0, 1.0), float)
            if np.abs(step).max() < _STILL:
                break
        return z, _usable(self.slopes(point(z), point(theta))[1].mid)

    def enclosed(self, theta: Interval) -> _Enclosed:
        """Boxes around z̄ for boxes of ϑ (B, k), by Krawczyk's operator."""
        z0, bends = self._guess(theta.mid)
        Y, identity = np.asarray(np.linalg.inv(bends), float), np.eye(z0.shape[1])
        slope = self.slopes(point(z0), theta)[0]
        with np.errstate(all="ignore"):
            step = matmul(point(Y), slope[..., None])[..., 0]
        reach = np.nan_to_num(step.magnitude, nan=_FAR) * 1.2 + _LEAST * (1 + np.abs(z0))
        proved = np.zeros(len(z0), dtype=bool)
        around, inside = (Interval(z0.copy(), z0.copy()) for _ in range(2))

        def image(B: Interval) -> tuple[Interval, Interval]:
            """∇²V on boxes, and what Krawczyk's operator makes of them, with room."""
            hess = self.slopes(B, theta)[1]
            with np.errstate(all="ignore"):
                rest = matmul(identity - matmul(point(Y), hess), (B - z0)[..., None])[..., 0]
                X = z0 - step + rest
            room = _ROOM * X.rad + _LEAST / 4
            return hess, Interval(X.lo - room, X.hi + room)

        for _ in range(_GROWTHS):
            B = Interval(z0 - reach, z0 + reach)
            hess, X = image(B)
            held = (z0 - (1 - _ROOM) * reach < X.lo) & (X.hi < z0 + (1 - _ROOM) * reach)
            new = held.all(1) & positive_definite(hess) & ~proved
            for kept, found in ((around, B), (inside, X)):
                kept.lo[new], kept.hi[new] = found.lo[new], found.hi[new]
            proved |= new
            if proved.all():
                break
            grown = np.nan_to_num(np.maximum(np.abs(X.lo - z0), np.abs(X.hi - z0)), nan=_FAR)
            reach = np.minimum(np.maximum(_WIDER * grown, reach * 1.05), _FAR)
        nearer = image(inside)[1]  # what is left of them holds the minimum as well
        inside = Interval(np.maximum(inside.lo, nearer.lo), np.minimum(inside.hi, nearer.hi))
        plausible: Truth = np.asarray(np.linalg.eigvalsh(bends)[:, 0] > 0)
        proved &= self._smooth(around, theta)
        return _Enclosed(proved, around, inside, plausible)

    def _smooth(self, Z: Interval, theta: Interval) -> Truth:
        """Whether all is smooth on boxes (B, N) and (B, k): on their hull or, where not, on each.

        (B,).
        """
        both = Interval(np.concatenate([Z.lo, theta.lo], 1), np.concatenate([Z.hi, theta.hi], 1))
        if self._is_smooth(Interval(both.lo.min(0), both.hi.max(0))):
            return np.ones(Z.shape[0], dtype=bool)
        return np.array([self._is_smooth(both[k]) for k in range(Z.shape[0])], dtype=bool)

    def _is_smooth(self, box: Interval) -> bool:
        symbols = (*self.design.loop.z, *self.family.moved.symbols)
        return is_smooth_on(written(self.design), symbols, box)

    def covered(self, whole: Interval) -> tuple[list[FamilyBox], Interval]:
        """Boxes that are proved, and those that are not: both together cover all ϑ."""
        todo, boxes = whole[None], list[FamilyBox]()
        left = todo[:0]
        for depth in range(_DEPTH):
            found = self.enclosed(todo)
            boxes += found.boxes(todo, found.proved)
            # without a minimum at its middle a box is halved as often as a border needs
            hopeless = ~found.proved & ~found.plausible & (depth >= _BORDER)
            left = concatenate(left, todo[np.flatnonzero(hopeless)])
            todo = todo[np.flatnonzero(~found.proved & ~hopeless)]
            if not todo.shape[0]:
                break
            if depth == _DEPTH - 1 or len(boxes) + left.shape[0] + 2 * todo.shape[0] > _MOST:
                left = concatenate(left, todo)
                break
            todo = self._halved(todo)
        return (self._sharpened(boxes) if boxes else boxes), left

    def _sharpened(self, boxes: list[FamilyBox]) -> list[FamilyBox]:
        """The boxes that hold the largest errors of the plant's states halved, a few times."""
        n = self.design.loop.plant.n
        for _ in range(_ROUNDS):
            table = np.array([box.minimum for box in boxes])[:, :n] - self.target.mid[:n, None]
            lo, hi = table[..., 0], table[..., 1]
            most = np.maximum(hi.max(0), -lo.min(0))
            large: Truth = (np.maximum(hi, -lo) > _NEAR_LARGEST * most) & (most > _LEAST)
            far = np.asarray(large.any(axis=1), bool)
            theta = np.array([box.theta for box in boxes])[far]
            if not far.any() or len(boxes) + int(far.sum()) > _MOST:
                break
            halves = self._halved(Interval(theta[..., 0], theta[..., 1]))
            found = self.enclosed(halves)
            if not found.proved.all():
                break
            kept = [box for box, out in zip(boxes, far, strict=True) if not out]
            boxes = kept + found.boxes(halves, found.proved)
        return boxes

    def _halved(self, theta: Interval) -> Interval:
        """Each box cut across the parameter that moves ∇V and ∇²V most."""
        z, bends = self._guess(theta.mid)
        Y = np.asarray(np.linalg.inv(bends), float)
        effects = []
        for k in range(theta.shape[1]):
            lo, hi = theta.mid.copy(), theta.mid.copy()
            lo[:, k], hi[:, k] = theta.lo[:, k], theta.hi[:, k]
            grad, hess = self.slopes(point(z), Interval(lo, hi))
            effects.append(
                np.nan_to_num((np.abs(Y) @ grad.rad[..., None])[..., 0].max(1), nan=np.inf)
                + np.nan_to_num((np.abs(Y) @ hess.rad).max((1, 2)), nan=np.inf)
            )
        axis, rows = np.argmax(np.stack(effects, 1), axis=1), np.arange(theta.shape[0])
        lo, hi = theta.lo.copy(), theta.hi.copy()
        lo[rows, axis] = hi[rows, axis] = theta.mid[rows, axis]
        return Interval(np.concatenate([theta.lo, lo]), np.concatenate([hi, theta.hi]))


def _usable(matrices: Vector) -> Vector:
    """Symmetric and finite, so that a guess can be made; what it is worth is proved after."""
    symmetric = (matrices + np.swapaxes(matrices, 1, 2)) / 2
    size = symmetric.shape[-1]
    finite: Truth = np.asarray(np.isfinite(symmetric).all((1, 2)))
    safe = np.where(finite[:, None, None], symmetric, np.eye(size))
    regular: Truth = np.asarray(np.abs(np.linalg.eigvalsh(safe)).min(1) > 0)
    return np.asarray(np.where(regular[:, None, None], safe, np.eye(size)), float)


def _sides(box: Interval) -> tuple[Side, ...]:
    return tuple((float(a), float(b)) for a, b in zip(box.lo, box.hi, strict=True))


def _error(family: Family, minima: Minima, boxes: list[FamilyBox]) -> dict[str, Side]:
    """How far the plant's states are from their set-points at rest, units of the model."""
    units, plant = family.design.units.state, family.design.loop.plant
    table = np.array([box.minimum for box in boxes])
    result = {}
    for i, name in enumerate(plant.states):
        target = minima.target[i]
        off = Interval(table[:, i, 0].min(), table[:, i, 1].max()) - target
        slack = _BEYOND * 16 * (float(off.magnitude) + float(target.magnitude))
        result[name] = (float((off.lo - slack) * units[i]), float((off.hi + slack) * units[i]))
    return result
