"""Points that fill a box evenly.

References
----------
Halton (1960).
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from necc_casadi.arrays import Vector

__all__ = ["quasi_random"]


_PRIMES = (2, 3, 5, 7, 11, 13, 17, 19, 23, 29, 31, 37)


def quasi_random(count: int, d: int, seed: int) -> Vector:
    """Halton points of the unit cube, shifted modulo one by a random vector, (count, d).

    Beyond the twelfth axis, where Halton points line up, the points are random.
    """
    rng = np.random.default_rng(seed)
    shift = rng.uniform(size=d)
    indices = np.arange(1, count + 1)
    points = rng.uniform(size=(count, d))
    for axis, prime in zip(range(d), _PRIMES, strict=False):
        points[:, axis] = (_radical_inverse(indices, prime) + shift[axis]) % 1.0
    return points


def _radical_inverse(indices: npt.NDArray[np.int_], base: int) -> Vector:
    """The digits of the indices mirrored at the point."""
    result, place, rest = np.zeros(len(indices)), 1.0 / base, indices.copy()
    while rest.any():
        result += place * (rest % base)
        rest //= base
        place /= base
    return result
