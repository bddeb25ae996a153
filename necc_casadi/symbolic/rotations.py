"""Rotations and directions in rational numbers: exactly orthogonal, exactly of length 1.

Of an angle, tan(θ/2) is a rational within 1e-15; of a direction, its stereographic projection.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from decimal import Decimal
from fractions import Fraction
from typing import Any

import numpy as np
import sympy as sp

__all__ = ["rational_rotation", "rational_unit"]


#: How far a rational may be from the tangent that it stands for.
_FINE = 1e-16


#: How near a quarter turn is one, whatever its digits.
_NEAR = 1e-9


def rational_rotation(axis: int, angle: Decimal) -> Any:
    """The rotation about a coordinate axis, 3 × 3."""
    quarters = round(2 * float(angle) / math.pi)
    rest = float(angle) - quarters * math.pi / 2
    rest = 0.0 if quarters and _is_quarter(angle, quarters, rest) else rest
    half = _rational(math.tan(rest / 2))
    cos, sin = (1 - half**2) / (1 + half**2), 2 * half / (1 + half**2)
    for _ in range(quarters % 4):
        cos, sin = -sin, cos
    rotation = np.array(sp.eye(3))
    i, j = (axis + 1) % 3, (axis + 2) % 3
    rotation[i, i], rotation[i, j], rotation[j, i], rotation[j, j] = cos, -sin, sin, cos
    return rotation


def _is_quarter(angle: Decimal, quarters: int, rest: float) -> bool:
    """Whether two decimals or more are those of quarter turns, rounded or cut off."""
    digits = -int(angle.as_tuple().exponent)
    if abs(rest) < _NEAR or not 2 <= digits <= 9:
        return abs(rest) < _NEAR
    meant = abs(quarters) * math.pi / 2 * 10**digits
    return int(abs(angle).scaleb(digits)) in {math.floor(meant), round(meant)}


def rational_unit(direction: Sequence[sp.Rational]) -> Any:
    """A unit vector of rationals along a direction, by its stereographic projection."""
    vector = np.array(direction, dtype=float)
    vector /= np.linalg.norm(vector)
    pole = int(np.argmax(abs(vector)))
    sides = [(pole + 1) % 3, (pole + 2) % 3]
    a, b = (_rational(vector[side] / (1 + abs(vector[pole]))) for side in sides)
    unit = np.array([sp.Integer(0)] * 3)
    unit[pole] = sp.Integer(int(np.sign(vector[pole]))) * (1 - a**2 - b**2)
    unit[sides] = 2 * a, 2 * b
    return unit / (1 + a**2 + b**2)


def _rational(value: float) -> sp.Rational:
    """A short rational that is as good as the float."""
    exactly = Fraction(value)
    tries = (exactly.limit_denominator(10**digits) for digits in range(1, 17))
    near = next((short for short in tries if abs(short - exactly) < _FINE), exactly)
    return sp.Rational(str(near))
