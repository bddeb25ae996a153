"""Linear equations in one unknown at a time: most states of an equilibrium are of this kind."""

from __future__ import annotations

from collections.abc import Sequence

import sympy as sp

from necc_casadi.symbolic.zero import is_zero

__all__ = ["eliminated"]


def eliminated(
    equations: Sequence[sp.Expr], unknown: Sequence[sp.Symbol]
) -> tuple[dict[sp.Symbol, sp.Expr], list[sp.Expr]]:
    """What follows step by step, and the equations e = 0 that are left.

    Other symbols than the unknowns are parameters, of which values may be functions. What is left
    may hold a constant that is not 0: then there is no solution.
    """
    left, solved = [e for e in equations if e != 0], dict[sp.Symbol, sp.Expr]()
    while (step := _linear_step(left, unknown)) is not None:
        symbol, value = step
        solved = {s: v.subs(symbol, value) for s, v in solved.items()} | {symbol: value}
        left = [e for e in (sp.simplify(e.subs(symbol, value)) for e in left) if e != 0]
    return solved, left


def _linear_step(
    equations: Sequence[sp.Expr], unknown: Sequence[sp.Symbol]
) -> tuple[sp.Symbol, sp.Expr] | None:
    """An unknown that one equation gives, its coefficient a constant that is not 0."""
    for equation in equations:
        symbols = [s for s in unknown if equation.has(s)]
        if len(symbols) != 1:
            continue
        polynomial = equation.as_poly(symbols[0])
        if polynomial is None or polynomial.degree() != 1:
            continue
        a, b = polynomial.all_coeffs()
        if is_zero(a) is False and not a.free_symbols:
            return symbols[0], -b / a
    return None
