"""Second-order jets over boxes: value, gradient and Hessian of smooth functions as intervals.

By the chain and product rules (forward mode), sharpened by mean-value forms.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial, reduce
from typing import Any

import numpy as np
import sympy as sp
from flint import arb, fmpq

from necc_casadi.arrays import Vector
from necc_casadi.certificate.prover.arithmetic.intervals import (
    PI,
    Interval,
    concatenate,
    matmul,
    point,
)
from necc_casadi.symbolic.fold import Algebra, fold, product, total

__all__ = [
    "Jet",
    "Slopes",
    "chain",
    "constant",
    "coordinates",
    "expression_jets",
    "expression_values",
    "sin_slopes",
    "tanh_slopes",
]


#: Enclosures of (f, f′, f″) at an interval.
Slopes = Callable[[Interval], tuple[Interval, Interval, Interval]]


@dataclass(frozen=True, eq=False)
class Jet:
    """Enclosures of f, ∇f and ∇²f over boxes of ℝᵈ; S is any shape, boxes first."""

    value: Interval  # S
    grad: Interval  # S + (d,)
    hess: Interval  # S + (d, d)

    def __add__(self, other: Jet | Interval | float) -> Jet:
        if isinstance(other, Jet):
            return Jet(self.value + other.value, self.grad + other.grad, self.hess + other.hess)
        return Jet(self.value + other, self.grad, self.hess)

    def __mul__(self, other: Jet | Interval | float) -> Jet:
        if not isinstance(other, Jet):
            k = point(other)
            return Jet(self.value * k, self.grad * _tail(k, 1), self.hess * _tail(k, 2))
        a, b = self, other
        cross = _outer(a.grad, b.grad)
        return Jet(
            a.value * b.value,
            a.grad * _tail(b.value, 1) + b.grad * _tail(a.value, 1),
            a.hess * _tail(b.value, 2) + b.hess * _tail(a.value, 2) + cross + _transpose(cross),
        )

    def __getitem__(self, key: Any) -> Jet:
        return Jet(self.value[key], self.grad[key], self.hess[key])

    def above(self, other: Jet) -> Jet:
        """Both jets in one, this one's boxes first."""
        parts = zip(vars(self).values(), vars(other).values(), strict=True)
        return Jet(*(concatenate(a, b) for a, b in parts))

    def apply(self, slopes: Slopes) -> Jet:
        """f(g) for a scalar f, element by element."""
        f0, f1, f2 = slopes(self.value)
        square = _outer(self.grad, self.grad, same=True)
        return Jet(f0, self.grad * _tail(f1, 1), self.hess * _tail(f1, 2) + square * _tail(f2, 2))

    def affine(self, W: Interval | Vector, b: Interval | Vector) -> Jet:
        """W·f + b over the last axis of S."""
        *boxes, width, d = self.grad.shape
        rows = np.shape(point(W).lo)[0]
        flat = self.hess.reshape(*boxes, width, d * d)
        value = matmul(W, self.value[..., None])[..., 0]
        return Jet(value + b, matmul(W, self.grad), matmul(W, flat).reshape(*boxes, rows, d, d))

    def centred(self, middle: Jet, delta: Interval) -> Jet:
        """Intersect with the mean-value forms about the jet at the middle of the boxes.

        `delta` holds the boxes minus their middles, boxes + (d,).
        """
        extra = len(self.value.shape) - len(delta.shape) + 1
        step = delta.reshape(*delta.shape[:-1], *([1] * extra), delta.shape[-1])
        value = middle.value + (self.grad * step).sum()
        step = step.reshape(*step.shape[:-1], 1, step.shape[-1])
        grad = middle.grad + (self.hess * step).sum()
        return Jet(self.value.meet(value), self.grad.meet(grad), self.hess)


def _tail(v: Interval, axes: int) -> Interval:
    return v[(..., *[None] * axes)]


def _transpose(v: Interval) -> Interval:
    return Interval(np.swapaxes(v.lo, -1, -2), np.swapaxes(v.hi, -1, -2))


def _outer(a: Interval, b: Interval, same: bool = False) -> Interval:
    product = a[..., :, None] * b[..., None, :]
    if not same:
        return product
    square, diagonal = a.square(), np.eye(a.shape[-1], dtype=bool)
    return Interval(
        np.where(diagonal, square.lo[..., None], product.lo),
        np.where(diagonal, square.hi[..., None], product.hi),
    )


def coordinates(X: Interval) -> list[Jet]:
    """The coordinate functions over boxes (B, d): d jets with S = (B,)."""
    boxes, d = X.shape
    zero = point(np.zeros((boxes, d, d)))
    grads = [np.broadcast_to(row, (boxes, d)) for row in np.eye(d)]
    return [Jet(X[:, i], point(grads[i]), zero) for i in range(d)]


def chain(outer: Jet, inner: list[Jet]) -> Jet:
    """f(g₁, …, g_k): `outer` holds f in its own k variables, `inner` the g in z."""
    hess = [
        inner[i].hess * _tail(outer.grad[..., i], 2)
        + _outer(inner[i].grad, inner[i].grad, same=True) * _tail(outer.hess[..., i, i], 2)
        for i in range(len(inner))
    ]
    for i in range(len(inner)):
        for j in range(i):
            cross = _outer(inner[i].grad, inner[j].grad) * _tail(outer.hess[..., i, j], 2)
            hess += [cross, _transpose(cross)]
    grads = [inner[i].grad * _tail(outer.grad[..., i], 1) for i in range(len(inner))]
    return Jet(outer.value, reduce(lambda a, b: a + b, grads), reduce(lambda a, b: a + b, hess))


def constant(expr: sp.Expr) -> Interval:
    """A real constant expression, as an interval of shape ()."""
    return expression_values([expr], {})[0]


def expression_jets(
    expressions: list[sp.Expr], variables: dict[sp.Symbol, Jet]
) -> list[Jet | Interval]:
    """Jets of sympy expressions, common subexpressions once; constants stay intervals."""
    known: dict[sp.Expr, Jet | Interval] = dict(variables.items())
    return [fold(expr, _JETS, known) for expr in expressions]


def expression_values(
    expressions: list[sp.Expr], variables: dict[sp.Symbol, Interval]
) -> list[Interval]:
    """Values of sympy expressions, common subexpressions once."""
    known: dict[sp.Expr, Jet | Interval] = dict(variables.items())
    return [v for v in (fold(e, _JETS, known) for e in expressions) if isinstance(v, Interval)]


def _number(expr: sp.Expr) -> Interval | None:
    if isinstance(expr, sp.Rational):
        ball = arb(fmpq(int(expr.p), int(expr.q)))
        ends = [np.float64(float(end)) for end in (ball.lower(), ball.upper())]
        if ends[0] == ends[1]:
            return point(ends[0])
        return Interval(np.nextafter(ends[0], -np.inf), np.nextafter(ends[1], np.inf))
    if expr == sp.pi:
        return PI
    return point(1.0).exp() if expr == sp.E else None


def _jets_first(parts: list[Jet | Interval]) -> list[Any]:
    """Jets know how to combine with intervals, and not the other way round."""
    return sorted(parts, key=lambda part: isinstance(part, Interval))


def _power(expr: sp.Pow, walk: Callable[[sp.Expr], Jet | Interval]) -> Jet | Interval:
    base, exponent = expr.base, expr.exp
    if exponent.is_number:
        value, power = walk(base), constant(exponent)
        if isinstance(value, Interval):
            return _interval_power(value, exponent, power)
        return value.apply(lambda v: _power_slopes(v, exponent, power))
    logarithm, factor = walk(sp.log(base)), walk(exponent)
    scaled = factor * logarithm if isinstance(factor, Jet) else logarithm * factor
    return scaled.exp() if isinstance(scaled, Interval) else scaled.apply(_exp)


def _interval_power(base: Interval, exponent: sp.Expr, enclosure: Interval) -> Interval:
    if exponent.is_Integer:
        return base.power(int(exponent))
    if exponent == sp.Rational(1, 2):
        return base.sqrt()
    return (base.log() * enclosure).exp()


def _power_slopes(
    v: Interval, exponent: sp.Expr, enclosure: Interval
) -> tuple[Interval, Interval, Interval]:
    """(vᵖ, p vᵖ⁻¹, p(p−1) vᵖ⁻²)."""

    def power(shift: int) -> Interval:
        if exponent.is_Integer:
            p = int(exponent) - shift
            return point(np.zeros(v.shape)) if 0 <= int(exponent) < shift else v.power(p)
        if exponent == sp.Rational(1, 2):
            return v.sqrt() * v.power(-shift) if shift else v.sqrt()
        return (v.log() * (enclosure - float(shift))).exp()

    return power(0), enclosure * power(1), enclosure * (enclosure - 1.0) * power(2)


def sin_slopes(v: Interval) -> tuple[Interval, Interval, Interval]:
    """(sin, cos, −sin)."""
    s = v.sin()
    return s, v.cos(), -s


def _cos(v: Interval) -> tuple[Interval, Interval, Interval]:
    c = v.cos()
    return c, -v.sin(), -c


def _tan(v: Interval) -> tuple[Interval, Interval, Interval]:
    t = v.tan()
    slope = 1.0 + t.square()
    return t, slope, 2.0 * t * slope


def tanh_slopes(v: Interval) -> tuple[Interval, Interval, Interval]:
    """(tanh, 1 − t², −2t(1 − t²)) with t = tanh v.

    The bend −2t(1 − t²) is least at t = 1/√3 and greatest at −1/√3, monotone in between.
    """
    t = v.tanh()
    slope = 1.0 - t.square()
    ends = [2.0 * (end * (end * end - 1.0)) for end in (t.lo, t.hi)]
    error = 1e-15  # four roundings of numbers below 1, twice: at most 6 · 2⁻⁵³
    lo, hi = np.minimum(*ends) - error, np.maximum(*ends) + error
    turn, top = 0.5773502691896257, 0.7698003589195011  # 1/√3 and 4/(3√3), the latter rounded up
    near = 1e-12  # a turning point this close counts as inside
    lo = np.where((t.lo <= turn + near) & (t.hi >= turn - near), -top, lo)
    hi = np.where((t.lo <= -turn + near) & (t.hi >= -turn - near), top, hi)
    return t, slope, Interval(lo, hi)


def _exp(v: Interval) -> tuple[Interval, Interval, Interval]:
    e = v.exp()
    return e, e, e


def _log(v: Interval) -> tuple[Interval, Interval, Interval]:
    inverse = v.reciprocal()
    return v.log(), inverse, -inverse.square()


def _sinh(v: Interval) -> tuple[Interval, Interval, Interval]:
    s = v.sinh()
    return s, v.cosh(), s


def _cosh(v: Interval) -> tuple[Interval, Interval, Interval]:
    c = v.cosh()
    return c, v.sinh(), c


def _atan(v: Interval) -> tuple[Interval, Interval, Interval]:
    slope = (1.0 + v.square()).reciprocal()
    return v.atan(), slope, -2.0 * v * slope.square()


def _asin(v: Interval) -> tuple[Interval, Interval, Interval]:
    slope = (1.0 - v.square()).sqrt().reciprocal()
    return v.asin(), slope, v * slope.power(3)


def _acos(v: Interval) -> tuple[Interval, Interval, Interval]:
    _, f1, f2 = _asin(v)
    return v.acos(), -f1, -f2


def _asinh(v: Interval) -> tuple[Interval, Interval, Interval]:
    slope = (1.0 + v.square()).sqrt().reciprocal()
    return v.asinh(), slope, -v * slope.power(3)


def _acosh(v: Interval) -> tuple[Interval, Interval, Interval]:
    slope = (v.square() - 1.0).sqrt().reciprocal()
    return v.acosh(), slope, -v * slope.power(3)


def _atanh(v: Interval) -> tuple[Interval, Interval, Interval]:
    slope = (1.0 - v.square()).reciprocal()
    return v.atanh(), slope, 2.0 * v * slope.square()


#: (f, f′, f″) of every function of :data:`necc_casadi.symbolic.expressions.FUNCTIONS`.
_SLOPES: dict[str, Slopes] = {
    "sin": sin_slopes, "cos": _cos, "tan": _tan,
    "asin": _asin, "acos": _acos, "atan": _atan,
    "sinh": _sinh, "cosh": _cosh, "tanh": tanh_slopes,
    "asinh": _asinh, "acosh": _acosh, "atanh": _atanh,
    "exp": _exp, "log": _log,
}  # fmt: skip


def _function(name: str, v: Jet | Interval) -> Jet | Interval:
    """A function of a jet, or of an interval without its slopes."""
    if isinstance(v, Jet):
        return v.apply(_SLOPES[name])
    value: Interval = getattr(v, name)()
    return value


_JETS: Algebra[Jet | Interval] = Algebra(
    {name: partial(_function, name) for name in _SLOPES},
    number=_number,
    power=_power,
    add=lambda parts: total(_jets_first(parts)),
    multiply=lambda parts: product(_jets_first(parts)),
)
