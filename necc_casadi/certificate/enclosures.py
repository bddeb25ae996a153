"""Enclosures of V = Φ(H + Hc, C), ∇V and ∇²V over boxes: expressions, networks, composition."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property, reduce

import numpy as np
import sympy as sp

from necc_casadi.artifact import Design
from necc_casadi.certificate.intervals import Interval, concatenate, point, stack
from necc_casadi.certificate.jets import (
    Jet,
    Slopes,
    chain,
    constant,
    coordinates,
    expression_jets,
    sin_slopes,
    tanh_slopes,
)
from necc_casadi.networks import MonotonePhi, Network, Vector

__all__ = ["Potential", "matrix_enclosure", "target_enclosure"]


def _squareplus_slopes(v: Interval) -> tuple[Interval, Interval, Interval]:
    root = (v.square() + 4.0).sqrt()
    inverse = root.reciprocal()
    return (v + root) * 0.5, (1.0 + v * inverse) * 0.5, 2.0 * inverse.power(3)


#: Boxes per network evaluation: arrays stay within a processor's cache.
_ROWS = 512

_ACTIVATIONS: dict[str, Slopes] = {
    "tanh": tanh_slopes,
    "sin": sin_slopes,
    "squareplus": _squareplus_slopes,
}


@dataclass(frozen=True, eq=False)
class Potential:
    """V of a design over boxes of z, or of the states that are left when others rest at 0."""

    design: Design
    resting: tuple[int, ...] = ()  # plant states that are held at 0; no Casimir depends on them
    active: tuple[int, ...] = field(init=False)  # the others, in the order of z

    def __post_init__(self) -> None:
        states = range(self.design.loop.n)
        object.__setattr__(self, "active", tuple(i for i in states if i not in self.resting))

    @cached_property
    def _energy(self) -> sp.Expr:
        loop = self.design.loop
        return loop.plant.H.subs({loop.z[i]: 0 for i in self.resting})

    def jet(self, Z: Interval) -> Jet:
        """V, ∇V and ∇²V in the active states over boxes (B, active), with S = (B,)."""
        with np.errstate(all="ignore"):
            middle = Z.mid
            both = self._jet(concatenate(Z, point(middle)))
            return both[: Z.shape[0]].centred(both[Z.shape[0] :], Z - middle)

    def slope(self, Z: Interval) -> Interval:
        """Φ₁ = ∂Φ/∂(H + Hc) over boxes (B, active), shape (B,)."""
        form, weights = self.design.form, self._weights
        if form.phi is None:
            return point(np.ones(Z.shape[0]))
        with np.errstate(all="ignore"):
            energy, casimir = self._parts(Z)
            inputs = stack([energy.value, casimir.value])
            return phi_jet(form.phi, weights[-1], inputs).grad[:, 0]

    @property
    def _weights(self) -> list[Vector]:
        return self.design.form.split(self.design.weights)

    def _jet(self, Z: Interval) -> Jet:
        energy, casimir = self._parts(Z)
        phi = self.design.form.phi
        if phi is None:
            return energy + casimir
        outer = phi_jet(phi, self._weights[-1], stack([energy.value, casimir.value]))
        return chain(outer, [energy, casimir])

    def _parts(self, Z: Interval) -> tuple[Jet, Jet]:
        """(H + Hc, C) over boxes."""
        loop, form, weights = self.design.loop, self.design.form, self._weights
        variables = coordinates(Z)
        functions = [self._energy, *self.design.casimirs.functions]
        symbols = [loop.z[i] for i in self.active]
        H, *c = expression_jets(functions, dict(zip(symbols, variables, strict=True)))
        Hc = _compose(form.hc, weights[0], variables[-loop.controller.nc :])
        return Hc + H, self._casimir([_as_jet(part, variables[0]) for part in c])

    def _casimir(self, c: list[Jet]) -> Jet:
        form, weights = self.design.form, self._weights
        if form.betas:
            parts = zip(form.betas, weights[2:], c, strict=False)
            c = [reduce(lambda a, b: a + b, [_compose(beta, w, [s]) for beta, w, s in parts])]
        return _compose(form.k, weights[1], c)


def _as_jet(part: Jet | Interval, like: Jet) -> Jet:
    return part if isinstance(part, Jet) else like * 0.0 + part


def _compose(network: Network, weights: Vector, inputs: list[Jet]) -> Jet:
    """f(inputs); equal argument boxes, of which a grid has many, are evaluated once."""
    X = stack([j.value for j in inputs])
    unique, inverse = np.unique(np.concatenate([X.lo, X.hi], axis=1), axis=0, return_inverse=True)
    d = X.shape[1]
    parts = [
        network_jet(network, weights, Interval(rows[:, :d], rows[:, d:]))
        for rows in np.array_split(unique, -(-len(unique) // _ROWS))
    ]
    return chain(reduce(Jet.above, parts)[inverse.ravel()], inputs)


def network_jet(network: Network, weights: Vector, X: Interval) -> Jet:
    """A network over boxes of its own inputs (B, d), centred layer by layer."""
    layers = [(point(W), point(b)) for W, b in network.layers(weights)]
    result = _layers(layers, _ACTIVATIONS[network.activation], X)
    if network.quadratic:
        result = result + _quadratic(*network.quadratic_part(weights), X)
    return result


def _quadratic(kappa: Vector, center: Vector, X: Interval) -> Jet:
    """Σ ½ κᵢ (vᵢ − oᵢ)²."""
    offset = X - center
    hess = np.broadcast_to(np.diag(kappa), (X.shape[0], kappa.size, kappa.size))
    return Jet((offset.square() * kappa * 0.5).sum(), offset * kappa, point(hess))


def phi_jet(phi: MonotonePhi, weights: Vector, X: Interval) -> Jet:
    """Φ(e, k) over boxes (B, 2)."""
    a, b, d, f = np.split(weights, 4)
    inner = stack([point(b).exp(), point(d)])
    neurons = _layers(
        [(inner, point(f)), (point(a).exp()[None, :], point(np.zeros(1)))], tanh_slopes, X
    )
    e, k = coordinates(X)
    return neurons + (e * float(phi.delta) + k)


def _layers(layers: list[tuple[Interval, Interval]], activate: Slopes, X: Interval) -> Jet:
    """W_L σ(… σ(W_1 v + b_1) …) + b_L; mean-value forms keep deep networks from exploding."""
    middle, boxes = X.mid, X.shape[0]
    delta = X - middle
    both = _input(concatenate(X, point(middle)))
    for index, (W, b) in enumerate(layers):
        both = (both.apply(activate) if index else both).affine(W, b)
        over, at = both[:boxes], both[boxes:]
        both = over.centred(at, delta).above(at)
    return both[:boxes, 0]


def _input(X: Interval) -> Jet:
    boxes, d = X.shape
    grad = np.broadcast_to(np.eye(d), (boxes, d, d))
    return Jet(X, point(grad), point(np.zeros((boxes, d, d, d))))


def target_enclosure(design: Design) -> Interval:
    """z* = (x*, ξ*), the exact target and the exported controller state, (n + nc,)."""
    exact = [constant(sp.sympify(value)) for value in design.x_star]
    return stack([*exact, *[point(value) for value in design.xi_star]])


def matrix_enclosure(matrix: sp.Matrix, symbols: Sequence[sp.Symbol], Z: Interval) -> Interval:
    """A matrix of expressions over boxes (B, symbols), (B, rows, columns)."""
    variables = dict(zip(symbols, coordinates(Z), strict=True))
    with np.errstate(all="ignore"):
        jets = expression_jets(list(matrix), variables)
    boxes = point(np.zeros(Z.shape[0]))  # gives constant entries their shape
    entries = [boxes + (j.value if isinstance(j, Jet) else j) for j in jets]
    return stack(entries).reshape(Z.shape[0], *matrix.shape)
