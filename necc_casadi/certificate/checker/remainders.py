"""What is left of U, Hc and K beyond first order at rest, in Arb balls, over boxes and at ways."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
import sympy as sp
from flint import arb, arb_mat

from necc_casadi.certificate.checker.arithmetic.balls import (
    Box,
    ball,
    by_bisection,
    ends,
    evaluate,
    meet,
    times,
    widths,
)
from necc_casadi.certificate.checker.arithmetic.definite import norm, positive
from necc_casadi.certificate.checker.arithmetic.networks import Net
from necc_casadi.certificate.checker.model import StoredDesign
from necc_casadi.certificate.checker.plants import StoredPlants
from necc_casadi.symbolic.expressions import parse
from necc_casadi.symbolic.zero import is_zero

__all__ = ["MovedPlant", "StoredRemainders", "casimir_slopes", "constants", "matrix_at"]


#: How often a cell may be halved.
_DEPTH = 24


#: Stretches of the way from rest to a point, along each of which slopes are enclosed.
_STRETCHES = (4, 16)


#: Parameters of which the ends are looked at in place of their ranges.
_MOST_AT_ENDS = 4


#: A number is its double within this share.
_ROUNDED = 2.0**-50


#: Radii of the ball in which ξ̄ is sought.
_RADII = tuple(2.0**-k for k in range(18))


def casimir_slopes(model: StoredDesign) -> sp.Matrix:
    """∂c/∂(q, ξ), m × 2m."""
    symbols = (*model.z[: model.n // 2], *model.z[model.n :])
    return sp.Matrix([[sp.diff(c, s) for s in symbols] for c in model.casimirs])


def constants(matrix: sp.Matrix) -> arb_mat:
    """A matrix of constants."""
    return arb_mat([[evaluate(sp.sympify(v), {}) for v in row] for row in matrix.tolist()])


@dataclass(frozen=True, eq=False)
class MovedPlant:
    """M and U as functions of q̂ = q − r + q*, in natural units but for r."""

    H: sp.Expr
    R: sp.Matrix
    inertia: sp.Matrix
    ranges: Mapping[sp.Symbol, tuple[sp.Expr, ...]]

    @classmethod
    def of(cls, model: StoredDesign) -> MovedPlant:
        """Of the set-points that design.json names; r may be rounded, as the target is.

        And of the parameters that the controller is told.
        """
        place: dict[sp.Symbol, sp.Expr] = {}
        ranges: dict[sp.Symbol, tuple[sp.Expr, ...]] = {}
        for i, s in enumerate(model.z[: model.n // 2]):
            side = model.setpoints.get(model.states[i])
            if side is not None:
                r = sp.Dummy(f"r_{s}", real=True)
                unit = sp.Rational(*float(model.units.state[i]).as_integer_ratio())
                place[s] = s + r / unit - model.target[i]
                ranges[r] = _rounded([parse(v, {}) for v in side])
        H, inertia = model.H, sp.zeros(0, 0) if model.inertia is None else model.inertia
        if model.told_ranges:
            told = StoredPlants(model, model.told_plant, model.told_ranges)
            H, inertia = told.H, told.inertia
            ranges |= {s: _rounded(side) for s, side in told.ranges.items()}

        def there(expr: sp.Expr) -> sp.Expr:
            return sp.sympify(expr).subs(place, simultaneous=True)

        return cls(there(H), model.R, inertia.applyfunc(there), ranges)


def _rounded(side: Sequence[sp.Expr]) -> tuple[sp.Expr, ...]:
    """Both ends farther out than a double is off."""
    lo, hi = side
    slack = sp.Rational(1, 2**48) * (1 + sp.Abs(lo) + sp.Abs(hi))
    return lo - slack, hi + slack


#: A plant in place of the one of the model.
Other = StoredPlants | MovedPlant


class StoredRemainders(ABC):
    """Ũ + K₀ + H₀ over boxes of (e, ξ̃, θ), in natural units but for θ."""

    def __init__(
        self, model: StoredDesign, level: float, plants: StoredPlants | MovedPlant | None
    ) -> None:
        if model.inertia is None:
            raise ValueError("the states are measured")
        self.model, self.level = model, arb(level)
        k = self.k = model.m
        self.q, self.xi = model.z[:k], model.z[model.n :]
        A = model.J[:k, k : model.n]
        rates = A.T.inv()  # y = Gᵀ∂H/∂p = BᵀA⁻¹q̇
        H, friction, inertia = model.H, model.R, model.inertia
        if plants is not None:
            H, friction, inertia = plants.H, plants.R, plants.inertia
        B, R = rates * model.G[k:, :], rates * friction[k:, k:] * A.inv()
        self.M = rates * inertia
        self.U = H.subs(dict.fromkeys(model.z[k : model.n], 0))
        self.R = R
        self.symbols = () if plants is None else tuple(plants.ranges)
        sides = () if plants is None else plants.ranges.values()
        self.theta: Box = tuple(
            (ends(evaluate(lo, {}))[0], ends(evaluate(hi, {}))[1]) for lo, hi in sides
        )
        self.B, self.Gc = constants(B), constants(model.ports[model.n :, k:])
        self.slopes = constants(casimir_slopes(model))
        start = [sp.Integer(0)] * (2 * k)
        symbols = (*self.q, *self.xi)
        self.offset = [
            evaluate(c.subs(dict(zip(symbols, start, strict=True))), {}) for c in model.casimirs
        ]
        self.hc, used = Net.from_weights(model.form["hc"], model.weights)
        self.kc, _ = Net.from_weights(model.form["k"], model.weights[used:])
        #: The target as a double, whichever way it was rounded.
        self.q_star = [
            v + ball(-_ROUNDED, _ROUNDED) * v.abs_upper()
            for v in (evaluate(t, {}) for t in model.target[:k])
        ]
        grad = [sp.diff(self.U, s) for s in self.q]
        self.grad_U, self.hess_U = grad, [[sp.diff(g, s) for s in self.q] for g in grad]
        self.bent = [self.M.diff(s) for s in self.q]
        entries = {sp.sympify(v) for v in (self.U, *self.M, *self.R)}
        self.affine = [
            s
            for s in self.symbols
            if all(is_zero(v.diff(s, 2)) is True for v in entries if v.has(s))
        ][:_MOST_AT_ENDS]
        self.along_theta = [
            (sp.diff(self.U, s), [sp.diff(g, s) for g in grad]) for s in self.symbols
        ]
        self.xi_bar = self._minimum()
        if self.xi_bar is not None:
            self.rest = self._rest()

    # --- where it rests -----------------------------------------------------------------------

    def _minimum(self) -> list[arb] | None:
        """ξ̄, the minimum of Hc(ξ) + K(c(q*, ξ)) in ξ."""
        xi = [arb(v) for v in self.model.xi_star]
        g = norm(self._slope_xi(xi)).upper()
        for radius in _RADII:
            box = [v + ball(-radius, radius) for v in xi]
            hess = self._hess_xi(box)
            middle = arb_mat([[arb(v.mid()) for v in row] for row in self._hess_xi(xi).tolist()])
            least = _least(middle) / 2
            if least > 0 and positive(hess, least) and g < arb(least) * radius:
                away = (g / arb(least)).upper()
                return [v + (-away).union(away) for v in xi]
        return None

    def _c(self, q: list[arb], xi: list[arb]) -> list[arb]:
        found = self.slopes * arb_mat([[v] for v in (*q, *xi)])
        return [found[i, 0] + self.offset[i] for i in range(self.k)]

    def _slope_xi(self, xi: list[arb]) -> list[arb]:
        dk = self.kc(_box(self._c(self.q_star, xi)))[1]
        dh = self.hc(_box(xi))[1]
        N = self.slopes
        return [
            dh[i] + sum((N[j, self.k + i] * dk[j] for j in range(self.k)), arb(0))
            for i in range(self.k)
        ]

    def _hess_xi(self, xi: list[arb]) -> arb_mat:
        return self._springs_h(xi) + self._springs_k(self._c(self.q_star, xi))

    def _springs_h(self, xi: list[arb]) -> arb_mat:
        """∇²Hc."""
        return self._full(self.hc.curvature_on_grid(_box(xi)))

    def _springs_k(self, c: list[arb]) -> arb_mat:
        """N_ξ ∇²K N_ξᵀ."""
        k = self.k
        N = arb_mat([[self.slopes[i, k + j] for j in range(k)] for i in range(k)])
        return N.transpose() * self._full(self.kc.curvature_on_grid(_box(c))) * N

    def _full(self, hess: dict[tuple[int, int], arb]) -> arb_mat:
        k = self.k
        return arb_mat([[hess[min(i, j), max(i, j)] for j in range(k)] for i in range(k)])

    def _rest(self) -> tuple[arb, list[arb]]:
        """Hc + K and its slopes in q at rest; those in ξ are 0 there."""
        xi = self.xi_bar or []
        c = self._c(self.q_star, xi)
        k_value, dk, _ = self.kc(_box(c))
        along = [
            sum((self.slopes[j, i] * dk[j] for j in range(self.k)), arb(0)) for i in range(self.k)
        ]
        return self.hc(_box(xi))[0] + k_value, along

    def known(self, box: Box) -> dict[sp.Symbol, arb]:
        """θ over a box of (e, ξ̃, θ)."""
        return {s: ball(*side) for s, side in zip(self.symbols, box[2 * self.k :], strict=True)}

    # --- the box ------------------------------------------------------------------------------

    @property
    def rests(self) -> list[arb]:
        """The coordinates at which it may be at rest."""
        return self.q_star

    @property
    def leads(self) -> arb:
        """The energy beside E is at least ½vᵀMv with v = q̇ + e times this."""
        return arb(0)

    def keeps_momenta(self, box: Box) -> bool:
        """Every named bound of a momentum is out of reach where E is below the level.

        (Mv)ᵢ² ≤ Mᵢᵢ vᵀMv, and the momenta M q̇ are Mv less M e times what v leads by.
        """
        model, k = self.model, self.k
        rates = model.J[:k, k : model.n]  # p = AᵀM q̇ in natural units, A diagonal
        units = [evaluate(rates[i, i], {}) for i in range(k)]
        named = [
            (i, arb(lo) / units[i], arb(hi) / units[i])
            for i, (lo, hi) in enumerate(model.named_bounds[k : 2 * k])
            if model.states[k + i] in model.domain
        ]
        if named and any(rates[i, j] != 0 for i in range(k) for j in range(k) if i != j):
            return False

        def kept(cell: Box) -> bool:
            left = 2 * (self.level - self._energy(cell))
            if left < 0:
                return True
            e = [ball(*side) for side in cell[:k]]
            here = {s: v + d for s, v, d in zip(self.q, self.q_star, e, strict=True)}
            M = self.inertia(here | self.known(cell))
            ahead = M * arb_mat([[v * self.leads] for v in e])
            for i, lo, hi in named:
                reach, step = M[i, i] * left, ahead[i, 0]
                above, below = hi + step, -(lo + step)
                if not (above > 0 and below > 0 and reach < above**2 and reach < below**2):
                    return False
            return True

        return not named or by_bisection(box, kept, _DEPTH)

    def keeps_bounds(self, box: Box) -> bool:
        """Whether every bound that the model names is outside."""
        model, k = self.model, self.k
        at = [*self.rests, *(arb(v) for v in model.xi_star)]
        places = [*range(k), *range(model.n, len(model.z))]
        for (lo, hi), middle, place in zip(box[: 2 * k], at, places, strict=True):
            low, high = model.named_bounds[place]
            if not (middle + arb(lo) > low and middle + arb(hi) < high):
                return False
        return True

    def is_closed(self, box: Box) -> bool:
        """E > c on every side."""
        faces = (
            (*corner[:i], (end, end), *corner[i + 1 :])
            for corner in self._at_ends(box)
            for i, side in enumerate(corner[: 2 * self.k])
            for end in side
        )
        sizes = widths(box)
        return all(by_bisection(face, self._is_high, _DEPTH, sizes=sizes) for face in faces)

    def _at_ends(self, box: Box) -> list[Box]:
        """The box with θ at its ends, where M, U and R have it to the first power.

        So have E and the matrices that are to be positive: what holds at all ends holds between.
        """
        first = 2 * self.k
        sides = [
            tuple((v, v) for v in side) if s in self.affine else (side,)
            for s, side in zip(self.symbols, box[first:], strict=True)
        ]
        return [(*box[:first], *corner) for corner in product(*sides)]

    def falls_in(self, box: Box) -> bool:
        """E > c, or what has to hold below it, on cells that cover the box.

        What has to hold depends little on ξ̃, which is not cut at first.
        """

        def falls(cell: Box) -> bool:
            return any(self.is_positive(cell, n) for n in _STRETCHES)

        def settled(cell: Box) -> bool:
            return self._is_high(cell) or falls(cell)

        corners, sizes = self._at_ends(box), widths(box)
        cut = [not self.k <= i < 2 * self.k for i in range(len(box))]
        if all(by_bisection(b, falls, _DEPTH // 2, cut, sizes) for b in corners):
            return True
        return all(by_bisection(b, settled, _DEPTH, sizes=sizes) for b in corners)

    def has_mass(self, box: Box) -> bool:
        """M ≻ 0 on the whole box: where it is not, E > c says nothing of the whole energy."""
        k = self.k

        def positive_there(cell: Box) -> bool:
            e = [ball(*side) for side in cell[:k]]
            here = {s: v + d for s, v, d in zip(self.q, self.q_star, e, strict=True)}
            return positive(self.inertia(here | self.known(cell)), 0.0)

        counts = [i < k or i >= 2 * k for i in range(len(box))]  # M does not depend on ξ
        sizes = widths(box)
        return all(
            by_bisection(b, positive_there, _DEPTH, counts, sizes) for b in self._at_ends(box)
        )

    def _is_high(self, box: Box) -> bool:
        return bool(self._energy(box) > self.level)

    def _energy(self, box: Box) -> arb:
        """E over a box of (e, ξ̃, θ): value at the middle and slopes over the box."""
        middle: Box = tuple((m, m) for m in (lo / 2 + hi / 2 for lo, hi in box))
        value = self._value_and_slopes(middle)[0]
        if middle == box:
            return value
        slopes = self._value_and_slopes(box)[1]
        for (lo, hi), (m, _), slope in zip(box, middle, slopes, strict=True):
            value = value + slope * (ball(lo, hi) - arb(m))
        return value

    def _value_and_slopes(self, box: Box) -> tuple[arb, list[arb]]:
        k, (level, along) = self.k, self.rest
        known, rest_q = self.known(box), dict(zip(self.q, self.q_star, strict=True))
        U0 = evaluate(self.U, rest_q | known)
        grad0 = [evaluate(g, rest_q | known) for g in self.grad_U]
        xi_bar = self.xi_bar or []
        e = [ball(*side) for side in box[:k]]
        q = [v + s for v, s in zip(self.q_star, e, strict=True)]
        xi = [v + ball(*side) for v, side in zip(xi_bar, box[k : 2 * k], strict=True)]
        k_value, dk, _ = self.kc(_box(self._c(q, xi)))
        h_value, dh, _ = self.hc(_box(xi))
        there = dict(zip(self.q, q, strict=True)) | known
        more, steeper = self.added(there, known, e)
        of_U = evaluate(self.U, there) - U0
        for i in range(k):
            of_U = of_U - grad0[i] * e[i]
        way = {s: v.union(q[i]) for i, (s, v) in enumerate(rest_q.items())} | known
        pulls = [
            sum((times(evaluate(v, way), d) for v, d in zip(row, e, strict=True)), arb(0))
            for row in self.hess_U
        ]  # by ∇²U along the way from rest, which loses nothing where U is quadratic
        of_U = meet(of_U, sum((times(p, d) for p, d in zip(pulls, e, strict=True)), arb(0)) / 2)
        value = more + of_U + k_value + h_value - level
        slopes = []
        for i in range(k):
            value = value - along[i] * e[i]
            own = meet(evaluate(self.grad_U[i], there) - grad0[i], pulls[i])
            own = own - along[i] + steeper[i]
            slopes.append(own + sum((self.slopes[j, i] * dk[j] for j in range(k)), arb(0)))
        for i in range(k):
            pull = sum((self.slopes[j, k + i] * dk[j] for j in range(k)), arb(0))
            slopes.append(dh[i] + pull)
        for (U, grad), own in zip(self.along_theta, steeper[k:], strict=True):
            slope = evaluate(U, there) - evaluate(U, rest_q | known) + own
            for v, g in zip(e, grad, strict=True):
                slope = slope - evaluate(g, rest_q | known) * v
            slopes.append(slope)
        return value, slopes

    def added(
        self, there: dict[sp.Symbol, arb], known: dict[sp.Symbol, arb], e: list[arb]
    ) -> tuple[arb, list[arb]]:
        """What else E has, as a function of q and θ, and its slopes in these."""
        return arb(0), [arb(0)] * (self.k + len(self.symbols))

    @abstractmethod
    def is_positive(self, box: Box, stretches: int) -> bool:
        """Whether what has to hold below the level does, slopes in so many stretches."""

    def inertia(self, there: dict[sp.Symbol, arb]) -> arb_mat:
        """M at q and θ."""
        return matrix_at(self.M, there)

    def mean_slopes(self, box: Box, stretches: int) -> tuple[arb_mat, arb_mat, arb_mat]:
        """∇²U, ∇²Hc and N_ξ∇²K N_ξᵀ, averaged along straight ways from rest into the box."""
        k, xi_bar = self.k, self.xi_bar or []
        total = [arb_mat(k, k) for _ in range(3)]
        for part in range(stretches):
            share = arb(part) / stretches
            share = share.union(arb(part + 1) / stretches)
            steps = [times(share, ball(*side)) for side in box[: 2 * k]]
            q = [v + d for v, d in zip(self.q_star, steps[:k], strict=True)]
            xi = [v + d for v, d in zip(xi_bar, steps[k:], strict=True)]
            there = dict(zip(self.q, q, strict=True)) | self.known(box)
            a = arb_mat([[evaluate(v, there) for v in row] for row in self.hess_U])
            found = a, self._springs_h(xi), self._springs_k(self._c(q, xi))
            total = [old + new / stretches for old, new in zip(total, found, strict=True)]
        return total[0], total[1], total[2]


def matrix_at(matrix: sp.Matrix, values: dict[sp.Symbol, arb]) -> arb_mat:
    """A matrix of expressions at balls."""
    return arb_mat([[evaluate(sp.sympify(v), values) for v in row] for row in matrix.tolist()])


def _box(values: list[arb]) -> Box:
    return tuple(ends(v) for v in values)


def _least(A: arb_mat) -> float:
    return float(np.linalg.eigvalsh([[float(v.mid()) for v in row] for row in A.tolist()])[0])
