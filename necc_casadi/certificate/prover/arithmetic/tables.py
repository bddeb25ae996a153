"""Networks of one input over many intervals: enclosures on a grid, joined by range queries."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from necc_casadi.arrays import Vector
from necc_casadi.certificate.prover.arithmetic.intervals import Interval
from necc_casadi.certificate.prover.arithmetic.jets import Jet
from necc_casadi.certificate.prover.arithmetic.networks import network_jet
from necc_casadi.certificate.prover.arithmetic.potential import OverBoxes, Potential, over_pieces
from necc_casadi.lyapunov.networks import Network

__all__ = ["TabledPotential"]


#: Intervals of a grid at most, and of the widest interval that was asked for.
_MOST, _PARTS = 2**16, 512


@dataclass(frozen=True, eq=False)
class TabledPotential(Potential):
    """V whose networks of one input are looked up where intervals are wide."""

    @cached_property
    def _tables(self) -> _Tables:
        return _Tables()

    def _parts(self, Z: Interval, over: OverBoxes | None = None) -> tuple[Jet, Jet]:
        return super()._parts(Z, self._tables if over in (None, over_pieces) else over)

    def _curvatures(self, Z: Interval, over: OverBoxes) -> list[tuple[Interval, Vector]]:
        return super()._curvatures(Z, self._tables if over is over_pieces else over)


@dataclass(eq=False)
class _Tables:
    """A table for each network, made when it is first asked for."""

    known: dict[tuple[Network, bytes], _Table] = field(default_factory=dict)

    def __call__(self, network: Network, weights: Vector, X: Interval) -> Jet:
        """The network over intervals (B, 1)."""
        if network.inputs != 1 or not np.isfinite(X.lo + X.hi).all():
            return over_pieces(network, weights, X)
        key = (network, weights.tobytes())
        if key not in self.known or not self.known[key].holds(X):
            if (X.hi == X.lo).all():
                return network_jet(network, weights, X)
            self.known[key] = _Table(network, weights, X)
        return self.known[key](X)


class _Table:
    """Enclosures of f, f′ and f″ on a grid of intervals, and of joins of 2ᵏ neighbours."""

    def __init__(self, network: Network, weights: Vector, X: Interval) -> None:
        self.network, self.weights = network, weights
        lo, hi = float(X.lo.min()), float(X.hi.max())
        lo, hi = lo - (hi - lo) / 2, hi + (hi - lo) / 2
        widest = float((X.hi - X.lo).max())
        self.step = 2.0 ** np.floor(np.log2(max(widest / _PARTS, 2 * (hi - lo) / _MOST)))
        self.first = np.floor(lo / self.step)
        count = int(np.ceil(hi / self.step) - self.first)
        ends = (self.first + np.arange(count + 1)) * self.step  # exact: the step is a power of two
        jet = network_jet(network, weights, Interval(ends[:-1, None], ends[1:, None]))
        lows = np.stack([jet.value.lo, jet.grad.lo[:, 0], jet.hess.lo[:, 0, 0]])
        highs = np.stack([jet.value.hi, jet.grad.hi[:, 0], jet.hess.hi[:, 0, 0]])
        self.count, self.joins = count, [(lows, highs)]
        while 2 ** len(self.joins) <= count:
            (a, b), half = self.joins[-1], 2 ** (len(self.joins) - 1)
            self.joins.append(
                (np.minimum(a[:, :-half], a[:, half:]), np.maximum(b[:, :-half], b[:, half:]))
            )

    def holds(self, X: Interval) -> bool:
        """Whether intervals are on the grid."""
        last = self.first + self.count
        return bool(X.lo.min() >= self.first * self.step and X.hi.max() <= last * self.step)

    def __call__(self, X: Interval) -> Jet:
        lo, hi = X.lo[:, 0], X.hi[:, 0]
        wide = hi - lo > self.step
        left = np.clip(np.floor(lo / self.step) - self.first, 0, self.count - 1).astype(int)
        right = np.clip(np.ceil(hi / self.step) - self.first, 1, self.count).astype(int)
        level = np.floor(np.log2(np.maximum(right - left, 1))).astype(int)
        least, most = np.empty((3, len(lo))), np.empty((3, len(lo)))
        for k in np.unique(level[wide]):
            rows = wide & (level == k)
            lows, highs = self.joins[k]
            a, b = left[rows], right[rows] - 2**k
            least[:, rows] = np.minimum(lows[:, a], lows[:, b])
            most[:, rows] = np.maximum(highs[:, a], highs[:, b])
        if not wide.all():
            jet = network_jet(self.network, self.weights, X[~wide])
            least[:, ~wide] = [jet.value.lo, jet.grad.lo[:, 0], jet.hess.lo[:, 0, 0]]
            most[:, ~wide] = [jet.value.hi, jet.grad.hi[:, 0], jet.hess.hi[:, 0, 0]]
        value, grad, hess = (Interval(a, b) for a, b in zip(least, most, strict=True))
        return Jet(value, grad[:, None], hess[:, None, None])
