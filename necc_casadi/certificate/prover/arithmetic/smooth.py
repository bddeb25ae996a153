"""Where the expressions of a design are defined and smooth, as they were written, over boxes.

A derivative may hide a pole or a kink of what was differentiated (d/dq atan(tan q) = 1), so the
parts of the original expressions are looked at before any derivative is.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import product

import numpy as np
import sympy as sp

from necc_casadi.arrays import Vector
from necc_casadi.certificate.prover.arithmetic.boxes import subdivide
from necc_casadi.certificate.prover.arithmetic.intervals import Interval, point
from necc_casadi.certificate.prover.arithmetic.jets import expression_values
from necc_casadi.designs.design import Design
from necc_casadi.symbolic.smoothness import Condition, conditions, periodic

__all__ = ["ends_at", "holds_everywhere", "is_smooth_everywhere", "is_smooth_on", "written"]


#: Cells on which a condition is looked at, in all; symbols of one whose corners are looked at.
_CELLS, _CORNERS = 4096, 8

#: A little more than one period of sine and cosine.
_PERIOD = (0.0, 6.2832)


def written(design: Design) -> list[sp.Expr]:
    """H, the entries of the loop's matrices and the Casimirs, undifferentiated."""
    entries = [e for matrix in design.loop.matrices for e in matrix.todok().values()]
    ahead = design.loop.plant.preliminary
    if ahead is not None:
        entries += [*ahead.f, *ahead.g, *ahead.u0, *ahead.gain]
    return [design.loop.plant.H, *entries, *design.loop.gamma, *design.casimirs.functions]


def is_smooth_on(
    expressions: Iterable[sp.Expr], symbols: Sequence[sp.Symbol], box: Interval
) -> bool:
    """Whether every part of the expressions is proved to be smooth on a box (N,) of the symbols."""
    demands = conditions(expressions)
    if demands is None:
        return False
    sides = {s: box[i] for i, s in enumerate(symbols)}
    return all(_holds(demand, sides, set(symbols)) for demand in demands)


def is_smooth_everywhere(
    expressions: Iterable[sp.Expr],
    symbols: Sequence[sp.Symbol],
    within: Mapping[sp.Symbol, Interval] | None = None,
) -> bool:
    """Whether every part of the expressions is proved to be smooth for all real values.

    Symbols of which only sines and cosines occur are cut into cells of one period; the others
    are unbounded intervals. What else the expressions contain stays `within` its range.
    """
    demands = conditions(expressions)
    return demands is not None and all(
        holds_everywhere(demand, symbols, within) for demand in demands
    )


def holds_everywhere(
    demand: Condition,
    symbols: Sequence[sp.Symbol],
    within: Mapping[sp.Symbol, Interval] | None = None,
) -> bool:
    """Whether one condition is proved for all real values."""
    line, period = Interval(np.array(-np.inf), np.array(np.inf)), Interval(*map(np.array, _PERIOD))
    turning, ranges = periodic([demand], symbols), dict(within or {})
    sides = {s: period if s in turning else line for s in symbols} | ranges
    return _holds(demand, sides, turning | set(ranges))


def ends_at(
    expressions: Iterable[sp.Expr], symbols: Sequence[sp.Symbol], at: Vector, half: Vector
) -> bool:
    """Whether a part of the expressions is proved to have a pole or a kink near a place (N,).

    In the box of these half-widths, what must not vanish has both signs, or what must be positive
    is negative. A zero without a change of sign is not found.
    """
    places = dict(zip(symbols, zip(at, half, strict=True), strict=True))
    for demand in conditions(expressions) or ():
        used = sorted(demand.part.free_symbols, key=str)
        if not 0 < len(used) <= _CORNERS:
            continue
        signs = np.array(list(product((-1.0, 1.0), repeat=len(used))))
        variables = {
            s: point(places[s][0] + places[s][1] * signs[:, k]) for k, s in enumerate(used)
        }
        with np.errstate(all="ignore"):
            (value,) = expression_values([demand.part], variables)
        if (value.hi < 0).any() and (demand.positive or (value.lo > 0).any()):
            return True
    return False


def _holds(demand: Condition, sides: dict[sp.Symbol, Interval], cut: set[sp.Symbol]) -> bool:
    """Whether a condition holds on a box, on each cell of the symbols that are cut."""
    used = sorted(demand.part.free_symbols, key=str)
    split = [s for s in used if s in cut]
    parts = int(_CELLS ** (1 / max(1, len(split))))
    ends = [sides[s] for s in split]
    whole = Interval(np.array([e.lo for e in ends]), np.array([e.hi for e in ends]))
    with np.errstate(all="ignore"):
        cells = subdivide(whole, parts)
        variables = {s: cells[:, i] for i, s in enumerate(split)}
        variables |= {s: sides[s] for s in used if s not in cut}
        (value,) = expression_values([demand.part], variables)
        positive = value.lo > 0
        return bool((positive if demand.positive else positive | (value.hi < 0)).all())
