"""Integral action: W of docs/theory.md#integral-action falls in a box, and stays in it.

With e = q − q*, ξ̃ = ξ − ξ̄, where ξ̄ is the minimum of Hc(ξ) + K(c(q*, ξ)), and the remainders
Ũ, H₀, K₀ of U, Hc, K beyond their first order,

    W = ½(q̇ + e/τ)ᵀM(q̇ + e/τ) + E_W(e, ξ̃) + ½(ζ − ζ*)ᵀKᵢ⁻¹(ζ − ζ*)/τ,
    E_W = Ũ + K₀ + H₀ + ½eᵀ(BDBᵀ + R − M/τ)e/τ,     −Ẇ ≥ (q̇, e, ω)ᵀ S (q̇, e, ω).

On each cell of the box either E_W > c or S ≻ 0, and E_W > c on the sides of the box: a solution
that starts with W ≤ c and (e, ξ̃) in the box stays there, and e → 0 for every ζ* within the limits.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, reduce
from itertools import pairwise, product

import numpy as np
import sympy as sp

from necc_casadi.arrays import Truth, Vector
from necc_casadi.certificate.claims import statements
from necc_casadi.certificate.claims.claim import Claim
from necc_casadi.certificate.prover.arithmetic.boxes import matrix_enclosure, subdivide
from necc_casadi.certificate.prover.arithmetic.definite import norm, positive_definite, solve
from necc_casadi.certificate.prover.arithmetic.intervals import (
    Interval,
    concatenate,
    matmul,
    point,
    stack,
)
from necc_casadi.certificate.prover.arithmetic.jets import (
    Jet,
    chain,
    constant,
    coordinates,
    expression_jets,
)
from necc_casadi.certificate.prover.arithmetic.networks import network_jet
from necc_casadi.designs.design import Design
from necc_casadi.model.lagrangian import Lagrangian, Plants, integral_obstacle, lagrangian
from necc_casadi.symbolic.derivatives import gradient, sparse_hessian
from necc_casadi.symbolic.expressions import to_text

__all__ = ["IntegralProof", "prove_integral"]


#: Half widths of the box that are tried, in natural units, widest first, and those of ξ̃ over e.
_WIDTHS, _ASPECTS = 2.0 ** np.arange(2.0, -5.5, -0.5), (1.0, 0.5)


#: Points of the sides and of the inside at which a box is tried; boxes that are then proved.
_SIDE, _INSIDE, _TRIED = 60, 200, 5


#: Of the least E_W that is seen at points of the sides; there may be less between them.
_SHARES = (0.97, 0.9, 0.8, 0.65, 0.5, 0.3, 0.15)


#: First cells of the box together, cells at most, rounds of halving.
_CELLS, _MOST_CELLS, _ROUNDS = 256, 60_000, 20


#: Of the level that is proved: what is claimed, so that other arithmetic can confirm it.
_CLAIMED = 0.98


#: Parts, a power of two, of the way from rest to a point along which slopes are averaged.
_ALONG = 8


#: Cells at once.
_BATCH = 1024


#: Of E_W on boxes, and the boxes.
_Test = Callable[[Interval, Interval], Truth]


#: Parameters of which all ends are tried together.
_CORNERS = 4


#: Boxes around ξ* in which ξ̄ is sought; of the least eigenvalue of the Hessian.
_RADII, _MU = 2.0 ** -np.arange(2.0, 18.0), 0.5


@dataclass(frozen=True, eq=False)
class IntegralProof:
    """A box of (e, ξ̃) and a level of W, in natural units."""

    half_widths: Vector  # (2m,)
    level: float


def prove_integral(design: Design, plants: Plants | None = None) -> Claim | None:
    """That the target is held without offset; None where the design has no integral action.

    With `plants` for every value of their parameters.
    """
    if design.integral is None:
        return None
    loop, functions = design.loop, design.casimirs.functions
    obstacle = integral_obstacle(loop, functions, design.form.phi is None)
    if obstacle is not None or design.form.betas or not _is_uncoupled(design):
        return Claim("integral", False, statements.INTEGRAL_IS_NOT_COVERED)
    plant = lagrangian(loop, design.units, plants)
    if plant is None:
        return Claim("integral", False, statements.INTEGRAL_IS_NOT_COVERED)
    terms = _Terms(design, plant)
    found = None if terms.xi_bar is None else _searched(terms)
    if found is None:
        return Claim("integral", False, statements.NO_INTEGRAL)
    level = found.level * design.units.energy
    ranges = {str(s): tuple(map(to_text, side)) for s, side in plant.ranges.items()}
    data = {
        "level": found.level,
        "half_widths": [float(v) for v in found.half_widths],
        **({"uncertain": {name: list(side) for name, side in ranges.items()}} if ranges else {}),
    }
    kept = [*range(terms.k), *range(loop.plant.n, loop.n)]
    box = {
        loop.states[i]: float(width * design.units.state[i])
        for i, width in zip(kept, found.half_widths, strict=True)
    }
    text = statements.integral(level, box, [float(v) for v in design.integral.limit], ranges)
    return Claim("integral", True, text, data)


def _is_uncoupled(design: Design) -> bool:
    """Whether 𝒟 = diag(D, Dc), both symmetric."""
    m, damping = design.loop.plant.m, design.damping
    coupled = np.any(damping[:m, m:]) or np.any(damping[m:, :m])
    return not coupled and bool(np.array_equal(damping, damping.T))


class _Terms:
    """E_W and S over boxes of (e, ξ̃, θ), (B, 2m + parameters), in natural units but for θ."""

    def __init__(self, design: Design, plant: Lagrangian) -> None:
        self.design, self.plant = design.natural, plant
        loop, k = self.design.loop, len(self.plant.q)
        self.k, self.m = k, loop.plant.m
        slopes = sp.Matrix([[sp.diff(c, s) for s in loop.z] for c in self._casimirs])
        self.Nx, self.Nxi = _numbers(slopes[:, :k]), _numbers(slopes[:, loop.plant.n :])
        self.B, self.Gc = _numbers(self.plant.B), _numbers(loop.controller.Gc)
        m = self.m
        ends = [tuple(map(constant, side)) for side in plant.ranges.values()]
        low, high = np.array([a.lo for a, _ in ends]), np.array([b.hi for _, b in ends])
        self.theta = Interval(low, high)  # the ranges, rounded outwards
        self.D, self.Dc = (point(self.design.damping[s, s]) for s in (slice(m), slice(m, None)))
        self.tau = _tau(self.design)
        self.weights = self.design.form.split(self.design.weights)
        self.q_star = self.design.z_star[:k]

    @property
    def _casimirs(self) -> tuple[sp.Expr, ...]:
        return self.design.casimirs.functions

    # --- where it rests -----------------------------------------------------------------------

    @cached_property
    def xi_bar(self) -> Interval | None:
        """The minimum of Hc(ξ) + K(c(q*, ξ)) in ξ, enclosed (m,)."""
        xi = self.design.xi_star
        at = self._shape(point(np.concatenate([self.q_star, xi])[None]))[:, self.k :]
        g = float(norm(at.grad)[0])
        least = float(np.linalg.eigvalsh(at.hess.mid[0])[0])
        for radius in _RADII:
            if g < _MU * least * radius:
                box = np.concatenate([self.q_star, xi])
                reach = np.concatenate([np.zeros(self.k), np.full(self.m, radius)])
                cells = Interval(np.nextafter(box - reach, -np.inf)[None],
                                 np.nextafter(box + reach, np.inf)[None])  # fmt: skip
                hess = self._shape(cells)[:, self.k :].hess
                if positive_definite(hess, _MU * least)[0]:
                    away = np.nextafter(g / (_MU * least) * (1 + 1e-12), np.inf)
                    return Interval(
                        np.nextafter(xi - away, -np.inf), np.nextafter(xi + away, np.inf)
                    )
        return None

    def _shape(self, Z: Interval) -> _Parts:
        """Hc(ξ) + K(c(q, ξ)) over boxes of (q, ξ)."""
        variables = coordinates(Z)
        c = self._linear(variables)
        return _Parts(self._hc(variables[self.k :]) + self._kc(c))

    def _linear(self, variables: list[Jet]) -> list[Jet]:
        """The Casimirs as they stand, constants included, over boxes of (q, ξ)."""
        symbols = (*self.plant.q, *self.design.loop.controller.xi)
        jets = expression_jets(list(self._casimirs), dict(zip(symbols, variables, strict=True)))
        return [j if isinstance(j, Jet) else variables[0] * 0.0 + j for j in jets]

    def _hc(self, xi: list[Jet]) -> Jet:
        X = stack([j.value for j in xi])
        return chain(network_jet(self.design.form.hc, self.weights[0], X), xi)

    def _kc(self, c: list[Jet]) -> Jet:
        X = stack([j.value for j in c])
        return chain(network_jet(self.design.form.k, self.weights[1], X), c)

    # --- E_W ------------------------------------------------------------------------------------

    def energy(self, Z: Interval) -> Interval:
        """E_W over boxes (B, 2m), by mean-value forms about their middles."""
        with np.errstate(all="ignore"):
            middle = Z.mid
            both = self._energy(concatenate(Z, point(middle)))
            boxes = Z.shape[0]
            return both[:boxes].centred(both[boxes:], Z - middle).value

    def _energy(self, Z: Interval) -> Jet:
        variables = coordinates(Z)
        if self.xi_bar is None:
            raise ValueError("ξ̄ is not enclosed")
        e, xi = variables[: self.k], variables[self.k : 2 * self.m]
        shifted = [*(v + float(q) for v, q in zip(e, self.q_star, strict=True)),
                   *(v + self.xi_bar[i] for i, v in enumerate(xi))]  # fmt: skip
        c = self._linear(shifted)
        total = self._hc(shifted[self.k :]) + self._kc(c)
        rest = self._at_rest
        for i, v in enumerate(variables[: 2 * self.m]):
            total = total + v * (-rest.grad[0, i])
        total = total + (-rest.value[0])
        known = (*shifted[: self.k], *variables[2 * self.m :])
        symbols = dict(zip((*self.plant.q, *self.plant.ranges), known, strict=True))
        (own,) = expression_jets([self._closed], symbols)
        return total + own

    @cached_property
    def _at_rest(self) -> Jet:
        """Hc + K and its slopes at (q*, ξ̄); that in ξ is 0 there."""
        xi = self.xi_bar
        if xi is None:
            raise ValueError("ξ̄ is not enclosed")
        low, high = (np.concatenate([self.q_star, v])[None] for v in (xi.lo, xi.hi))
        found = self._shape(Interval(low, high)).jet
        lo, hi = found.grad.lo.copy(), found.grad.hi.copy()
        lo[:, self.k :], hi[:, self.k :] = 0.0, 0.0
        return Jet(found.value, Interval(lo, hi), found.hess)

    @cached_property
    def _closed(self) -> sp.Expr:
        """Ũ + ½eᵀ(BDBᵀ + R − M/τ)e/τ, of q and θ."""
        q, M = self.plant.q, sp.Matrix(self.plant.M)
        star = [_exact(float(v)) for v in self.q_star]
        e = sp.Matrix([s - v for s, v in zip(q, star, strict=True)])
        there = dict(zip(q, star, strict=True))
        slope = gradient(self.plant.U, q).subs(there)
        tau = _exact(self.design_tau)
        D = sp.Matrix(self.m, self.m, lambda i, j: _exact(float(self.design.damping[i, j])))
        B = sp.Matrix(self.plant.B)
        stiff = B * D * B.T + sp.Matrix(self.plant.R) - M / tau
        remainder = self.plant.U - self.plant.U.subs(there) - (sp.Matrix(slope).T * e)[0, 0]
        return sp.sympify(remainder + (e.T * stiff * e)[0, 0] / (2 * tau))

    @property
    def design_tau(self) -> float:
        """τ in natural units."""
        if self.design.integral is None:
            raise ValueError("no integral action")
        return float(self.design.integral.tau)

    # --- S --------------------------------------------------------------------------------------

    def falls(self, Z: Interval) -> Truth:
        """Whether S ≻ 0 and M ≻ 0 on boxes (B, 2m + parameters)."""
        with np.errstate(all="ignore"):
            e, theta = Z[:, : self.k], Z[:, 2 * self.m :]
            at = _beside(e + np.broadcast_to(self.q_star, e.shape), theta)
            inertia = self._inertia(at, e)[0]
            return np.asarray(positive_definite(self._form(Z)) & positive_definite(inertia))

    def _form(self, Z: Interval) -> Interval:
        """S over boxes, (B, 3m, 3m), in (q̇, e, ω) with ω = ∇H₀ − ∇K₀."""
        k, inverse = self.k, 1.0 / self.tau
        e = Z[:, :k]
        theta = Z[:, 2 * self.m :]
        M, bent = self._inertia(_beside(e + np.broadcast_to(self.q_star, e.shape), theta), e)
        U, h, bends = self._mean_slopes(Z)
        series, share = _in_series(h, bends)
        BGc = matmul(self.B, _transposed(self.Gc))
        R = matrix_enclosure(self.plant.R, tuple(self.plant.ranges), theta)
        damped = matmul(matmul(self.B, self.D), _transposed(self.B)) + R
        S_vv = damped - (M + bent) * inverse
        S_ee = (U + matmul(matmul(BGc, series), _transposed(BGc))) * inverse
        S_ew = matmul(BGc, share) * (0.5 * inverse)
        S_ww = matmul(matmul(self.Gc, self.Dc), _transposed(self.Gc))
        return _blocks(S_vv, S_ee, S_ew, S_ww, Z.shape[0])

    def _inertia(self, at: Interval, e: Interval) -> tuple[Interval, Interval]:
        """M and ½Σ eᵢ ∂ᵢM over boxes of (q, θ), (B, k, k)."""
        M, symbols = sp.Matrix(self.plant.M), (*self.plant.q, *self.plant.ranges)
        parts = [
            matrix_enclosure(M.diff(s), symbols, at) * e[:, i][:, None, None] * 0.5
            for i, s in enumerate(self.plant.q)
        ]
        return matrix_enclosure(M, symbols, at), reduce(lambda a, b: a + b, parts)

    def _mean_slopes(self, Z: Interval) -> tuple[Interval, Interval, Interval]:
        """∇²U, ∇²Hc and N_ξ∇²K N_ξᵀ, averaged from rest to any point of boxes, (B, m, m) each.

        The way is cut: along each part of it the boxes shrink with their distance from rest.
        """
        if self.xi_bar is None:
            raise ValueError("ξ̄ is not enclosed")
        edges = np.arange(_ALONG + 1) / _ALONG
        inner, theta = Z[:, : 2 * self.m], Z[:, 2 * self.m :]
        ways = [inner * Interval(np.array(a), np.array(b)) for a, b in pairwise(edges)]
        way = reduce(concatenate, ways)
        theta = reduce(concatenate, [theta] * _ALONG)
        q = way[:, : self.k] + np.broadcast_to(self.q_star, (way.shape[0], self.k))
        xi = way[:, self.k :] + self.xi_bar
        symbols = (*self.plant.q, *self.plant.ranges)
        U = matrix_enclosure(sparse_hessian(self.plant.U, self.plant.q), symbols, _beside(q, theta))
        form = self.design.form
        h = network_jet(form.hc, self.weights[0], xi).hess
        parts = [*(q[:, i] for i in range(self.k)), *(xi[:, i] for i in range(self.m))]
        c = stack([j.value for j in self._linear(coordinates(stack(parts)))])
        bends = network_jet(form.k, self.weights[1], c).hess
        bends = matmul(matmul(_transposed(self.Nxi), bends), self.Nxi)
        mean_U, mean_h, mean_bends = (_mean(v, Z.shape[0]) for v in (U, h, bends))
        return mean_U, mean_h, mean_bends


@dataclass(frozen=True, eq=False)
class _Parts:
    """A jet of which some variables are looked at."""

    jet: Jet

    def __getitem__(self, key: tuple[slice, slice]) -> Jet:
        rows, kept = key
        grad, hess = self.jet.grad[rows][:, kept], self.jet.hess[rows][:, kept, kept]
        return Jet(self.jet.value[rows], grad, hess)


def _beside(a: Interval, b: Interval) -> Interval:
    """Columns of both."""
    lo, hi = (np.concatenate(sides, axis=1) for sides in ((a.lo, b.lo), (a.hi, b.hi)))
    return Interval(lo, hi)


def _exact(value: float) -> sp.Rational:
    return sp.Rational(*value.as_integer_ratio())


def _tau(design: Design) -> Interval:
    if design.integral is None:
        raise ValueError("no integral action")
    return point(float(design.integral.tau))


def _numbers(matrix: sp.MatrixBase) -> Interval:
    """A matrix of constants."""
    empty = point(np.zeros((1, 0)))
    return matrix_enclosure(sp.Matrix(matrix), (), empty)[0]


def _mean(v: Interval, boxes: int) -> Interval:
    """Of matrices along the parts of a way, one after the other, (boxes, …)."""
    parts = v.reshape(-1, boxes, *v.shape[1:])
    return reduce(lambda a, b: a + b, [parts[i] for i in range(parts.shape[0])]) * (1.0 / _ALONG)


def _transposed(v: Interval) -> Interval:
    return Interval(np.swapaxes(v.lo, -1, -2), np.swapaxes(v.hi, -1, -2))


def _in_series(h: Interval, k: Interval) -> tuple[Interval, Interval]:
    """h(h + k)⁻¹k, which is symmetric, and h(h + k)⁻¹; (B, m, m) each."""
    if h.shape[-1] == 1:
        share = (1.0 + k * h.reciprocal()).reciprocal()
        series = (h.reciprocal() + k.reciprocal()).reciprocal()
        positive = (h.lo > 0) & (k.lo > 0)
        bad = np.where(positive, 0.0, np.nan)
        return series + bad, share + bad
    other = solve(h + k, h)  # (h + k)⁻¹h
    return (h - matmul(h, other)).meet(matmul(k, other)), _transposed(other)


def _blocks(vv: Interval, ee: Interval, ew: Interval, ww: Interval, boxes: int) -> Interval:
    m = vv.shape[-1]
    lo, hi = np.zeros((boxes, 3 * m, 3 * m)), np.zeros((boxes, 3 * m, 3 * m))
    first, second, third = slice(m), slice(m, 2 * m), slice(2 * m, None)
    for rows, columns, block in (
        (first, first, vv), (second, second, ee), (third, third, ww),
        (second, third, ew), (third, second, _transposed(ew)),
    ):  # fmt: skip
        lo[:, rows, columns], hi[:, rows, columns] = block.lo, block.hi
    return Interval(lo, hi)


# --- the box ------------------------------------------------------------------------------------


def _searched(terms: _Terms) -> IntegralProof | None:
    """The first box that is proved, below the level of points and then lower."""
    boxes = _promising(terms)[:_TRIED]
    for share, (_, half, level) in product(_SHARES, boxes):
        if _is_proved(terms, half, share * level):
            return IntegralProof(half, _CLAIMED * share * level)
    return None


def _promising(terms: _Terms) -> list[tuple[float, Vector, float]]:
    """Boxes in which S ≻ 0 is seen where E_W is below its least on the sides, best first."""
    d, rng = 2 * terms.m, np.random.default_rng(0)
    inside = np.vstack([np.zeros(d), rng.uniform(-1, 1, (_INSIDE, d))])
    sides = rng.uniform(-1, 1, (_SIDE * d, d))
    rows = np.arange(len(sides))
    sides[rows, rows % d] = np.where(rows // d % 2, 1.0, -1.0)
    corners = np.array(list(product((-1.0, 0.0, 1.0), repeat=d)))
    sides = np.concatenate([sides, corners[np.abs(corners).max(axis=1) == 1]])
    inside, sides = (_with_parameters(terms, points) for points in (inside, sides))
    found = []
    for width, aspect in product(_WIDTHS, _ASPECTS):
        half = np.concatenate([np.full(terms.m, width), np.full(terms.m, width * aspect)])
        scale = np.concatenate([half, np.ones(len(terms.theta.lo))])
        if not _is_within(terms, half):
            continue
        least = float(terms.energy(point(sides * scale)).lo.min())
        if not (np.isfinite(least) and least > 0):
            continue
        level, Z = least, inside * scale
        below = terms.energy(point(Z)).lo <= level
        if np.all(terms.falls(point(Z[below]))):
            found.append((level * float(below.mean() * half.prod()), half, level))
    return sorted(found, key=lambda entry: -entry[0])


def _with_parameters(terms: _Terms, points: Vector) -> Vector:
    """Each point with θ in the middle of its ranges, at a corner or anywhere in them."""
    lo, hi = terms.theta.lo, terms.theta.hi
    if not lo.size:
        return points
    shares = [*product((0.0, 1.0), repeat=min(len(lo), _CORNERS)), *[()] * 2]
    rng, found = np.random.default_rng(2), []
    for share in shares:
        place = rng.uniform(size=(len(points), len(lo)))
        place[:, : len(share)] = share
        found.append(np.hstack([points, lo + (hi - lo) * place]))
    return np.concatenate(found)


def _is_within(terms: _Terms, half: Vector) -> bool:
    """Whether the box keeps the bounds that the model names."""
    loop, k = terms.design.loop, terms.k
    middle = np.concatenate([terms.q_star, terms.design.xi_star])
    names = (*loop.plant.states[:k], *loop.controller.states)
    for name, at, reach in zip(names, middle, half, strict=True):
        if name in loop.plant.domain:
            lo, hi = (float(v) for v in loop.plant.domain[name])
            if not (lo < at - reach and at + reach < hi):
                return False
    return True


def _is_proved(terms: _Terms, half: Vector, level: float) -> bool:
    d, box = len(half), Interval(-half, half)
    size = np.concatenate([half, np.maximum(terms.theta.rad, np.finfo(float).tiny)])
    parts = max(2, round(_CELLS ** (1 / d)))
    for axis, side in product(range(d), (-1.0, 1.0)):
        lo, hi = -half.copy(), half.copy()
        lo[axis] = hi[axis] = side * half[axis]
        kept = [i for i in range(d) if i != axis]
        cut = subdivide(Interval(lo[kept], hi[kept]), parts)
        face = [cut[:, kept.index(i)] if i != axis else point(np.full(cut.shape[0], lo[axis]))
                for i in range(d)]  # fmt: skip
        if not _holds_on(terms, _over_all(terms, stack(face)), size, lambda E, _: E.lo > level):
            return False
    cells = _over_all(terms, subdivide(box, parts))
    return _holds_on(terms, cells, size, lambda E, Z: _settled(terms, E, Z, level))


def _over_all(terms: _Terms, Z: Interval) -> Interval:
    """Boxes of (e, ξ̃) with all θ."""
    shape = (Z.shape[0], len(terms.theta.lo))
    theta = Interval(np.broadcast_to(terms.theta.lo, shape), np.broadcast_to(terms.theta.hi, shape))
    return _beside(Z, theta)


def _settled(terms: _Terms, E: Interval, Z: Interval, level: float) -> Truth:
    """E_W > c or S ≻ 0."""
    high: Truth = np.asarray(E.lo > level)
    result = high.copy()
    if not high.all():
        result[~high] = terms.falls(Z[~high])
    return result


def _holds_on(terms: _Terms, Z: Interval, half: Vector, test: _Test) -> bool:
    """Whether a test holds on every cell; cells are halved where it does not, but at the middle."""
    for _ in range(_ROUNDS):
        if Z.shape[0] > _MOST_CELLS:
            return False
        left = Z[~_tested(terms, Z, test)]
        if left.shape[0] == 0:
            return True
        if not _tested(terms, point(left.mid), test).all():
            return False
        Z = _halved(left, half)
    return False


def _tested(terms: _Terms, Z: Interval, test: _Test) -> Truth:
    parts = np.array_split(np.arange(Z.shape[0]), -(-Z.shape[0] // _BATCH))
    return np.concatenate([test(terms.energy(Z[rows]), Z[rows]) for rows in parts])


def _halved(Z: Interval, half: Vector) -> Interval:
    axis = ((Z.hi - Z.lo) / half).argmax(axis=1)
    rows, middle = np.arange(Z.shape[0]), Z.mid
    upper, lower = Z.lo.copy(), Z.hi.copy()
    cut = middle[rows, axis]
    lower[rows, axis], upper[rows, axis] = cut, cut
    return concatenate(Interval(Z.lo, lower), Interval(upper, Z.hi))
