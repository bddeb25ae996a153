"""Networks of one input or two over many boxes: enclosures on a grid, joined by range queries."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np

from necc_casadi.arrays import Vector
from necc_casadi.certificate.prover.arithmetic.intervals import Interval
from necc_casadi.certificate.prover.arithmetic.jets import Jet
from necc_casadi.certificate.prover.arithmetic.networks import network_jet
from necc_casadi.certificate.prover.arithmetic.potential import OverBoxes, Potential, over_pieces
from necc_casadi.lyapunov.networks import Network

__all__ = ["TabledPotential"]


#: Boxes of a grid at most, and of the widest box that was asked for; of two inputs a quarter, since
#: boxes can be joined in many ways. More inputs are not looked up.
_MOST, _PARTS, _QUARTER = 2**16, 512, 4
_INPUTS = 2
#: A side of a box of the grid is at least this share of the longest one.
_THIN = 2.0**-6
#: Boxes at once.
_ROWS = 2048


@dataclass(frozen=True, eq=False)
class TabledPotential(Potential):
    """V whose networks of few inputs are looked up where boxes are wide."""

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
        """The network over boxes (B, d) of few inputs."""
        if network.inputs > _INPUTS or not np.isfinite(X.lo + X.hi).all():
            return over_pieces(network, weights, X)
        key = (network, weights.tobytes())
        if key not in self.known or not self.known[key].holds(X):
            if (X.hi == X.lo).all():
                return network_jet(network, weights, X)
            self.known[key] = _Table(network, weights, X)
        return self.known[key](X)


class _Table:
    """Enclosures of f, ∇f and ∇²f on a grid of boxes, and of joins of 2ᵏ neighbours a side."""

    def __init__(self, network: Network, weights: Vector, X: Interval) -> None:
        self.network, self.weights, d = network, weights, X.shape[1]
        lo, hi = X.lo.min(0), X.hi.max(0)
        lo, hi = lo - (hi - lo) / 2, hi + (hi - lo) / 2
        widest = (X.hi - X.lo).max(0)
        most = (_MOST / _QUARTER ** (d - 1)) ** (1 / d)
        finest = np.maximum(widest / _PARTS ** (1 / d), 2 * (hi - lo) / most)
        # ends are exact: steps are powers of two
        self.step = 2.0 ** np.floor(np.log2(np.maximum(finest, finest.max() * _THIN)))
        self.first = np.floor(lo / self.step)
        self.count = np.maximum(np.ceil(hi / self.step) - self.first, 1).astype(int)
        cells = np.stack(np.meshgrid(*map(np.arange, self.count), indexing="ij"), -1)
        low = (self.first + cells.reshape(-1, d)) * self.step
        high = (self.first + cells.reshape(-1, d) + 1) * self.step
        parts = [
            _flat(network_jet(network, weights, Interval(low[rows], high[rows])))
            for rows in np.array_split(np.arange(len(low)), -(-len(low) // _ROWS))
        ]
        lows, highs = (np.concatenate([p[k] for p in parts], 1) for k in (0, 1))
        shape = (-1, *self.count)
        self._joins = {(0,) * d: (lows.reshape(shape), highs.reshape(shape))}

    def holds(self, X: Interval) -> bool:
        """Whether boxes are on the grid."""
        last = self.first + self.count
        above, below = X.lo.min(0) >= self.first * self.step, X.hi.max(0) <= last * self.step
        return bool(above.all() and below.all())

    def __call__(self, X: Interval) -> Jet:
        lo, hi = X.lo, X.hi
        d = lo.shape[1]
        wide = (hi - lo > self.step).any(-1)
        left = np.clip(np.floor(lo / self.step) - self.first, 0, self.count - 1).astype(int)
        right = np.clip(np.ceil(hi / self.step) - self.first, 1, self.count).astype(int)
        level = np.floor(np.log2(np.maximum(right - left, 1))).astype(int)
        size = 1 + d + d * d
        least, most = np.empty((size, len(lo))), np.empty((size, len(lo)))
        for k in np.unique(level[wide], axis=0):
            rows = wide & (level == k).all(-1)
            lows, highs = self._joined(tuple(k.tolist()))
            corners = np.stack([left[rows], right[rows] - 2**k])
            for at in product(range(2), repeat=d):
                place: tuple[Any, ...] = tuple(corners[end, :, i] for i, end in enumerate(at))
                below, above = lows[(slice(None), *place)], highs[(slice(None), *place)]
                least[:, rows] = below if not any(at) else np.minimum(least[:, rows], below)
                most[:, rows] = above if not any(at) else np.maximum(most[:, rows], above)
        if not wide.all():
            jet = network_jet(self.network, self.weights, X[~wide])
            least[:, ~wide], most[:, ~wide] = _flat(jet)
        whole = Interval(least.T, most.T)
        return Jet(whole[:, 0], whole[:, 1 : 1 + d], whole[:, 1 + d :].reshape(-1, d, d))

    def _joined(self, k: tuple[int, ...]) -> tuple[Vector, Vector]:
        """Of 2ᵏ boxes from each one on."""
        if k not in self._joins:
            axis = int(np.argmax(k))
            half = 2 ** (k[axis] - 1)
            lows, highs = self._joined((*k[:axis], k[axis] - 1, *k[axis + 1 :]))
            ahead = [slice(None)] * lows.ndim
            behind = list(ahead)
            ahead[1 + axis], behind[1 + axis] = slice(half, None), slice(None, -half)
            a, b = tuple(behind), tuple(ahead)
            self._joins[k] = np.minimum(lows[a], lows[b]), np.maximum(highs[a], highs[b])
        return self._joins[k]


def _flat(jet: Jet) -> tuple[Vector, Vector]:
    """The ends of f, ∇f and ∇²f over boxes, (1 + d + d², B)."""
    boxes = len(jet.grad.lo)
    lo, hi = (
        np.concatenate(
            [getattr(part, end).reshape(boxes, -1) for part in (jet.value, jet.grad, jet.hess)], 1
        ).T
        for end in ("lo", "hi")
    )
    return lo, hi
