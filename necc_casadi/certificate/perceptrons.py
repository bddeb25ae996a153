"""Networks over boxes: derivatives up to the third, so that mean-value forms sharpen the second."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from necc_casadi.certificate.intervals import Interval, concatenate, matmul, point, stack
from necc_casadi.certificate.jets import Jet, coordinates, sin_slopes, tanh_slopes
from necc_casadi.networks import MonotonePhi, Network, Vector

__all__ = ["network_jet", "phi_jet"]

#: Enclosures of (f, f′, f″, f‴) at an interval.
Slopes = Callable[[Interval], tuple[Interval, Interval, Interval, Interval]]


def _tanh(v: Interval) -> tuple[Interval, Interval, Interval, Interval]:
    """With s = t²: f‴ = −2 + 8s − 6s², which rises up to s = 2/3 and falls from there."""
    t, slope, bend = tanh_slopes(v)
    s = t.square()
    ends = [(8.0 - 6.0 * end) * end - 2.0 for end in (point(s.lo), point(s.hi))]
    lo, hi = np.minimum(ends[0].lo, ends[1].lo), np.maximum(ends[0].hi, ends[1].hi)
    top = (s.lo <= 0.667) & (s.hi >= 0.666)
    return t, slope, bend, Interval(lo, np.where(top, 0.6666666666666667, hi))


def _sin(v: Interval) -> tuple[Interval, Interval, Interval, Interval]:
    s, c, minus = sin_slopes(v)
    return s, c, minus, -c


def _squareplus(v: Interval) -> tuple[Interval, Interval, Interval, Interval]:
    root = (v.square() + 4.0).sqrt()
    inverse = root.reciprocal()
    cube = inverse.power(3)
    third = -6.0 * v * cube * inverse.square()
    return (v + root) * 0.5, (1.0 + v * inverse) * 0.5, 2.0 * cube, third


_ACTIVATIONS: dict[str, Slopes] = {"tanh": _tanh, "sin": _sin, "squareplus": _squareplus}


@dataclass(frozen=True, eq=False)
class _Layer:
    """Neurons over boxes: value (B, h) and derivatives in the network's inputs."""

    value: Interval  # (B, h)
    grad: Interval  # (B, h, d)
    hess: Interval  # (B, h, d, d)
    third: Interval  # (B, h, d, d, d)

    def __getitem__(self, key: slice) -> _Layer:
        return _Layer(self.value[key], self.grad[key], self.hess[key], self.third[key])

    def affine(self, W: Interval, b: Interval) -> _Layer:
        """The next layer before its activation."""
        B, h, d = self.grad.shape
        rows = W.shape[0]
        parts = [self.hess.reshape(B, h, d * d), self.third.reshape(B, h, d * d * d)]
        hess, third = (matmul(W, part) for part in parts)
        return _Layer(
            matmul(W, self.value[..., None])[..., 0] + b,
            matmul(W, self.grad),
            hess.reshape(B, rows, d, d),
            third.reshape(B, rows, d, d, d),
        )

    def apply(self, slopes: Slopes) -> _Layer:
        """The activation, neuron by neuron (Faà di Bruno up to the third order)."""
        f0, f1, f2, f3 = slopes(self.value)
        g, H = self.grad, self.hess
        gg = g[..., :, None] * g[..., None, :]
        mixed = H[..., :, :, None] * g[..., None, None, :]
        turned = [_permuted(mixed, axes) for axes in ((0, 2, 1), (2, 0, 1))]
        return _Layer(
            f0,
            g * f1[..., None],
            H * f1[..., None, None] + gg * f2[..., None, None],
            self.third * f1[..., None, None, None]
            + (mixed + turned[0] + turned[1]) * f2[..., None, None, None]
            + (gg[..., :, :, None] * g[..., None, None, :]) * f3[..., None, None, None],
        )

    def centred(self, middle: _Layer, delta: Interval) -> _Layer:
        """Intersect with the mean-value forms about the middles; delta (B, d)."""
        steps = [delta[(slice(None), *[None] * k)] for k in (1, 2, 3)]
        return _Layer(
            self.value.meet(middle.value + (self.grad * steps[0]).sum()),
            self.grad.meet(middle.grad + (self.hess * steps[1]).sum()),
            self.hess.meet(middle.hess + (self.third * steps[2]).sum()),
            self.third,
        )

    def above(self, other: _Layer) -> _Layer:
        """Both in one, these boxes first."""
        parts = zip(vars(self).values(), vars(other).values(), strict=True)
        return _Layer(*(concatenate(a, b) for a, b in parts))


def _permuted(v: Interval, axes: tuple[int, ...]) -> Interval:
    lead = v.lo.ndim - len(axes)
    order = (*range(lead), *(lead + a for a in axes))
    return Interval(v.lo.transpose(order), v.hi.transpose(order))


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
    neurons = _layers([(inner, point(f)), (point(a).exp()[None, :], point(np.zeros(1)))], _tanh, X)
    e, k = coordinates(X)
    return neurons + (e * float(phi.delta) + k)


def _layers(layers: list[tuple[Interval, Interval]], activate: Slopes, X: Interval) -> Jet:
    """W_L σ(… σ(W_1 v + b_1) …) + b_L; mean-value forms keep deep networks from exploding."""
    middle, boxes = X.mid, X.shape[0]
    delta = X - middle
    both = concatenate(X, point(middle))
    W, b = layers[0]
    inner = matmul(W, both[..., None])[..., 0] + b
    if len(layers) == 1:
        return _linear(inner[:boxes], W)
    layer = _second_layer(W, activate(inner), *layers[1])
    for V, c in layers[2:]:
        layer = _centred(layer, delta).apply(activate).affine(V, c)
    layer = _centred(layer, delta)
    return Jet(layer.value[:boxes, 0], layer.grad[:boxes, 0], layer.hess[:boxes, 0])


def _centred(both: _Layer, delta: Interval) -> _Layer:
    """Boxes, first, sharpened about their middles, which follow."""
    boxes = delta.shape[0]
    return both[:boxes].centred(both[boxes:], delta).above(both[boxes:])


def _linear(value: Interval, W: Interval) -> Jet:
    """A network without hidden layers."""
    boxes, d = value.shape[0], W.shape[1]
    grad = np.zeros((boxes, 1, 1)) + W
    return Jet(value[:, 0], grad[:, 0], point(np.zeros((boxes, d, d))))


def _second_layer(
    W: Interval, slopes: tuple[Interval, Interval, Interval, Interval], V: Interval, c: Interval
) -> _Layer:
    """V σ(W v + b) + c: the k-th derivative of a neuron is σ⁽ᵏ⁾ times k entries of its row of W."""
    h, d = W.shape
    square = W[:, :, None] * W[:, None, :]
    cube = square[:, :, :, None] * W[:, None, None, :]
    tensors = [T.reshape(h, -1) for T in (W, square, cube)]
    parts = [_spread(V, f, T) for f, T in zip(slopes[1:], tensors, strict=True)]
    rows, boxes = V.shape[0], slopes[0].shape[0]
    return _Layer(
        matmul(V, slopes[0][..., None])[..., 0] + c,
        parts[0],
        parts[1].reshape(boxes, rows, d, d),
        parts[2].reshape(boxes, rows, d, d, d),
    )


def _spread(V: Interval, f: Interval, T: Interval) -> Interval:
    """Σₕ V_kh f_bh T_hj, (B, k, j), in the cheaper of two orders."""
    if V.shape[0] <= T.shape[1]:
        return matmul(V * f[:, None, :], T)
    return matmul(V, f[..., None] * T)
