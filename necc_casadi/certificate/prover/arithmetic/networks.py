"""Networks over boxes: derivatives up to the third, so that mean-value forms sharpen the second.

Activations by the formula of Faà di Bruno.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from necc_casadi.arrays import Vector
from necc_casadi.certificate.prover.arithmetic.intervals import Interval, matmul, point, stack
from necc_casadi.certificate.prover.arithmetic.jets import Jet, coordinates, sin_slopes, tanh_slopes
from necc_casadi.lyapunov.networks import MonotonePhi, Network

__all__ = ["network_jet", "network_taylor", "phi_jet"]


#: Enclosures of (f, f′, f″) at an interval, and of f‴ where the order asked for is 3.
Slopes = Callable[[Interval, int], tuple[Interval, ...]]


def _tanh(v: Interval, order: int) -> tuple[Interval, ...]:
    """With s = t²: f‴ = −2 + 8s − 6s², which rises up to s = 2/3 and falls from there."""
    t, slope, bend = tanh_slopes(v)
    if order < 3:
        return t, slope, bend
    s = t.square()
    ends = [(8.0 - 6.0 * end) * end - 2.0 for end in (s.lo, s.hi)]
    error = 4e-15  # four roundings of numbers up to 8: at most 25 · 2⁻⁵³ for s ≤ 1
    lo, hi = np.minimum(*ends) - error, np.maximum(*ends) + error
    top = (s.lo <= 0.667) & (s.hi >= 0.666)
    return t, slope, bend, Interval(lo, np.where(top, 0.6666666666666667, hi))


def _sin(v: Interval, order: int) -> tuple[Interval, ...]:
    s, c, minus = sin_slopes(v)
    return (s, c, minus, -c)[: order + 1]


def _squareplus(v: Interval, order: int) -> tuple[Interval, ...]:
    root = (v.square() + 4.0).sqrt()
    inverse = root.reciprocal()
    cube = inverse.power(3)
    lower = (v + root) * 0.5, (1.0 + v * inverse) * 0.5, 2.0 * cube
    return lower if order < 3 else (*lower, -6.0 * v * cube * inverse.square())


_ACTIVATIONS: dict[str, Slopes] = {"tanh": _tanh, "sin": _sin, "squareplus": _squareplus}


#: An upper bound of |tanh⁗| over the real line (4.08589…).
_MOST_FOURTH = 4.086


@dataclass(frozen=True, eq=False)
class _Layer:
    """Neurons over boxes: value (B, h) and derivatives in the network's inputs."""

    value: Interval  # (B, h)
    grad: Interval  # (B, h, d)
    hess: Interval  # (B, h, d, d)
    third: Interval | None  # (B, h, d, d, d); only boxes need it, not their middles

    def affine(self, W: Interval, b: Interval) -> _Layer:
        """The next layer before its activation."""
        B, h, d = self.grad.shape
        rows = W.shape[0]
        hess = matmul(W, self.hess.reshape(B, h, d * d)).reshape(B, rows, d, d)
        third = self.third
        if third is not None:
            third = matmul(W, third.reshape(B, h, d**3)).reshape(B, rows, d, d, d)
        value = matmul(W, self.value[..., None])[..., 0] + b
        return _Layer(value, matmul(W, self.grad), hess, third)

    def apply(self, slopes: Slopes) -> _Layer:
        """The activation, neuron by neuron (Faà di Bruno up to the third order)."""
        f0, f1, f2, *f3 = slopes(self.value, 2 if self.third is None else 3)
        g, H = self.grad, self.hess
        scalar = g.shape[-1] == 1
        gg = g.square()[..., None] if scalar else g[..., :, None] * g[..., None, :]
        third = self.third
        if third is not None:
            bent, turned = f2[..., None, None, None], f3[0][..., None, None, None]
            third = third * f1[..., None, None, None]
            if scalar:
                inner = (H * f2[..., None, None]) * 3.0 + gg * f3[0][..., None, None]
                third = third + (inner * g[..., None])[..., None]
            else:
                mixed = H[..., :, :, None] * g[..., None, None, :]
                sides = [_permuted(mixed, axes) for axes in ((0, 2, 1), (2, 0, 1))]
                third = third + (mixed + sides[0] + sides[1]) * bent
                third = third + (gg[..., :, :, None] * g[..., None, None, :]) * turned
        hess = H * f1[..., None, None] + gg * f2[..., None, None]
        return _Layer(f0, g * f1[..., None], hess, third)

    def centred(self, middle: _Layer, delta: Interval) -> _Layer:
        """Intersect with the mean-value forms about the middles; delta (B, d)."""
        value = self.value.meet(middle.value + (self.grad * delta[:, None]).sum())
        grad = self.grad.meet(middle.grad + (self.hess * delta[:, None, None]).sum())
        hess = self.hess
        if self.third is not None:
            hess = hess.meet(middle.hess + (self.third * delta[:, None, None, None]).sum())
        return _Layer(value, grad, hess, self.third)


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


def network_taylor(network: Network, weights: Vector, X: Interval) -> Jet:
    """A network with one hidden layer of tanh over small boxes (B, d), by Taylor's formula.

    f″ = f″(m) + f‴(m)δ ± ½M₄|δ|², M₄ = max |tanh⁗| Σ|vₕ||wₕ|⁴ for all arguments: no pieces, and an
    error of the second order in the width of the box.
    """
    (W, b), (v, c) = network.layers(weights)
    d, middle = W.shape[1], X.mid
    rows, out = point(W), point(v[0])
    square = rows[:, :, None] * rows[:, None, :]
    cube = square[:, :, :, None] * rows[:, None, None, :]
    t = (matmul(rows, point(middle)[..., None])[..., 0] + b).tanh()
    first = 1.0 - t.square()
    second, third = -2.0 * t * first, first * (6.0 * t.square() - 2.0)

    def summed(f: Interval, T: Interval) -> Interval:
        """Σₕ vₕ fₕ Tₕ, (B, …)."""
        flat = matmul(out * f, T.reshape(T.shape[0], -1))
        return flat.reshape(X.shape[0], *T.shape[1:])

    delta = X - middle
    pairs = (point(np.abs(W))[:, :, None] * np.abs(W)[:, None]).reshape(len(W), d * d)
    weighted = pairs * (point(np.abs(v[0])) * _MOST_FOURTH)[:, None]
    fourth = matmul(Interval(pairs.lo.T, pairs.hi.T), weighted)  # M₄ by pairs of indices
    reach = point(delta.magnitude)
    steps = (reach[:, :, None] * reach[:, None]).reshape(-1, d * d)
    rest = (matmul(steps, fourth) * 0.5).hi.reshape(-1, d, d)
    hess = summed(second, square) + (summed(third, cube) * delta[:, None, None]).sum()
    hess = hess + Interval(-rest, rest)
    grad = summed(first, rows) + (hess * delta[:, None]).sum()
    value = matmul(out[None], t[..., None])[:, 0, 0] + float(c[0]) + (grad * delta).sum()
    result = Jet(value, grad, hess)
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
    middle = X.mid
    delta = X - middle
    W, b = layers[0]
    inner = [matmul(W, v[..., None])[..., 0] + b for v in (X, point(middle))]
    if len(layers) == 1:
        return _linear(inner[0], W)
    wide, mid = (
        _second_layer(W, activate(v, k), *layers[1]) for v, k in zip(inner, (3, 2), strict=True)
    )
    for V, c in layers[2:]:
        wide, mid = (v.apply(activate).affine(V, c) for v in (wide.centred(mid, delta), mid))
    layer = wide.centred(mid, delta)
    return Jet(layer.value[:, 0], layer.grad[:, 0], layer.hess[:, 0])


def _linear(value: Interval, W: Interval) -> Jet:
    """A network without hidden layers."""
    boxes, d = value.shape[0], W.shape[1]
    grad = np.zeros((boxes, 1, 1)) + W
    return Jet(value[:, 0], grad[:, 0], point(np.zeros((boxes, d, d))))


def _second_layer(W: Interval, slopes: tuple[Interval, ...], V: Interval, c: Interval) -> _Layer:
    """V σ(W v + b) + c: the k-th derivative of a neuron is σ⁽ᵏ⁾ times k entries of its row of W."""
    h, d = W.shape
    rows, boxes = V.shape[0], slopes[0].shape[0]
    square = W[:, :, None] * W[:, None, :]
    powers, parts = [W, square, square[:, :, :, None] * W[:, None, None, :]], []
    for order, (f, T) in enumerate(zip(slopes[1:], powers, strict=False), 1):
        part = _spread(V, f, T.reshape(h, -1))
        parts.append(part.reshape(boxes, rows, *[d] * order))
    value = matmul(V, slopes[0][..., None])[..., 0] + c
    return _Layer(value, parts[0], parts[1], parts[2] if len(parts) > 2 else None)


def _spread(V: Interval, f: Interval, T: Interval) -> Interval:
    """Σₕ V_kh f_bh T_hj, (B, k, j), in the cheaper of two orders."""
    if V.shape[0] <= T.shape[1]:
        return matmul(V * f[:, None, :], T)
    return matmul(V, f[..., None] * T)
