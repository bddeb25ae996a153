"""A matched target structure as a plant with feedback ahead of the loop."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import sympy as sp

from necc_casadi.model.matching import Matching
from necc_casadi.model.modulated import System
from necc_casadi.model.plant import Plant
from necc_casadi.symbolic.derivatives import at
from necc_casadi.symbolic.floats import to_float

__all__ = ["plant_with_feedback"]


#: Digits of the constant by which ũ is measured: it only has to be near.
_DIGITS = 3


def plant_with_feedback(
    matching: Matching, x_star: Mapping[sp.Symbol, sp.Expr], like: System
) -> tuple[Plant, tuple[sp.Expr, ...]]:
    """The target structure with its feedback, ũ in the unit of u, and its known γ.

    With C near B(x*), ũ = C⁻¹w turns G_d, B and γ into G_dC⁻¹, BC⁻¹ and γC⁻¹, and the gain is
    near 1 at the target: sizes and limits of u are those of w. Limits, sizes and domain are those
    of the plant as the user gives it.
    """
    inverse = _scale(matching, x_star).inv()
    G = sp.ImmutableMatrix(matching.plant.G * inverse)
    gain = sp.ImmutableMatrix(matching.gain * inverse)
    origin = like if isinstance(like, Plant) else None
    ahead = replace(matching.ahead, gain=gain, origin=origin)
    plant = replace(
        matching.plant,
        G=G,
        preliminary=ahead,
        domain=like.domain,
        u_limits=like.u_limits,
        sizes=like.sizes,
        inputs=like.inputs,
        inertia=None if origin is None else origin.inertia,
    )
    gammas = sp.Matrix([list(matching.shaping)]) * inverse if matching.shaping else ()
    return plant, tuple(gammas)


def _scale(matching: Matching, x_star: Mapping[sp.Symbol, sp.Expr]) -> sp.Matrix:
    """B(x*) in a few digits; 1 where it is singular."""
    there = at(matching.gain, x_star)
    values = np.array([[to_float(e) for e in row] for row in there.tolist()], float)
    if not np.isfinite(values).all() or np.linalg.matrix_rank(values) < len(values):
        return sp.eye(len(values))
    return sp.Matrix(
        len(values), len(values), lambda i, j: sp.Rational(f"{values[i, j]:.{_DIGITS}g}")
    )
