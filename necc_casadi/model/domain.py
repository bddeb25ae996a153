"""The box of states in which a design is looked at: the model's domain around a target."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import sympy as sp

from necc_casadi.arrays import Vector
from necc_casadi.model.closed_loop import ClosedLoop
from necc_casadi.model.sizes import REACH, natural_sizes
from necc_casadi.symbolic.pieces import Box, piece_around

__all__ = ["Domain", "domain_of", "exact_bounds", "sampling_box"]


@dataclass(frozen=True, eq=False)
class Domain:
    """A box of states."""

    lo: Vector  # (N,)
    hi: Vector  # (N,)

    def of(self, states: Sequence[int]) -> Domain:
        """The box of some of the states."""
        chosen = list(states)
        return Domain(self.lo[chosen], self.hi[chosen])


def domain_of(loop: ClosedLoop, z_star: Vector, size: Vector) -> Domain:
    """The box of all states (N,): the model's bounds; where it names none, z* ± 2 sizes."""
    lo, hi = z_star - REACH * size, z_star + REACH * size
    for index, name in enumerate(loop.states):
        if name in loop.plant.domain:
            lo[index], hi[index] = (float(bound) for bound in loop.plant.domain[name])
    return Domain(lo, hi)


def exact_bounds(
    loop: ClosedLoop, target: Mapping[sp.Symbol, sp.Expr]
) -> dict[sp.Symbol, tuple[sp.Expr, sp.Expr]]:
    """The same box in exact numbers; a state without a target of its own is taken around 0."""
    box = {}
    sizes = natural_sizes(loop, (), target)
    for symbol, size in zip(loop.z, sizes.units.state, strict=True):
        middle, half = (
            target.get(symbol, sp.Integer(0)),
            REACH * sp.Rational(*float(size).as_integer_ratio()),
        )
        around = (middle - half, middle + half)
        box[symbol] = loop.plant.domain.get(str(symbol), around)
    return box


def sampling_box(
    loop: ClosedLoop,
    expressions: Sequence[sp.Expr],
    target: Mapping[sp.Symbol, sp.Expr],
    reach: int = 1,
) -> tuple[Box, tuple[str, ...]]:
    """Where expressions are sampled, and what made that smaller than it was meant to be.

    The user's own bounds stay. Others are `reach` times as wide as :func:`exact_bounds`, and
    shrink towards the target until no pole and no branch point of the expressions is inside.
    """
    box = exact_bounds(loop, target)
    guessed = {s: v for s, v in target.items() if str(s) not in loop.plant.domain}
    named = {s: (lo + hi) / 2 for s, (lo, hi) in box.items() if s not in guessed}
    widths = {s: (hi - lo) / 2 * (reach if s in guessed else 1) for s, (lo, hi) in box.items()}
    piece = piece_around(expressions, {**named, **guessed}, widths)
    if piece is None:
        return box, ()
    limits = tuple(str(limit) for limit in piece.limits if limit.part.free_symbols & guessed.keys())
    return {**box, **{s: piece.box[s] for s in guessed}}, limits
