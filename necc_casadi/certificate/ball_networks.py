"""Networks over boxes in Arb balls: derivatives packed over multi-indices, kept per box."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import reduce
from itertools import combinations_with_replacement, pairwise, product
from typing import Any

from flint import arb, arb_mat

from necc_casadi.certificate.balls import Box, ball, meet

__all__ = ["Net"]

#: Arguments of neurons may vary by this much over a piece of a box.
_SPREAD = 0.25


def _tanh(v: arb) -> tuple[arb, arb, arb, arb]:
    t = v.tanh()
    one = 1 - t * t
    return t, one, -2 * t * one, one * (6 * t * t - 2)


def _sin(v: arb) -> tuple[arb, arb, arb, arb]:
    s, c = v.sin(), v.cos()
    return s, c, -s, -c


def _squareplus(v: arb) -> tuple[arb, arb, arb, arb]:
    r = (v * v + 4).sqrt()
    return (v + r) / 2, (1 + v / r) / 2, 2 / r**3, -6 * v / r**5


_ACTIVATIONS = {"tanh": _tanh, "sin": _sin, "squareplus": _squareplus}
Activation = Callable[[arb], tuple[arb, arb, arb, arb]]


#: f, ∇f, and ∇²f over pairs i ≤ j.
Derivatives = tuple[arb, list[arb], dict[tuple[int, int], arb]]


class Net:
    """A network ℝᵈ → ℝ: value, gradient, Hessian and third derivative over a box."""

    def __init__(
        self, layers: list[tuple[arb_mat, arb_mat]], activation: Activation, inputs: int
    ) -> None:
        self.layers, self.activation, self.d = layers, activation, inputs
        self.index = [list(combinations_with_replacement(range(inputs), k)) for k in range(4)]
        self.place = [{key: i for i, key in enumerate(keys)} for keys in self.index]
        self.quadratic: tuple[list[arb], list[arb]] | None = None
        self.linear: list[arb] | None = None
        rows = layers[0][0].tolist()
        self.steepest = [max(float(abs(row[i]).upper()) for row in rows) for i in range(inputs)]
        self._known: dict[Box, Derivatives] = {}

    @classmethod
    def from_weights(cls, shape: Mapping[str, Any], weights: Sequence[float]) -> tuple[Net, int]:
        """A network of design.json and how many weights it took."""
        widths = [shape["inputs"], *shape["hidden"], 1]
        at, layers = 0, []
        for columns, rows in pairwise(widths):
            starts = range(at, at + rows * columns, columns)
            W = [list(map(arb, weights[k : k + columns])) for k in starts]
            at += rows * columns
            layers.append((arb_mat(W), arb_mat([[arb(b)] for b in weights[at : at + rows]])))
            at += rows
        net = cls(layers, _ACTIVATIONS[shape["activation"]], shape["inputs"])
        if shape["quadratic"]:
            d = shape["inputs"]
            kappa, center = (list(map(arb, weights[at + k * d : at + (k + 1) * d])) for k in (0, 1))
            net.quadratic, at = (kappa, center), at + 2 * d
        return net, at

    @classmethod
    def outer(cls, phi: Mapping[str, Any], weights: Sequence[float]) -> Net:
        """The neural Φ(e, k) = δe + k + Σ exp(a) tanh(exp(b)e + dk + f)."""
        h = phi["hidden"]
        a, b, d, f = (list(map(arb, weights[i * h : (i + 1) * h])) for i in range(4))
        first = arb_mat([[x.exp(), y] for x, y in zip(b, d, strict=True)])
        second = arb_mat([[x.exp() for x in a]])
        layers = [(first, arb_mat([[x] for x in f])), (second, arb_mat([[arb(0)]]))]
        net = cls(layers, _tanh, 2)
        net.linear = [arb(phi["delta"]), arb(1)]
        return net

    def floor(self, activation: str) -> arb_mat:
        """A matrix ⪯ ∇²f for all arguments of a network with at most one hidden layer."""
        total = arb_mat(self.d, self.d)
        if self.quadratic is not None:
            for i, kappa in enumerate(self.quadratic[0]):
                total[i, i] = kappa
        if len(self.layers) == 1:
            return total
        W, out = self.layers[0][0], self.layers[1][0]
        bend = {"tanh": 4 / (3 * arb(3).sqrt()), "sin": arb(1), "squareplus": arb(1) / 4}[
            activation
        ]
        for j in range(W.nrows()):
            convex = activation == "squareplus" and not out[0, j] < 0
            weight = arb(0) if convex else abs(out[0, j]) * bend
            for i in range(self.d):
                for k in range(self.d):
                    total[i, k] = total[i, k] - weight * W[j, i] * W[j, k]
        return total

    def __call__(self, box: Box) -> Derivatives:
        """(f, ∇f, ∇²f over pairs i ≤ j) over a box, by mean-value forms about its middle."""
        if box not in self._known:
            pieces = [self._enclose(piece) for piece in self._pieces(box)]
            self._known[box] = reduce(_union, pieces)
        return self._known[box]

    def _pieces(self, box: Box) -> list[Box]:
        """The box, cut where a neuron's argument varies much."""
        most = {1: 16, 2: 4}.get(self.d, 2)
        sides = []
        for (lo, hi), steep in zip(box, self.steepest, strict=True):
            count = min(most, max(1, math.ceil((hi - lo) * steep / _SPREAD)))
            ends = [lo + (hi - lo) * k / count for k in range(count)] + [hi]
            sides.append(list(pairwise(ends)))
        return list(product(*sides))

    def at(self, point: list[arb]) -> tuple[arb, list[arb]]:
        """(f, ∇f) at a point of balls, to the precision that is set."""
        return self._around(point, point)[:2]

    def _enclose(self, box: Box) -> Derivatives:
        return self._around([ball(*side) for side in box], [arb(a / 2 + b / 2) for a, b in box])

    def _around(self, wide: list[arb], at: list[arb]) -> Derivatives:
        step = [w - a for w, a in zip(wide, at, strict=True)]
        value, grad, hess = self._pass(wide, at, step)
        if self.quadratic is not None:
            for i, (kappa, center) in enumerate(zip(*self.quadratic, strict=True)):
                offset = wide[i] - center
                value, grad[i] = value + kappa * offset * offset / 2, grad[i] + kappa * offset
                hess[i, i] += kappa
        if self.linear is not None:
            for i, slope in enumerate(self.linear):
                value, grad[i] = value + slope * wide[i], grad[i] + slope
        return value, grad, hess

    def _pass(self, wide: list[arb], at: list[arb], step: list[arb]) -> Derivatives:
        over, mid = self._start(wide), self._start(at)
        for depth, (W, b) in enumerate(self.layers):
            if depth:
                over = [self._activated(neuron) for neuron in over]
                mid = [self._activated(neuron) for neuron in mid]
            over, mid = self._affine(W, b, over), self._affine(W, b, mid)
            if depth:  # before it everything is linear
                both = zip(over, mid, strict=True)
                over = [self._centred(n, m, step) for n, m in both]
        value, grad, hess, _ = over[0]
        pairs = {(i, j): h for (i, j), h in zip(self.index[2], hess, strict=True)}
        return value[0], grad, pairs

    def _start(self, v: list[arb]) -> list[list[list[arb]]]:
        zeros = [[arb(0)] * len(keys) for keys in self.index]
        return [
            [[v[i]], [arb(int(i == j)) for j in range(self.d)], zeros[2], zeros[3]]
            for i in range(self.d)
        ]

    def _affine(self, W: arb_mat, b: arb_mat, layer: list[Any]) -> list[Any]:
        products = [(W * arb_mat([neuron[k] for neuron in layer])).tolist() for k in range(4)]
        rows = range(W.nrows())
        return [
            [[products[0][r][0] + b[r, 0]], products[1][r], products[2][r], products[3][r]]
            for r in rows
        ]

    def _activated(self, neuron: list[list[arb]]) -> list[list[arb]]:
        (v,), g, H, T = neuron
        f0, f1, f2, f3 = self.activation(v)
        pair = self.place[2]
        hess = [f1 * H[k] + f2 * g[i] * g[j] for k, (i, j) in enumerate(self.index[2])]
        third = [
            f1 * T[n]
            + f2 * (H[pair[i, j]] * g[k] + H[pair[i, k]] * g[j] + H[pair[j, k]] * g[i])
            + f3 * g[i] * g[j] * g[k]
            for n, (i, j, k) in enumerate(self.index[3])
        ]
        return [[f0], [f1 * x for x in g], hess, third]

    def _centred(self, over: list[Any], mid: list[Any], step: list[arb]) -> list[Any]:
        def sharpened(order: int, key: tuple[int, ...], naive: arb, center: arb) -> arb:
            above = self.place[order + 1]
            terms = [
                over[order + 1][above[tuple(sorted((*key, k)))]] * step[k] for k in range(self.d)
            ]
            return meet(naive, sum(terms, center))

        result = [
            [
                sharpened(order, key, over[order][n], mid[order][n])
                for n, key in enumerate(self.index[order])
            ]
            for order in range(3)
        ]
        return [*result, over[3]]


def _union(a: Derivatives, b: Derivatives) -> Derivatives:
    """The hull of two enclosures of (f, ∇f, ∇²f)."""
    grad = [u.union(v) for u, v in zip(a[1], b[1], strict=True)]
    return a[0].union(b[0]), grad, {key: a[2][key].union(b[2][key]) for key in a[2]}
