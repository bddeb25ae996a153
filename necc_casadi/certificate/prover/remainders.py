"""What is left of U, Hc and K beyond first order at rest, and mean slopes from there.

With e = q − q*, ξ̃ = ξ − ξ̄, where ξ̄ is the minimum of Hc(ξ) + K(c(q*, ξ)): Ũ + K₀ + H₀ over boxes.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, reduce
from itertools import pairwise, product

import numpy as np
import sympy as sp

from necc_casadi.arrays import Truth, Vector
from necc_casadi.certificate.prover.arithmetic.boxes import matrix_enclosure
from necc_casadi.certificate.prover.arithmetic.definite import norm, positive_definite
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
from necc_casadi.certificate.prover.box import Terms, beside
from necc_casadi.designs.design import Design
from necc_casadi.model.lagrangian import Lagrangian
from necc_casadi.symbolic.derivatives import gradient, sparse_hessian
from necc_casadi.symbolic.floats import float_matrix

__all__ = ["Remainders", "exact", "transposed"]


#: Parts, a power of two, of the way from rest to a point along which slopes are averaged.
_ALONG = 8


#: Boxes around ξ* in which ξ̄ is sought; of the least eigenvalue of the Hessian.
_RADII, _MU = 2.0 ** -np.arange(2.0, 18.0), 0.5


#: Parameters of which the ends are looked at in place of their ranges.
_CORNERS = 4


class Remainders(Terms):
    """Ũ + K₀ + H₀ over boxes of (e, ξ̃, θ), (B, 2m + parameters), in natural units but for θ."""

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
        self.weights = self.design.form.split(self.design.weights)
        self.q_star = self.design.z_star[:k]
        first = plant.affine[:_CORNERS]
        self._at_ends = np.array([s in first for s in plant.ranges], bool)

    @property
    def corners(self) -> Interval:
        """Ends of θ that stand in M, U and R to the first power, the whole ranges of others.

        E and the forms that are to be positive are affine in each of these.
        """
        lo, hi, ends = self.theta.lo, self.theta.hi, self._at_ends
        sides = np.array(list(product((False, True), repeat=int(ends.sum()))), bool)
        high = np.zeros((len(sides), len(lo)), bool)
        high[:, ends] = sides
        at_end = np.where(high, hi, lo)
        return Interval(np.where(ends, at_end, lo), np.where(ends, at_end, hi))

    @property
    def _casimirs(self) -> tuple[sp.Expr, ...]:
        return self.design.casimirs.functions

    # --- where it rests -----------------------------------------------------------------------

    @cached_property
    def xi_bar(self) -> Interval | None:
        """The minimum of Hc(ξ) + K(c(q*, ξ)) in ξ, enclosed (m,)."""
        return self._minimum(np.zeros(self.k))

    def _minimum(self, off: Vector) -> Interval | None:
        """The same for every q within `off` (k,) of q*."""
        xi, k = self.design.xi_star, self.k
        z, away = np.concatenate([self.q_star, xi]), np.concatenate([off, np.zeros(self.m)])
        at = self._shape(Interval((z - away)[None], (z + away)[None]))[:, k:]
        g = float(norm(at.grad)[0])
        least = float(np.linalg.eigvalsh(at.hess.mid[0])[0])
        for radius in _RADII:
            if g < _MU * least * radius:
                reach = np.concatenate([off, np.full(self.m, radius)])
                cells = Interval(np.nextafter(z - reach, -np.inf)[None],
                                 np.nextafter(z + reach, np.inf)[None])  # fmt: skip
                hess = self._shape(cells)[:, k:].hess
                if positive_definite(hess, _MU * least)[0]:
                    near = np.nextafter(g / (_MU * least) * (1 + 1e-12), np.inf)
                    return Interval(
                        np.nextafter(xi - near, -np.inf), np.nextafter(xi + near, np.inf)
                    )
        return None

    def springs_at_rest(self, off: Vector) -> tuple[Interval, Interval] | None:
        """∇²Hc and N_ξ∇²K N_ξᵀ at rest, (m, m) each, for every q within `off` (k,) of q*."""
        xi = self._minimum(off)
        if xi is None:
            return None
        at = Interval(np.concatenate([self.q_star - off, xi.lo])[None],
                      np.concatenate([self.q_star + off, xi.hi])[None])  # fmt: skip
        h = network_jet(self.design.form.hc, self.weights[0], xi[None]).hess[0]
        c = stack([j.value for j in self._linear(coordinates(at))])
        bends = network_jet(self.design.form.k, self.weights[1], c).hess
        return h, matmul(matmul(transposed(self.Nxi), bends), self.Nxi)[0]

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
        """What of E is a closed form, of q and θ."""
        return self.remainder

    @cached_property
    def remainder(self) -> sp.Expr:
        """Ũ, of q and θ."""
        U, q, there = self.plant.U, self.plant.q, self.there
        rest = U - U.subs(there) - (gradient(U, q).subs(there).T * self.e)[0, 0]
        return sp.sympify(sp.expand(rest))  # where U is a polynomial nothing is left to cancel

    @property
    def there(self) -> dict[sp.Symbol, sp.Rational]:
        """Q at q*, the double as it is."""
        return {s: exact(float(v)) for s, v in zip(self.plant.q, self.q_star, strict=True)}

    @property
    def e(self) -> sp.Matrix:
        """Q − q*, k × 1."""
        return sp.Matrix([s - v for s, v in self.there.items()])

    # --- slopes ---------------------------------------------------------------------------------

    def inertia(self, at: Interval, e: Interval) -> tuple[Interval, Interval]:
        """M and ½Σ eᵢ ∂ᵢM over boxes of (q, θ), (B, k, k)."""
        M, symbols = sp.Matrix(self.plant.M), (*self.plant.q, *self.plant.ranges)
        parts = [
            matrix_enclosure(M.diff(s), symbols, at) * e[:, i][:, None, None] * 0.5
            for i, s in enumerate(self.plant.q)
        ]
        return matrix_enclosure(M, symbols, at), reduce(lambda a, b: a + b, parts)

    def has_mass(self, Z: Interval) -> Truth:
        """Whether M ≻ 0 on boxes (B, 2m + parameters)."""
        with np.errstate(all="ignore"):
            e, theta = Z[:, : self.k], Z[:, 2 * self.m :]
            at = beside(e + np.broadcast_to(self.q_star, e.shape), theta)
            return np.asarray(positive_definite(self.inertia(at, e)[0]))

    @property
    def leads(self) -> Interval:
        """The energy beside E(e, ξ̃) is at least ½vᵀMv with v = q̇ + e times this."""
        return point(0.0)

    def ceiling(self, Z: Interval) -> Vector:
        """E and the least ½vᵀMv with a momentum on a bound that the model names, (B,).

        (Mv)ᵢ² ≤ Mᵢᵢ vᵀMv, and the momenta M q̇ are Mv less M e times what v leads by.
        """
        plant, units, found = self.design.loop.plant, self._momentum_units, []
        with np.errstate(all="ignore"):
            e, theta = Z[:, : self.k], self._between(Z[:, 2 * self.m :])
            at = beside(e + np.broadcast_to(self.q_star, e.shape), theta)
            M = self.inertia(at, e)[0]
            ahead = matmul(M, e[..., None])[..., 0] * self.leads
            for i, name in enumerate(plant.states[self.k :]):
                if name in plant.domain:
                    lo, hi = (constant(v) * (1 / units[i]) for v in plant.domain[name])
                    room = np.minimum((hi + ahead[:, i]).lo, (-(lo + ahead[:, i])).lo)
                    room = np.where(room > 0, room, 0.0)
                    least = point(room) * point(room) * (0.5 * M[:, i, i].reciprocal())
                    found.append(least.lo)
        if not found:
            return super().ceiling(Z)
        least = np.where(np.isfinite(found), found, 0.0).min(axis=0)
        return np.asarray((self.energy(Z) + point(least)).lo, float)

    def _between(self, theta: Interval) -> Interval:
        """The whole ranges in place of ends: what is a quotient of M is not affine."""
        ends, whole = self._at_ends, self.theta
        return Interval(np.where(ends, whole.lo, theta.lo), np.where(ends, whole.hi, theta.hi))

    @cached_property
    def _momentum_units(self) -> Vector:
        """Momenta in natural units over M q̇ in such units: powers of two."""
        return np.diagonal(float_matrix(self.design.loop.plant.J[: self.k, self.k :]))

    def mean_slopes(self, Z: Interval) -> tuple[Interval, Interval, Interval]:
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
        U = matrix_enclosure(sparse_hessian(self.plant.U, self.plant.q), symbols, beside(q, theta))
        form = self.design.form
        h = network_jet(form.hc, self.weights[0], xi).hess
        parts = [*(q[:, i] for i in range(self.k)), *(xi[:, i] for i in range(self.m))]
        c = stack([j.value for j in self._linear(coordinates(stack(parts)))])
        bends = network_jet(form.k, self.weights[1], c).hess
        bends = matmul(matmul(transposed(self.Nxi), bends), self.Nxi)
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


def exact(value: float) -> sp.Rational:
    """The double as the rational that it is."""
    return sp.Rational(*value.as_integer_ratio())


def _numbers(matrix: sp.MatrixBase) -> Interval:
    """A matrix of constants."""
    empty = point(np.zeros((1, 0)))
    return matrix_enclosure(sp.Matrix(matrix), (), empty)[0]


def _mean(v: Interval, boxes: int) -> Interval:
    """Of matrices along the parts of a way, one after the other, (boxes, …)."""
    parts = v.reshape(-1, boxes, *v.shape[1:])
    return reduce(lambda a, b: a + b, [parts[i] for i in range(parts.shape[0])]) * (1.0 / _ALONG)


def transposed(v: Interval) -> Interval:
    """Matrices turned over."""
    return Interval(np.swapaxes(v.lo, -1, -2), np.swapaxes(v.hi, -1, -2))
