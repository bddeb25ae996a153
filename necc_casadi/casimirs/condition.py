"""The Casimir condition ∇Cᵀ(Jcl − Rcl) = 0 (eq. CasimirCondition).

References
----------
van der Schaft (2017), chapter 7.
"""

from __future__ import annotations

from collections.abc import Sequence

import sympy as sp

from necc_casadi.model.closed_loop import ClosedLoop
from necc_casadi.symbolic.finite_field import NoFiniteFieldValue, values
from necc_casadi.symbolic.linear_algebra import generic_rank
from necc_casadi.symbolic.modular import rank
from necc_casadi.symbolic.zero import is_zero

__all__ = ["independent", "is_casimir", "rates"]


def rates(c: sp.Expr, loop: ClosedLoop) -> list[sp.Expr]:
    """Entries of ∇cᵀ(Jcl − Rcl); all vanish iff `c` is a Casimir."""
    free = c.free_symbols
    slopes = {i: sp.diff(c, s) for i, s in enumerate(loop.z) if s in free}
    totals: dict[int, list[sp.Expr]] = {}
    for (i, j), entry in loop.M.todok().items():
        if i in slopes:
            totals.setdefault(j, []).append(slopes[i] * entry)
    return [sp.Add(*totals.get(j, [])) for j in range(loop.n)]


def is_casimir(c: sp.Expr, loop: ClosedLoop) -> bool:
    """Whether `c` is proved to be a Casimir."""
    return all(is_zero(rate) is True for rate in rates(c, loop))


def independent(known: Sequence[sp.Expr], c: sp.Expr, z: Sequence[sp.Symbol]) -> bool:
    """Whether ∇c is independent of the gradients of `known` at generic points."""
    functions = [*known, c]
    jacobian = [
        sp.diff(f, s) if s in f.free_symbols else sp.Integer(0) for f in functions for s in z
    ]
    try:
        tables = values(jacobian, 2).reshape(2, len(functions), len(z))
    except NoFiniteFieldValue:
        return generic_rank(sp.Matrix(len(functions), len(z), jacobian)) == len(functions)
    return any(rank(t) == len(functions) for t in tables)
