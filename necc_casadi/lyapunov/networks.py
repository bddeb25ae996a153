"""Neural networks as pure functions of (weights, input), in CasADi MX.

A network is data: its shape here, its weights in one flat vector. The value is

    f(v) = W_L σ(… σ(W_1 v + b_1) …) + b_L   [+ Σ ½ κᵢ (vᵢ − oᵢ)²  if `quadratic`]

with σ element-wise. Weight layout: W_1 (row by row), b_1, …, W_L, b_L, then κ, o.

References
----------
Barron (2021), squareplus.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise
from typing import TypeVar

import casadi as ca
import numpy as np

from necc_casadi.arrays import Vector
from necc_casadi.cases import Activation

__all__ = ["ACTIVATIONS", "KAPPA_MIN", "MonotonePhi", "Network"]


#: Weights that are known, or to be found.
_Weights = TypeVar("_Weights", ca.DM, ca.MX)


#: Least curvature of a quadratic part, in units of energy/length².
KAPPA_MIN = 0.05


#: Output layers start this much smaller beside a quadratic part.
_SMALL_OUTPUT = 0.1


#: Cost of a change in a hidden layer relative to the output layer, in which V is linear: hidden
#: layers nearly keep their random features, and the Gauss–Newton Hessian is accurate.
_HIDDEN_COST = 1000.0


#: Cost of moving the centre of a quadratic part: weak, its place is free.
_CENTER_COST = 1e-2


def _squareplus(v: ca.MX) -> ca.MX:
    return (v + ca.sqrt(v * v + 4)) / 2


#: Smooth activations, element-wise. squareplus: Barron (2021), a convex, smooth ReLU.
ACTIVATIONS: dict[Activation, Callable[[ca.MX], ca.MX]] = {
    "tanh": ca.tanh,
    "sin": ca.sin,
    "squareplus": _squareplus,
}


@dataclass(frozen=True)
class Network:
    """A multilayer perceptron ℝᵈ → ℝ, with an optional positive quadratic part."""

    inputs: int  # d
    hidden: tuple[int, ...]  # widths of the hidden layers
    activation: Activation = "tanh"
    quadratic: bool = False  # adds Σ ½ κᵢ (vᵢ − oᵢ)² with κ > 0

    @property
    def shapes(self) -> list[tuple[int, int]]:
        """(rows, columns) of W_1 … W_L."""
        widths = (self.inputs, *self.hidden, 1)
        return [(rows, columns) for columns, rows in pairwise(widths)]

    @property
    def size(self) -> int:
        """Number of weights, κ and o included."""
        layers = sum(rows * columns + rows for rows, columns in self.shapes)
        return layers + (2 * self.inputs if self.quadratic else 0)

    def layers(self, weights: Vector) -> list[tuple[Vector, Vector]]:
        """[(W_1, b_1), …, (W_L, b_L)] of a numeric weight vector."""
        result, at = [], 0
        for rows, columns in self.shapes:
            W = weights[at : at + rows * columns].reshape(rows, columns)
            at += rows * columns
            result.append((W, weights[at : at + rows]))
            at += rows
        return result

    def quadratic_part(self, weights: Vector) -> tuple[Vector, Vector]:
        """(κ, o) of a numeric weight vector, each of length d; empty without a quadratic part."""
        d = self.inputs if self.quadratic else 0
        tail = weights[self.size - 2 * d :]
        return tail[:d], tail[d:]

    def initial(self, rng: np.random.Generator) -> Vector:
        """Random weights, uniform with variance 1/(3 fan-in) (LeCun 1998); κ = 1, o = 0.

        Beside a quadratic part the output layer starts small, so that the quadratic leads.
        """
        parts = []
        for index, (rows, columns) in enumerate(self.shapes):
            last = index == len(self.hidden)
            bound = columns**-0.5 * (_SMALL_OUTPUT if last and self.quadratic else 1.0)
            parts.append(rng.uniform(-bound, bound, rows * columns + rows))
        if self.quadratic:
            parts.append(np.concatenate([np.ones(self.inputs), np.zeros(self.inputs)]))
        return np.concatenate(parts)

    def units(self, length: Vector, energy: float) -> tuple[Vector, Vector]:
        """(σ, τ) with f = energy·f̂(v/length) when weights = σ∘ŵ + τ and ŵ are those of f̂."""
        parts = []
        for index, (rows, columns) in enumerate(self.shapes):
            gain = energy if index == len(self.hidden) else 1.0
            W = np.full((rows, columns), gain) / (length if index == 0 else 1.0)
            parts += [W.ravel(), np.full(rows, gain)]
        if self.quadratic:
            parts += [energy / length**2, length]
        sigma = np.concatenate(parts)
        return sigma, np.zeros(sigma.size)

    @property
    def cost(self) -> Vector:
        """Relative cost of changing each weight in training: hidden layers are stiff."""
        parts = []
        for index, (rows, columns) in enumerate(self.shapes):
            hidden = index < len(self.hidden)
            parts.append(np.full(rows * columns + rows, _HIDDEN_COST if hidden else 1.0))
        if self.quadratic:
            parts += [np.ones(self.inputs), np.full(self.inputs, _CENTER_COST)]
        return np.concatenate(parts)

    def lower(self, kappa: float) -> Vector:
        """Lower bounds of the weights of f̂: κ stays above `kappa` > 0."""
        lower = np.full(self.size, -np.inf)
        if self.quadratic:
            lower[-2 * self.inputs : -self.inputs] = kappa
        return lower

    def __call__(self, weights: _Weights, v: ca.MX) -> ca.MX:
        """f(v), scalar, for `weights` (size,) and `v` (d,)."""
        activate = ACTIVATIONS[self.activation]
        at, value = 0, v
        for index, (rows, columns) in enumerate(self.shapes):
            W = ca.reshape(weights[at : at + rows * columns], columns, rows).T
            at += rows * columns
            value = W @ value + weights[at : at + rows]
            at += rows
            if index < len(self.hidden):
                value = activate(value)
        if self.quadratic:
            d = self.inputs
            kappa, center = weights[at : at + d], weights[at + d :]
            value = value + ca.dot(kappa, (v - center) ** 2) / 2
        return value


@dataclass(frozen=True)
class MonotonePhi:
    """A neural Φ(e, k) with Φ₁ ≥ δ > 0 by construction.

    Φ(e, k) = δ e + k + Σⱼ exp(aⱼ) tanh(exp(bⱼ) e + dⱼ k + fⱼ): every weight on the way from e is
    an exponential and tanh increases, so ∂Φ/∂e ≥ δ everywhere. Weight layout: a, b, d, f.
    """

    hidden: int = 8
    delta: float = 0.5
    inputs: int = field(default=2, init=False)

    @property
    def size(self) -> int:
        """Number of weights."""
        return 4 * self.hidden

    def initial(self, rng: np.random.Generator) -> Vector:
        """Random weights with exp(a) near 1/hidden, so that Φ starts close to δ e + k."""
        h = self.hidden
        a = rng.uniform(-0.1, 0.1, h) - np.log(h)
        return np.concatenate([a, rng.uniform(-1, 0, h), rng.uniform(-0.5, 0.5, 2 * h)])

    def units(self, length: Vector, energy: float) -> tuple[Vector, Vector]:
        """(σ, τ) with Φ = energy·Φ̂(v/energy) when weights = σ∘ŵ + τ; `length` is not used."""
        h = self.hidden
        sigma, tau = np.ones(4 * h), np.zeros(4 * h)
        tau[:h], tau[h : 2 * h] = np.log(energy), -np.log(energy)
        sigma[2 * h : 3 * h] = 1 / energy
        return sigma, tau

    @property
    def cost(self) -> Vector:
        """Relative cost of changing each weight in training."""
        return np.repeat([1.0, _HIDDEN_COST, _HIDDEN_COST, _HIDDEN_COST], self.hidden)

    def lower(self, kappa: float) -> Vector:
        """Lower bounds of the weights: none."""
        return np.full(self.size, -np.inf)

    def __call__(self, weights: _Weights, v: ca.MX) -> ca.MX:
        """Φ(v[0], v[1]), scalar."""
        a, b, d, f = ca.vertsplit(weights, self.hidden)
        neurons = ca.tanh(ca.exp(b) * v[0] + d * v[1] + f)
        return self.delta * v[0] + v[1] + ca.dot(ca.exp(a), neurons)
