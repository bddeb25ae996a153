"""Networks over boxes in Arb balls: derivatives packed over multi-indices, kept per box.

Activations by the formula of Faà di Bruno, sharpened by mean-value forms layer by layer.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, reduce
from itertools import accumulate, combinations_with_replacement, pairwise, product
from operator import mul
from typing import Any

from flint import arb, arb_mat

from necc_casadi.certificate.checker.arithmetic.balls import Box, ball, meet

__all__ = ["Net"]


#: Arguments of neurons may vary by this much over a piece of a box.
_SPREAD = 0.25
#: Cells of a grid along each side of a wide box, by the inputs of a network.
_CELLS = {1: 64, 2: 16, 3: 4}


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


#: A neuron over a box: its value and its packed derivatives in the network's inputs.
Row = list[arb]


#: f, ∇f, and ∇²f over pairs i ≤ j.
Derivatives = tuple[arb, list[arb], dict[tuple[int, int], arb]]


@dataclass(frozen=True)
class _Layout:
    """Where the derivatives stand in the row of a neuron: value, ∇, ∇² and third, packed."""

    keys: list[list[tuple[int, ...]]]  # multi-indices, by order
    at: list[int]  # where each order begins, and the last ends
    pairs: list[tuple[int, int]]  # those of ∇²
    above: list[list[int]]  # of each entry up to ∇², its derivatives one order up
    triples: list[tuple[int, int, int]]  # those of the third derivative
    pairs_in: list[tuple[int, int, int]]  # places in ∇² of the pairs in each triple

    @classmethod
    def of(cls, d: int) -> _Layout:
        """The layout for d inputs."""
        keys = [list(combinations_with_replacement(range(d), k)) for k in range(4)]
        pairs = [(i, j) for i, j in keys[2]]
        where = {key: n for n, key in enumerate(key for keys_k in keys for key in keys_k)}
        above = [
            [where[tuple(sorted((*key, k)))] for k in range(d)]
            for keys_k in keys[:3]
            for key in keys_k
        ]
        pair = {key: n for n, key in enumerate(pairs)}
        third = [(i, j, k) for i, j, k in keys[3]]
        inner = [(pair[i, j], pair[i, k], pair[j, k]) for i, j, k in third]
        return cls(keys, [0, *accumulate(map(len, keys))], pairs, above, third, inner)


class Net:
    """A network ℝᵈ → ℝ: value, gradient, Hessian and third derivative over a box.

    f(v) = W_L σ(… σ(W₁v + b₁) …) + b_L + Σ ½κᵢ(vᵢ − oᵢ)² + Σ lᵢvᵢ, with `quadratic` = (κ, o) and
    `linear` = l where it has such parts.
    """

    def __init__(
        self,
        layers: list[tuple[arb_mat, arb_mat]],
        activation: Activation,
        inputs: int,
        quadratic: tuple[list[arb], list[arb]] | None = None,
        linear: list[arb] | None = None,
    ) -> None:
        self.layers, self.activation, self.d = layers, activation, inputs
        self.quadratic, self.linear = quadratic, linear
        self._layout = _Layout.of(inputs)
        rows = layers[0][0].tolist()
        self._powers = [
            [
                [reduce(mul, (row[i] for i in key), arb(1)) for key in keys]
                for keys in self._layout.keys
            ]
            for row in rows
        ]
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
        quadratic, d = None, shape["inputs"]
        if shape["quadratic"]:
            kappa, center = (list(map(arb, weights[at + k * d : at + (k + 1) * d])) for k in (0, 1))
            quadratic, at = (kappa, center), at + 2 * d
        return cls(layers, _ACTIVATIONS[shape["activation"]], d, quadratic), at

    @classmethod
    def outer(cls, phi: Mapping[str, Any], weights: Sequence[float]) -> Net:
        """The neural Φ(e, k) = δe + k + Σ exp(a) tanh(exp(b)e + dk + f)."""
        h = phi["hidden"]
        a, b, d, f = (list(map(arb, weights[i * h : (i + 1) * h])) for i in range(4))
        first = arb_mat([[x.exp(), y] for x, y in zip(b, d, strict=True)])
        second = arb_mat([[x.exp() for x in a]])
        layers = [(first, arb_mat([[x] for x in f])), (second, arb_mat([[arb(0)]]))]
        return cls(layers, _tanh, 2, linear=[arb(phi["delta"]), arb(1)])

    def quadratic_curvature(self) -> arb_mat:
        """Diag κ."""
        total = arb_mat(self.d, self.d)
        for i, kappa in enumerate(self.quadratic[0] if self.quadratic else ()):
            total[i, i] = kappa
        return total

    def __call__(self, box: Box) -> Derivatives:
        """(f, ∇f, ∇²f over pairs i ≤ j) over a box, by mean-value forms about its middle."""
        if box not in self._known:
            pieces = self._pieces(box)
            if len(pieces) == 1:  # its middle comes with it, and will be asked for
                self._known[box], self._known[_middle(box)] = self._around(box)
            else:
                self._known[box] = reduce(_union, map(self.enclose, pieces))
        return self._known[box]

    def curvature_on_grid(self, box: Box) -> dict[tuple[int, int], arb]:
        """∇²f over pairs i ≤ j over a wide box, by cells of a grid that other boxes share."""
        parts = [self(cell)[2] for cell in self._grid(box)]
        return {pair: reduce(arb.union, (part[pair] for part in parts)) for pair in parts[0]}

    def slope_on_grid(self, box: Box) -> list[arb]:
        """∇f over a wide box, likewise."""
        parts = [self(cell)[1] for cell in self._grid(box)]
        return [reduce(arb.union, each) for each in zip(*parts, strict=True)]

    def _grid(self, box: Box) -> list[Box]:
        """Cells that hold a box, or the box where it has a side of no width."""
        most = _CELLS.get(self.d, 1)
        sides = []
        for lo, hi in box:
            if not 0 < hi - lo < math.inf:
                return [box]
            step = 2.0 ** math.ceil(math.log2((hi - lo) / most))
            cells = range(math.floor(lo / step), math.ceil(hi / step))
            sides.append([(k * step, (k + 1) * step) for k in cells])
        return list(product(*sides))

    def curvature(self, box: Box) -> dict[tuple[int, int], arb]:
        """∇²f over pairs i ≤ j over a small box.

        With one layer of tanh by Taylor's formula about the middle, the fourth derivative bounded
        for all arguments; else as for a call.
        """
        if len(self.layers) != 2 or self.activation is not _tanh or self.linear is not None:
            return self(box)[2]
        layout, middle = self._layout, [arb(m) for (m, _) in _middle(box)]
        steps = [ball(lo, hi) - m for (lo, hi), m in zip(box, middle, strict=True)]
        reach = [s.abs_upper() for s in steps]
        row = self._next(*self.layers[1], self._first(middle, 3))[0]
        hess, third = row[layout.at[2] : layout.at[3]], row[layout.at[3] :]
        place = {key: n for n, key in enumerate(layout.keys[3])}
        result = {}
        for (i, j), h in zip(layout.pairs, hess, strict=True):
            total = h
            for k, step in enumerate(steps):
                a, b, c = sorted((i, j, k))
                total = total + third[place[a, b, c]] * step
            rest = sum((m * reach[k] * reach[n] for (k, n), m in self._fourth[i, j]), arb(0))
            result[i, j] = total + ball(-1.0, 1.0) * rest / 2
        for i, kappa in enumerate(self.quadratic[0] if self.quadratic else ()):
            result[i, i] = result[i, i] + kappa
        return result

    @cached_property
    def _fourth(self) -> dict[tuple[int, int], list[tuple[tuple[int, int], arb]]]:
        """Bounds of |∂⁴f| for all arguments: for each pair (i, j) those over all (k, n)."""
        rows = [[abs(v) for v in row] for row in self.layers[0][0].tolist()]
        out = [abs(v) * arb("4.086") for v in self.layers[1][0].tolist()[0]]
        size = range(self.d)

        def bound(i: int, j: int, k: int, n: int) -> arb:
            return sum(
                (v * w[i] * w[j] * w[k] * w[n] for v, w in zip(out, rows, strict=True)), arb(0)
            )

        return {
            (i, j): [((k, n), bound(i, j, k, n)) for k in size for n in size]
            for i, j in self._layout.pairs
        }

    def _pieces(self, box: Box) -> list[Box]:
        """The box, cut where a neuron's argument varies much."""
        most = {1: 16, 2: 4}.get(self.d, 2)
        sides = []
        for (lo, hi), steep in zip(box, self.steepest, strict=True):
            turns = (hi - lo) * steep / _SPREAD
            count = min(most, max(1, math.ceil(turns))) if math.isfinite(turns) else 1
            ends = [lo + (hi - lo) * k / count for k in range(count)] + [hi]
            sides.append(list(pairwise(ends)))
        return list(product(*sides))

    def at(self, point: list[arb]) -> tuple[arb, list[arb]]:
        """(f, ∇f) at a point of balls, to the precision that is set."""
        return self._completed(self._pass(point, None)[0], point)[:2]

    def enclose(self, box: Box) -> Derivatives:
        """The same as for a call over a box, which is not cut, and not kept."""
        return self._around(box)[0]

    def _around(self, box: Box) -> tuple[Derivatives, Derivatives]:
        """Over a box and at its middle."""
        wide, at = ([ball(*side) for side in b] for b in (box, _middle(box)))
        over, middle = self._pass(wide, None if _middle(box) == box else at)
        return self._completed(over, wide), self._completed(middle, at)

    def _completed(self, parts: Derivatives, v: list[arb]) -> Derivatives:
        """With the quadratic and the linear part."""
        value, grad, hess = parts[0], list(parts[1]), dict(parts[2])
        if self.quadratic is not None:
            for i, (kappa, center) in enumerate(zip(*self.quadratic, strict=True)):
                offset = v[i] - center
                value, grad[i] = value + kappa * offset * offset / 2, grad[i] + kappa * offset
                hess[i, i] += kappa
        if self.linear is not None:
            for i, slope in enumerate(self.linear):
                value, grad[i] = value + slope * v[i], grad[i] + slope
        return value, grad, hess

    def _pass(self, wide: list[arb], at: list[arb] | None) -> tuple[Derivatives, Derivatives]:
        """Over a box and at its middle `at`, None for a point, from the layers alone.

        Third derivatives serve the mean-value forms.
        """
        if len(self.layers) == 1:
            return self._affine(wide), self._affine(at or wide)
        over = self._first(wide, 2 if at is None else 3)
        middle = [] if at is None else self._first(at, 2)
        step = [] if at is None else [w - a for w, a in zip(wide, at, strict=True)]
        for depth, (W, b) in enumerate(self.layers[1:]):
            if depth:
                over, middle = ([self._activated(row) for row in rows] for rows in (over, middle))
            over = self._next(W, b, over)
            if at is not None:
                middle = self._next(W, b, middle)
                over = [self._centred(o, m, step) for o, m in zip(over, middle, strict=True)]
        return self._unpacked(over[0]), self._unpacked((middle or over)[0])

    def _unpacked(self, row: Row) -> Derivatives:
        value, grad, hess = (row[self._layout.at[k] : self._layout.at[k + 1]] for k in range(3))
        return value[0], grad, dict(zip(self._layout.pairs, hess, strict=True))

    def _affine(self, v: list[arb]) -> Derivatives:
        """A network without hidden layers."""
        W, b = self.layers[0]
        value = (W * arb_mat([[x] for x in v]) + b)[0, 0]
        return value, W.tolist()[0], {pair: arb(0) for pair in self._layout.pairs}

    def _first(self, v: list[arb], order: int) -> list[Row]:
        """The first layer: k-th derivatives of a neuron are σ⁽ᵏ⁾ times k entries of its row."""
        W, b = self.layers[0]
        arguments = (W * arb_mat([[x] for x in v]) + b).tolist()
        result = []
        for (a,), powers in zip(arguments, self._powers, strict=True):
            f = self.activation(a)
            row = [f[0]]
            for k in range(1, order + 1):
                row += [f[k] * p for p in powers[k]]
            result.append(row)
        return result

    @staticmethod
    def _next(W: arb_mat, b: arb_mat, rows: list[Row]) -> list[Row]:
        """Arguments of the next layer."""
        result: list[Row] = (W * arb_mat(rows)).tolist()
        for row, (shift,) in zip(result, b.tolist(), strict=True):
            row[0] = row[0] + shift
        return result

    def _activated(self, row: Row) -> Row:
        """σ of a neuron's argument (Faà di Bruno), to the third order where the row has it."""
        f0, f1, f2, f3 = self.activation(row[0])
        layout, full = self._layout, len(row) == self._layout.at[4]
        if self.d == 1:
            slope, bend = row[1], row[2]
            f2g = f2 * slope
            result = [f0, f1 * slope, f1 * bend + f2g * slope]
            third = f1 * row[3] + 3 * f2g * bend + f3 * slope * slope * slope if full else None
            return result if third is None else [*result, third]
        g, H = row[1 : layout.at[2]], row[layout.at[2] : layout.at[3]]
        result = [f0, *(f1 * x for x in g)]
        result += [f1 * h + f2 * g[i] * g[j] for h, (i, j) in zip(H, layout.pairs, strict=True)]
        if full:
            packed = zip(row[layout.at[3] :], layout.triples, layout.pairs_in, strict=True)
            for T, (i, j, k), (ij, ik, jk) in packed:
                bent = H[ij] * g[k] + H[ik] * g[j] + H[jk] * g[i]
                result.append(f1 * T + f2 * bent + f3 * g[i] * g[j] * g[k])
        return result

    def _centred(self, over: Row, middle: Row, step: list[arb]) -> Row:
        """Each derivative by its mean-value form as well, from the derivatives one order up."""
        result = []
        for naive, center, above in zip(over, middle, self._layout.above, strict=False):
            bound = center
            for n, s in zip(above, step, strict=True):
                bound = bound + over[n] * s
            result.append(meet(naive, bound))
        return result + over[self._layout.at[3] :]


def _middle(box: Box) -> Box:
    return tuple((m, m) for m in (lo / 2 + hi / 2 for lo, hi in box))


def _union(a: Derivatives, b: Derivatives) -> Derivatives:
    """The hull of two enclosures of (f, ∇f, ∇²f)."""
    grad = [u.union(v) for u, v in zip(a[1], b[1], strict=True)]
    return a[0].union(b[0]), grad, {key: a[2][key].union(b[2][key]) for key in a[2]}
