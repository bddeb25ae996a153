"""Form: the networks of V and where their weights stand (eq. casimir_parameterization)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import TypeVar

import casadi as ca
import numpy as np

from necc_casadi.arrays import Vector
from necc_casadi.lyapunov.networks import MonotonePhi, Network

__all__ = ["Form", "Scalar"]


Scalar = Callable[[ca.MX], ca.MX]


_Weights = TypeVar("_Weights", ca.DM, ca.MX)


_Split = TypeVar("_Split", Vector, ca.DM, ca.MX)


@dataclass(frozen=True)
class Form:
    """Which networks V is made of; the weight vector holds them in this order."""

    hc: Network  # Hc: ℝⁿᶜ → ℝ
    k: Network  # K: ℝ → ℝ (sum form) or ℝʳ → ℝ (joint form)
    betas: tuple[Network, ...] = ()  # β₁ … β_r of the sum form; none: β is the identity
    phi: MonotonePhi | None = None  # None: Φ = H + Hc + C

    @property
    def networks(self) -> tuple[Network | MonotonePhi, ...]:
        """All networks, in the order of the weight vector."""
        return (self.hc, self.k, *self.betas, *(() if self.phi is None else (self.phi,)))

    @property
    def size(self) -> int:
        """Number of weights of all networks."""
        return sum(network.size for network in self.networks)

    def split(self, weights: _Split) -> list[_Split]:
        """The weight vectors of :attr:`networks`."""
        ends = np.cumsum([0, *[network.size for network in self.networks]])
        return [weights[a:b] for a, b in pairwise(ends)]

    def initial(self, rng: np.random.Generator) -> Vector:
        """Random weights for all networks, (size,)."""
        return np.concatenate([network.initial(rng) for network in self.networks])

    def controller_energy(self, weights: _Weights) -> Scalar:
        """ξ ↦ Hc(ξ)."""
        theta = self.split(weights)[0]
        return lambda xi: self.hc(theta, xi)

    def casimir(self, weights: _Weights) -> Scalar:
        """(c₁, …, c_r) ↦ C, in the sum or the joint form."""
        _, theta_k, *rest = self.split(weights)
        if not self.betas:
            return lambda c: self.k(theta_k, c)
        return lambda c: self.k(
            theta_k,
            sum((beta(rest[i], c[i]) for i, beta in enumerate(self.betas)), ca.MX(0)),
        )

    def outer(self, weights: _Weights) -> Callable[[ca.MX, ca.MX], ca.MX]:
        """(e, C) ↦ Φ(e, C)."""
        phi = self.phi
        if phi is None:
            return lambda energy, casimir: energy + casimir
        theta = self.split(weights)[-1]
        return lambda energy, casimir: phi(theta, ca.vertcat(energy, casimir))
