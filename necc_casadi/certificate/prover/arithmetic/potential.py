"""Enclosures of V = Φ(H + Hc, C) (eq. casimir_parameterization), ∇V and ∇²V over boxes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, reduce
from itertools import product

import numpy as np
import sympy as sp

from necc_casadi.arrays import Vector
from necc_casadi.certificate.prover.arithmetic.boxes import hull
from necc_casadi.certificate.prover.arithmetic.intervals import Interval, concatenate, point, stack
from necc_casadi.certificate.prover.arithmetic.jets import (
    Jet,
    chain,
    constant,
    coordinates,
    expression_jets,
)
from necc_casadi.certificate.prover.arithmetic.networks import network_jet, network_taylor, phi_jet
from necc_casadi.designs.design import Design
from necc_casadi.lyapunov.networks import Network

__all__ = ["Potential", "over_pieces", "target_enclosure"]


#: Boxes per network evaluation: arrays stay within a processor's cache.
_ROWS = 512


#: Network evaluations that one call may spend on cutting boxes, and pieces per axis at most.
_BUDGET, _PIECES = 2048, 8


#: Encloses a network over boxes of its inputs.
OverBoxes = Callable[[Network, Vector, Interval], Jet]


@dataclass(frozen=True, eq=False)
class Potential:
    """V of a design over boxes of z, or of the states that are left when others rest at 0."""

    design: Design
    resting: tuple[int, ...] = ()  # plant states that are held at 0; no Casimir depends on them
    added: sp.Expr | None = None  # to H, a function of the active states

    @cached_property
    def active(self) -> tuple[int, ...]:
        """The states that do not rest, in the order of z."""
        return tuple(i for i in range(self.design.loop.n) if i not in self.resting)

    @cached_property
    def energy(self) -> sp.Expr:
        """H with the resting states at 0, and what is added to it."""
        loop = self.design.loop
        energy = loop.plant.H.subs({loop.z[i]: 0 for i in self.resting})
        return energy if self.added is None else energy + self.added

    def jet(self, Z: Interval) -> Jet:
        """V, ∇V and ∇²V in the active states over boxes (B, active), with S = (B,)."""
        with np.errstate(all="ignore"):
            middle = Z.mid
            both = self._jet(concatenate(Z, point(middle)))
            return both[: Z.shape[0]].centred(both[Z.shape[0] :], Z - middle)

    def sharp_jet(self, Z: Interval) -> Jet:
        """V, ∇V and ∇²V over small boxes (B, active): networks by Taylor's formula, uncut."""
        with np.errstate(all="ignore"):
            return self._jet(Z, taylor=True)

    @property
    def has_sharp_jet(self) -> bool:
        """Whether Taylor's formula encloses every network, several times as fast as pieces."""
        form = self.design.form
        return form.phi is None and not form.betas and all(map(_is_shallow, (form.hc, form.k)))

    def lower_hessian(self, Z: Interval) -> Interval:
        """Matrices L with ∇²V ⪰ L' for an L' in L, tighter than ∇²V itself, (B, active, active).

        Where Φ is the sum, ∇²K and ∇²Hc are replaced by matrices below them in the order ⪰: their
        entries, which vary together, no longer count as if each varied alone.
        """
        if self.design.form.phi is not None:
            return self.jet(Z).hess
        with np.errstate(all="ignore"):
            energy, casimir = self._parts(Z, _below_pieces)
            return (energy + casimir).hess

    def slope(self, Z: Interval) -> Interval:
        """Φ₁ = ∂Φ/∂(H + Hc) over boxes (B, active), shape (B,)."""
        form, weights = self.design.form, self._weights
        if form.phi is None:
            return point(np.ones(Z.shape[0]))
        with np.errstate(all="ignore"):
            energy, casimir = self._parts(Z)
            inputs = stack([energy.value, casimir.value])
            return phi_jet(form.phi, weights[-1], inputs).grad[:, 0]

    def curvatures(self, Z: Interval) -> list[tuple[Interval, Vector]]:
        """∇²(Hc + C) = Σ LᵀAL over boxes (B, N): A in an enclosure (B, r, r), L constant (r, N).

        Where Φ is the sum; ∇²K enters once where the Casimirs are affine.
        """
        with np.errstate(all="ignore"):
            return self._curvatures(Z, over_pieces)

    def _curvatures(self, Z: Interval, over: OverBoxes) -> list[tuple[Interval, Vector]]:
        form, weights, d = self.design.form, self._weights, len(self.active)
        nc, identity = self.design.loop.controller.nc, np.eye(d)
        variables = coordinates(Z)
        _, *c = self._expressions(Z)
        inner = [_as_jet(part, variables[0]) for part in c]
        controller = _compose(form.hc, weights[0], variables[-nc:], over).hess[:, -nc:, -nc:]
        slopes = self._constant_slopes
        if form.betas or slopes is None:
            return [(controller, identity[-nc:]), (self._casimir(inner, over).hess, identity)]
        arguments = coordinates(stack([part.value for part in inner]))
        casimir = _compose(form.k, weights[1], arguments, over).hess
        return [(controller, identity[-nc:]), (casimir, slopes)]

    @cached_property
    def _constant_slopes(self) -> Vector | None:
        """∇c where it is constant and exact in doubles, (r, active)."""
        symbols = [self.design.loop.z[i] for i in self.active]
        slopes = sp.Matrix(self.design.casimirs.functions).jacobian(symbols)
        if slopes.free_symbols:
            return None
        numbers = np.array(slopes.evalf(30), float)
        exact = all(
            sp.Rational(float(v)) == s for v, s in zip(numbers.ravel(), slopes, strict=True)
        )
        return numbers if exact else None

    @property
    def _weights(self) -> list[Vector]:
        return self.design.form.split(self.design.weights)

    def _jet(self, Z: Interval, taylor: bool = False) -> Jet:
        energy, casimir = self._parts(Z, taylor_jet if taylor else over_pieces)
        phi = self.design.form.phi
        if phi is None:
            return energy + casimir
        outer = phi_jet(phi, self._weights[-1], stack([energy.value, casimir.value]))
        return chain(outer, [energy, casimir])

    def _parts(self, Z: Interval, over: OverBoxes | None = None) -> tuple[Jet, Jet]:
        """(H + Hc, C) over boxes; `over` encloses K and Hc."""
        over = over or over_pieces
        loop, form, weights = self.design.loop, self.design.form, self._weights
        variables = coordinates(Z)
        H, *c = self._expressions(Z)
        Hc = _compose(form.hc, weights[0], variables[-loop.controller.nc :], over)
        return Hc + H, self._casimir([_as_jet(part, variables[0]) for part in c], over)

    def _expressions(self, Z: Interval) -> list[Jet | Interval]:
        """H and the closed-form Casimirs over boxes, by mean-value forms about their middles."""
        functions = [self.energy, *self.design.casimirs.functions]
        symbols = [self.design.loop.z[i] for i in self.active]
        boxes, middle = Z.shape[0], Z.mid
        variables = coordinates(concatenate(Z, point(middle)))
        both = expression_jets(functions, dict(zip(symbols, variables, strict=True)))
        return [
            part[:boxes].centred(part[boxes:], Z - middle) if isinstance(part, Jet) else part
            for part in both
        ]

    def _casimir(self, c: list[Jet], over: OverBoxes) -> Jet:
        form, weights = self.design.form, self._weights
        if form.betas:
            parts = zip(form.betas, weights[2:], c, strict=False)
            c = [
                reduce(
                    lambda a, b: a + b,
                    [_compose(beta, w, [s], over_pieces) for beta, w, s in parts],
                )
            ]
        return _compose(form.k, weights[1], c, over)


def _as_jet(part: Jet | Interval, like: Jet) -> Jet:
    return part if isinstance(part, Jet) else like * 0.0 + part


def _compose(network: Network, weights: Vector, inputs: list[Jet], over: OverBoxes) -> Jet:
    """f(inputs); equal argument boxes, of which a grid has many, are evaluated once."""
    X = stack([j.value for j in inputs])
    d = X.shape[1]
    unique, inverse = np.unique(np.concatenate([X.lo, X.hi], axis=1), axis=0, return_inverse=True)
    outer = over(network, weights, Interval(unique[:, :d], unique[:, d:]))
    return chain(outer[inverse.ravel()], inputs)


def over_pieces(network: Network, weights: Vector, X: Interval) -> Jet:
    """A network over boxes (B, d), each cut into pieces as far as the budget allows."""
    boxes, d = X.shape
    wide = max(1, int((X.hi > X.lo).any(-1).sum()))
    count = int(np.clip((_BUDGET / wide) ** (1 / d), 1, _PIECES))
    edges = X.lo[:, None] + (X.hi - X.lo)[:, None] * (np.arange(count + 1) / count)[:, None]
    edges[:, -1] = X.hi
    index, axes = np.array(list(product(range(count), repeat=d))), np.arange(d)
    pieces = Interval(edges[:, index, axes], edges[:, index + 1, axes]).reshape(-1, d)
    parts = [
        network_jet(network, weights, pieces[rows])
        for rows in np.array_split(np.arange(pieces.shape[0]), -(-pieces.shape[0] // _ROWS))
    ]
    return Jet(*(hull(part, boxes) for part in vars(reduce(Jet.above, parts)).values()))


def _below_pieces(network: Network, weights: Vector, X: Interval) -> Jet:
    """The network over pieces, with a matrix below its Hessian in the place of that."""
    jet = over_pieces(network, weights, X)
    return Jet(jet.value, jet.grad, _below(jet.hess))


def taylor_jet(network: Network, weights: Vector, X: Interval) -> Jet:
    """A network over small boxes, by Taylor's formula where it has one layer of tanh."""
    if _is_shallow(network):
        return network_taylor(network, weights, X)
    return over_pieces(network, weights, X)


def _is_shallow(network: Network) -> bool:
    return len(network.hidden) == 1 and network.activation == "tanh"


def _below(hess: Interval) -> Interval:
    """Matrices that are ⪯ every symmetric matrix in the enclosures (B, d, d)."""
    middle = (hess.mid + np.swapaxes(hess.mid, -1, -2)) / 2
    radius = (hess - middle).magnitude
    bound = point(np.maximum(radius, np.swapaxes(radius, -1, -2))).sum().hi.max(-1)
    return point(middle) - point(bound)[..., None, None] * np.eye(hess.shape[-1])


def target_enclosure(design: Design) -> Interval:
    """z* = (x*, ξ*), the exact target and the exported controller state, (n + nc,)."""
    exact = [constant(sp.sympify(value)) for value in design.x_star]
    return stack([*exact, *[point(value) for value in design.xi_star]])
