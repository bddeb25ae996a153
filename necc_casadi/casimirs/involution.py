"""How many Casimirs exist: n + nc − dim(involutive closure of the columns of Jcl − Rcl).

Iterated Lie brackets are formed symbolically, and only those that raise the rank at random
points are kept. Rank at one point bounds the generic rank from below, hence the number of
Casimirs from above; the final rank is proved with Arb balls at a real point.

References
----------
Nijmeijer and van der Schaft (1990), Frobenius' theorem.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import sympy as sp

from necc_casadi.symbolic.arb import real_rank
from necc_casadi.symbolic.expressions import complexity
from necc_casadi.symbolic.finite_field import NoFiniteFieldValue, values
from necc_casadi.symbolic.modular import pivots, rank
from necc_casadi.symbolic.pieces import Box

__all__ = ["closure", "count_casimirs"]


Field = tuple[sp.Expr, ...]  # components of a vector field


_POINTS = 2


_MOST_BRACKETS = 4000


def count_casimirs(
    M: sp.Matrix, z: Sequence[sp.Symbol], known: int, box: Box | None = None
) -> tuple[int, bool]:
    """(number of Casimirs, whether it is proved that there are no more).

    Parameters
    ----------
    M
        Jcl − Rcl.
    known
        Number of independent Casimirs in hand: the search for brackets stops there.
    box
        Where the rank is to be proved: the analytic piece of interest; None: at any real point.
    """
    fields, complete = closure(M, z, len(z) - known)
    table = sp.Matrix([list(f) for f in fields]) if fields else sp.zeros(0, len(z))
    proved = real_rank(table, z, len(fields), box=box) if fields else True
    return len(z) - len(fields), proved and complete


def closure(M: sp.Matrix, z: Sequence[sp.Symbol], largest: int) -> tuple[list[Field], bool]:
    """Independent fields that span the involutive closure of the columns of `M` generically.

    The flag is False where the search was cut short or could not be evaluated; the fields then
    span a part of the closure only.
    """
    columns = [tuple(M[:, j]) for j in range(M.cols)]
    columns.sort(key=lambda f: (not constant(f), sum(map(complexity, f))))
    try:
        kept = _independent(columns)
        tried: set[tuple[int, int]] = set()
        while len(kept) < largest:
            fresh = [(i, j) for i, j in combinations(range(len(kept)), 2) if (i, j) not in tried]
            if not fresh:
                return kept, True
            tried.update(fresh)
            fresh = [(i, j) for i, j in fresh if not (constant(kept[i]) and constant(kept[j]))]
            brackets = [lie_bracket(kept[i], kept[j], z) for i, j in fresh]
            brackets = [b for b in brackets if any(e != 0 for e in b)]
            brackets.sort(key=lambda b: sum(map(complexity, b)))
            larger = _independent(kept + brackets)
            if len(larger) > largest:
                larger = larger[:largest]
            kept = larger
            if len(tried) > _MOST_BRACKETS:
                return kept, False
    except NoFiniteFieldValue:
        return [], False
    return kept, True


def constant(f: Field) -> bool:
    """Whether a field does not depend on the state: two such fields commute."""
    return not any(e.free_symbols for e in f)


def _independent(fields: Sequence[Field]) -> list[Field]:
    """The fields that are independent of those before them, at a random point."""
    if not fields:
        return []
    size = len(fields[0])
    flat = [e for f in fields for e in f]
    tables = [t.reshape(len(fields), size) for t in values(flat, _POINTS)]
    best = max(tables, key=rank)
    return [fields[i] for i in pivots(best.T)]


def lie_bracket(f: Field, g: Field, z: Sequence[sp.Symbol]) -> Field:
    """[f, g] = (∂g/∂z) f − (∂f/∂z) g."""
    along_f = _derivative(g, f, z)
    along_g = _derivative(f, g, z)
    return tuple(a - b for a, b in zip(along_f, along_g, strict=True))


def _derivative(f: Field, along: Field, z: Sequence[sp.Symbol]) -> list[sp.Expr]:
    moving = [(s, a) for s, a in zip(z, along, strict=True) if a != 0]
    result: list[sp.Expr] = []
    for entry in f:
        free = entry.free_symbols
        result.append(sp.Add(*[sp.diff(entry, s) * a for s, a in moving if s in free]))
    return result
