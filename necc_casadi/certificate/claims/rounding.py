"""Straight-line programs of the C code as data, and what is assumed of its elementary functions.

Both the prover and the checker bound the rounding of the code by these, each in its arithmetic.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

__all__ = [
    "ACTIVATIONS",
    "CONSTANTS",
    "LIBRARY",
    "MOST_SINE",
    "UNARY",
    "ActivationErrors",
    "Number",
    "Program",
    "Step",
]


#: The type of the numbers in the C code.
Number = Literal["double", "float"]


#: An operation, the places of what it takes, and a constant's value: inputs have the first places,
#: each step has the next one.
Step = tuple[str, tuple[int, ...], float]


#: Functions of the C library that a program may call, and `neg`, `square` and `sqrt`.
UNARY = (
    "sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "asinh", "acosh", "atanh",
    "exp", "log",
)  # fmt: skip


#: Errors of these, in units in the last place: more than the manual of the GNU C library lists for
#: any of them in either type on x86-64 and ARM.
LIBRARY = 4.0


#: How far a constant of a program is from the law's, relatively: it may be a product of several.
CONSTANTS = 2.0**-49


@dataclass(frozen=True)
class Program:
    """Operations of a function of the C code, in the units of the model.

    `add`, `sub`, `mul`, `div` take two places, the others one, `const` none.
    """

    inputs: int
    steps: tuple[Step, ...]
    outputs: tuple[int, ...]


@dataclass(frozen=True)
class ActivationErrors:
    """Errors of the code's own activations, in spacings ε of the numbers next to 1."""

    value: float  # of σ, times its size where that is no bound of 1
    slope: float  # of σ′
    curvature: float  # an upper bound of |σ″|, exactly


#: tanh_float.c, sin_float.c and the others, as export/networks.py has them: measured at every
#: float, and in double at the points of a sweep, so that twice as much is assumed there.
ACTIVATIONS: Mapping[tuple[str, Number], ActivationErrors] = {
    ("tanh", "float"): ActivationErrors(2.16, 3.64, 0.77),
    ("tanh", "double"): ActivationErrors(6.0, 12.0, 0.77),
    ("sin", "float"): ActivationErrors(0.92, 0.92, 1.0),
    ("sin", "double"): ActivationErrors(3.0, 3.0, 1.0),
    ("squareplus", "float"): ActivationErrors(2.0, 2.0, 0.25),
    ("squareplus", "double"): ActivationErrors(2.0, 2.0, 0.25),
}


#: Arguments up to which the error of sin is known.
MOST_SINE = 100.0
