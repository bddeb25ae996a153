"""Outward-rounded intervals on NumPy arrays, with elementary functions of proved accuracy.

Only IEEE additions, multiplications, divisions and square roots are trusted (they are correctly
rounded; :func:`self_test` checks it). ``np.tanh`` and its kin promise no error bound, so exp, sin
and cos are computed here with an error that is bounded by hand, and everything else from them.

NaN stands for "nothing is known": it survives every operation and fails every comparison, so a
pole or a logarithm of a negative number makes a proof fail and never succeed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from necc_casadi.arrays import Vector

__all__ = ["PI", "Interval", "concatenate", "matmul", "point", "self_test", "stack"]


#: Unit roundoff of double precision.
UNIT = 2.0**-53


#: Bound of the relative error of :func:`_exp`. Horner's scheme on |r| ≤ 0.3466 loses at most 4
#: units, the coefficients 2, the reduced argument 1, the remainder of degree 14 less than 0.1.
EXP_ERROR = 16 * UNIT


#: Bound of the absolute error of :func:`_sin_cos`: reduction 3 units, Horner 4, coefficients 2.
SIN_ERROR = 20 * UNIT


#: Reduction modulo π/2 is accurate up to here; beyond it nothing is claimed.
SIN_RANGE = 1e5


#: Added to every rounding: covers underflow, and keeps slow subnormal numbers out.
TINY = 1e-150


def _down(x: Any) -> Any:
    """A lower bound of the real result that was rounded to x: |x|·2⁻⁵² is at least one ulp."""
    return x - (np.abs(x) * (2 * UNIT) + TINY)


def _up(x: Any) -> Any:
    return x + (np.abs(x) * (2 * UNIT) + TINY)


@dataclass(frozen=True, eq=False)
class Interval:
    """Arrays of real intervals [lo, hi], element by element; arithmetic rounds outwards."""

    lo: Vector
    hi: Vector

    __array_ufunc__ = None  # ndarray ∘ Interval is ours to evaluate

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the arrays."""
        return np.shape(self.lo)

    @property
    def mid(self) -> Vector:
        """A number inside each interval, near its middle."""
        middle: Vector = np.clip(self.lo + (self.hi - self.lo) / 2, self.lo, self.hi)
        return middle

    @property
    def rad(self) -> Vector:
        """Upper bound of the distance of :attr:`mid` from the ends."""
        mid = self.mid
        radius: Vector = _up(np.maximum(self.hi - mid, mid - self.lo))
        return radius

    @property
    def magnitude(self) -> Vector:
        """The largest absolute value."""
        return np.maximum(np.abs(self.lo), np.abs(self.hi))

    def __getitem__(self, key: Any) -> Interval:
        return Interval(np.asarray(self.lo)[key], np.asarray(self.hi)[key])

    def __neg__(self) -> Interval:
        return Interval(-self.hi, -self.lo)

    def __add__(self, other: Interval | Vector | float) -> Interval:
        other = point(other)
        return Interval(_down(self.lo + other.lo), _up(self.hi + other.hi))

    __radd__ = __add__

    def __sub__(self, other: Interval | Vector | float) -> Interval:
        return self + (-point(other))

    def __rsub__(self, other: Interval | Vector | float) -> Interval:
        return (-self) + other

    def __mul__(self, other: Interval | Vector | float) -> Interval:
        if isinstance(other, float) and other in (1.0, -1.0):
            return self if other == 1.0 else -self
        other = point(other)
        a, b = self.lo * other.lo, self.lo * other.hi
        c, d = self.hi * other.lo, self.hi * other.hi
        low = np.minimum(np.minimum(a, b), np.minimum(c, d))
        high = np.maximum(np.maximum(a, b), np.maximum(c, d))
        return Interval(_down(low), _up(high))

    __rmul__ = __mul__

    def __truediv__(self, other: Interval | Vector | float) -> Interval:
        return self * point(other).reciprocal()

    def __rtruediv__(self, other: Interval | Vector | float) -> Interval:
        return point(other) * self.reciprocal()

    def reciprocal(self) -> Interval:
        """1/x; unknown where the interval contains 0."""
        free = (self.lo > 0) | (self.hi < 0)
        lo, hi = np.where(free, self.lo, np.nan), np.where(free, self.hi, np.nan)
        return Interval(_down(1 / hi), _up(1 / lo))

    def square(self) -> Interval:
        """x², never negative."""
        a, b = self.lo * self.lo, self.hi * self.hi
        low = np.where((self.lo <= 0) & (self.hi >= 0), 0.0, _down(np.minimum(a, b)))
        return Interval(np.maximum(low, 0.0), _up(np.maximum(a, b)))

    def power(self, exponent: int) -> Interval:
        """The box to an integer power."""
        if exponent < 0:
            return self.power(-exponent).reciprocal()
        if exponent == 0:
            return point(np.ones(self.shape)) + 0.0 * self
        if exponent % 2 == 0:
            return self.power(exponent // 2).square()
        return self if exponent == 1 else self._odd_power(exponent)

    def _odd_power(self, exponent: int) -> Interval:
        lo, hi = Interval(self.lo, self.lo), Interval(self.hi, self.hi)
        return Interval(
            (lo * lo.power(exponent - 1)).lo, (hi * hi.power(exponent - 1)).hi
        )  # odd powers increase

    def meet(self, other: Interval) -> Interval:
        """The intersection of two enclosures of the same numbers."""
        return Interval(np.maximum(self.lo, other.lo), np.minimum(self.hi, other.hi))

    def sum(self, axis: int = -1) -> Interval:
        """The sum along one axis."""
        gamma = 2 * (self.shape[axis] + 2) * UNIT
        slack = _up(gamma * np.abs(self.lo).sum(axis)), _up(gamma * np.abs(self.hi).sum(axis))
        return Interval(_down(self.lo.sum(axis) - slack[0]), _up(self.hi.sum(axis) + slack[1]))

    def reshape(self, *shape: int) -> Interval:
        """The same intervals in another shape."""
        return Interval(np.reshape(self.lo, shape), np.reshape(self.hi, shape))

    # --- elementary functions -----------------------------------------------------------------

    def sqrt(self) -> Interval:
        """√x; unknown where x may be negative."""
        valid = self.lo >= 0
        lo, hi = (
            np.sqrt(np.where(valid, self.lo, np.nan)),
            np.sqrt(np.where(valid, self.hi, np.nan)),
        )
        return Interval(np.maximum(_down(lo), 0.0), _up(hi))

    def exp(self) -> Interval:
        """eˣ."""
        return self._increasing(_exp)

    def log(self) -> Interval:
        """The natural logarithm; unknown unless x > 0."""
        return self._increasing(_log)

    def tanh(self) -> Interval:
        """Hyperbolic tangent of x."""
        return self._increasing(_tanh)

    def sinh(self) -> Interval:
        """Hyperbolic sine of x."""
        return self._increasing(lambda x: (_exp(x) - _exp(-x)) * 0.5)

    def cosh(self) -> Interval:
        """Hyperbolic cosine of x, from the end nearest to 0 to the end farthest from it."""
        near = np.where(
            (self.lo <= 0) & (self.hi >= 0), 0.0, np.minimum(abs(self.lo), abs(self.hi))
        )
        return Interval(np.where(np.isnan(self.lo), np.nan, near), self.magnitude)._increasing(
            lambda x: (_exp(x) + _exp(-x)) * 0.5
        )

    def sin(self) -> Interval:
        """Sine of x."""
        return self._periodic(0.5, lambda x: _sin_cos(x)[0])

    def cos(self) -> Interval:
        """Cosine of x."""
        return self._periodic(0.0, lambda x: _sin_cos(x)[1])

    def tan(self) -> Interval:
        """Tangent of x; unknown where a pole may be inside."""
        cosine = self.cos()
        free = (cosine.lo > 0) | (cosine.hi < 0)
        # the ends as they are: moved outwards by a rounding they might lie beyond a pole
        lo, hi = np.where(free, self.lo, np.nan), np.where(free, self.hi, np.nan)
        return Interval(lo, hi)._increasing(_tan)

    def atan(self) -> Interval:
        """Arc tangent of x."""
        return self._increasing(_atan)

    def asin(self) -> Interval:
        """Arc sine of x; unknown unless |x| < 1."""
        return self._increasing(_asin)

    def acos(self) -> Interval:
        """Arc cosine of x; unknown unless |x| < 1."""
        return HALF_PI - self.asin()

    def asinh(self) -> Interval:
        """Inverse of sinh."""
        return self._increasing(_asinh)

    def acosh(self) -> Interval:
        """Inverse of cosh on x > 1."""
        return self._increasing(lambda x: _log_of(point(x) + (point(x).square() - 1.0).sqrt()))

    def atanh(self) -> Interval:
        """Inverse of tanh; unknown unless |x| < 1."""
        return self._increasing(lambda x: _log_of((1.0 + point(x)) / (1.0 - point(x))) * 0.5)

    def _increasing(self, f: Callable[[Vector], Interval]) -> Interval:
        """Image under an increasing function that encloses its value at given numbers."""
        lo, hi = f(np.asarray(self.lo)).lo, f(np.asarray(self.hi)).hi
        # an end at which the function has no value leaves nothing known at the other end either
        unknown = np.isnan(lo) | np.isnan(hi)
        return Interval(np.where(unknown, np.nan, lo), np.where(unknown, np.nan, hi))

    def _periodic(self, phase: float, f: Callable[[Vector], Interval]) -> Interval:
        """Image under cos(x − phase·π), whose extrema lie at (k + phase)·π."""
        left, right = f(np.asarray(self.lo)), f(np.asarray(self.hi))
        slack = 1e-9  # in half periods; larger than any rounding below SIN_RANGE
        first = np.ceil(self.lo / np.pi - phase - slack)
        last = np.floor(self.hi / np.pi - phase + slack)
        odd_first = np.where(first % 2 == 1, first, first + 1)
        even_first = np.where(first % 2 == 0, first, first + 1)
        lo = np.where(odd_first <= last, -1.0, np.minimum(left.lo, right.lo))
        hi = np.where(even_first <= last, 1.0, np.maximum(left.hi, right.hi))
        known = np.isfinite(left.lo + right.lo)
        return Interval(
            np.where(known, np.maximum(lo, -1.0), np.nan),
            np.where(known, np.minimum(hi, 1.0), np.nan),
        )


def point(value: Interval | Vector | float) -> Interval:
    """Numbers as intervals of no width; intervals as they are."""
    if isinstance(value, Interval):
        return value
    array = np.asarray(value, dtype=float)
    return Interval(array, array)


def stack(parts: list[Interval], axis: int = -1) -> Interval:
    """Intervals of one shape along a new axis."""
    shape = np.broadcast_shapes(*[part.shape for part in parts])
    return Interval(
        np.stack([np.broadcast_to(part.lo, shape) for part in parts], axis),
        np.stack([np.broadcast_to(part.hi, shape) for part in parts], axis),
    )


def concatenate(a: Interval, b: Interval) -> Interval:
    """Two arrays of intervals, one after the other along the first axis."""
    return Interval(np.concatenate([a.lo, b.lo]), np.concatenate([a.hi, b.hi]))


def matmul(W: Interval | Vector, v: Interval) -> Interval:
    """W·v over the last axis but one of `v`: (h, k) by (…, k, d) to (…, h, d).

    Midpoints and radii go through ordinary matrix products; the error of a dot product of length
    k is at most γₖ|W||v| in any order of summation, also with fused operations.
    """
    W = point(W)
    mid = v.mid
    rad = _up(np.maximum(v.hi - mid, mid - v.lo))
    absolute = np.abs(W.mid) + W.rad
    gamma = 4 * (W.shape[-1] + 4) * UNIT
    center = W.mid @ mid
    radius = absolute @ rad + W.rad @ np.abs(mid) + gamma * (absolute @ (np.abs(mid) + rad))
    radius = radius * (1 + gamma) + TINY  # rounding of the radius itself, and underflow
    return Interval(_down(center - radius), _up(center + radius))


_LN2_HIGH = float.fromhex("0x1.62e42fee00000p-1")  # 33 bits: k·_LN2_HIGH is exact for |k| < 2²⁰


_LN2_LOW = float.fromhex("0x1.a39ef35793c76p-33")  # ln 2 − _LN2_HIGH, rounded


_EXP_TERMS = [1.0]
for _k in range(1, 15):
    _EXP_TERMS.append(_EXP_TERMS[-1] / _k)


_PI_HALF = (
    float.fromhex("0x1.921fb54400000p+0"),  # 33 bits of π/2
    float.fromhex("0x1.0b4611a600000p-34"),  # the next 33
    float.fromhex("0x1.3198a2e037073p-69"),  # the rest, rounded
)


_SIN_TERMS = [1.0]


_COS_TERMS = [1.0]
for _k in range(1, 10):
    _SIN_TERMS.append(-_SIN_TERMS[-1] / ((2 * _k) * (2 * _k + 1)))
    _COS_TERMS.append(-_COS_TERMS[-1] / ((2 * _k - 1) * (2 * _k)))


#: π and π/2, between neighbouring doubles.
PI = Interval(np.float64(np.pi), _up(np.float64(np.pi)))  # type: ignore[arg-type]


HALF_PI = Interval(PI.lo / 2, PI.hi / 2)


def _horner(terms: list[float], x: Vector) -> Vector:
    value = np.full(np.shape(x), terms[-1])
    for term in reversed(terms[:-1]):
        value = value * x + term
    return value


def _exp(x: Vector) -> Interval:
    """eˣ with relative error at most :data:`EXP_ERROR`; one-sided beyond ±700."""
    inside = np.clip(x, -700.0, 700.0)
    k = np.rint(inside / np.log(2.0))
    value = np.ldexp(
        _horner(_EXP_TERMS, (inside - k * _LN2_HIGH) - k * _LN2_LOW),
        np.where(np.isnan(k), 0, k).astype(int),
    )
    lo, hi = _down(value * (1 - EXP_ERROR)), _up(value * (1 + EXP_ERROR))
    return Interval(np.where(x < -700, 0.0, lo), np.where(x > 700, np.inf, hi))


def _sin_cos(x: Vector) -> tuple[Interval, Interval]:
    """Sine and cosine of x with absolute error at most :data:`SIN_ERROR`; NaN out of range."""
    inside = np.where(np.abs(x) <= SIN_RANGE, x, np.nan)
    k = np.rint(inside / (np.pi / 2))
    r = ((inside - k * _PI_HALF[0]) - k * _PI_HALF[1]) - k * _PI_HALF[2]
    square = r * r
    sine, cosine = r * _horner(_SIN_TERMS, square), _horner(_COS_TERMS, square)
    quarter = np.where(np.isnan(k), 0, k).astype(int) % 4
    s = np.choose(quarter, [sine, cosine, -sine, -cosine])
    c = np.choose(quarter, [cosine, -sine, -cosine, sine])
    return _widened(s), _widened(c)


def _widened(value: Vector) -> Interval:
    lo, hi = _down(value - SIN_ERROR), _up(value + SIN_ERROR)
    return Interval(np.maximum(lo, -1.0), np.minimum(hi, 1.0))


def _tan(x: Vector) -> Interval:
    sine, cosine = _sin_cos(x)
    return sine / cosine


def _asinh(x: Vector) -> Interval:
    """An odd function: for x < 0 the sum x + √(x² + 1) would cancel."""
    size = point(np.abs(x))
    value = _log_of(size + (size.square() + 1.0).sqrt())
    return Interval(np.where(x < 0, -value.hi, value.lo), np.where(x < 0, -value.lo, value.hi))


def _tanh(x: Vector) -> Interval:
    value = 1.0 - 2.0 * (_exp(2.0 * np.asarray(x)) + 1.0).reciprocal()
    return Interval(np.maximum(value.lo, -1.0), np.minimum(value.hi, 1.0))


def _log(x: Vector) -> Interval:
    """Logarithm: ln x = y + ln w, w = x·e⁻ʸ near 1 for any guess y; 1 − 1/w ≤ ln w ≤ w − 1."""
    x = np.where(x > 0, x, np.nan)
    y = np.log(x)
    w = x * _exp(-y)
    return point(y) + Interval((1.0 - w.reciprocal()).lo, (w - 1.0).hi)


def _log_of(x: Interval) -> Interval:
    return Interval(_log(x.lo).lo, _log(x.hi).hi)


def _atan(x: Vector) -> Interval:
    """Arc tangent as y + atan t with tan(atan x − y) = t for any guess y near it; |atan t| ≤ |t|.

    cos y + x sin y > 0 says that atan x − y is within ±π/2, where the tangent is one-to-one.
    """
    y = np.arctan(x)
    sine, cosine = _sin_cos(y)
    denominator = cosine + x * sine
    t = (x * cosine - sine) / Interval(
        np.where(denominator.lo > 0, denominator.lo, np.nan), denominator.hi
    )
    return point(y) + Interval(np.minimum(t.lo, 0.0), np.maximum(t.hi, 0.0))


def _asin(x: Vector) -> Interval:
    ratio = x / (1.0 - point(x).square()).sqrt()
    return Interval(_atan(ratio.lo).lo, _atan(ratio.hi).hi)


@cache
def self_test() -> bool:
    """Whether this machine rounds to nearest and keeps subnormal numbers, as the proofs assume."""
    one, half_ulp = np.ones(1), np.full(1, UNIT)
    third = one / np.full(1, 3.0)
    return bool(
        (one + half_ulp == 1.0)[0]
        and (one + 3 * half_ulp == 1.0 + 4 * UNIT)[0]
        and (-one - half_ulp == -1.0)[0]
        and (third == float.fromhex("0x1.5555555555555p-2"))[0]
        and (np.sqrt(np.full(1, 2.0)) == float.fromhex("0x1.6a09e667f3bcdp+0"))[0]
        and (np.full(1, 2.0**-1073) / 2 > 0)[0]
    )
