"""Where an expression is defined and smooth: what has to hold of its parts, as plain data.

sympy simplifies poles and kinks away (d/dq atan(tan q) = 1), so that a derivative says nothing of
them. Every part of the expression as it was written makes a condition instead; where all of them
hold over a connected set, the expression is one real-analytic function there.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import sympy as sp

from necc_casadi.symbolic.zero import is_zero, sign

__all__ = ["Condition", "conditions", "is_analytic_at", "periodic", "without_hidden_zeros"]


@dataclass(frozen=True)
class Condition:
    """That `part` is positive, or else that it is not zero."""

    part: sp.Expr
    positive: bool

    def __str__(self) -> str:
        return f"{self.part} {'> 0' if self.positive else '≠ 0'}"


#: Functions that are smooth on the whole real line.
_ENTIRE = (sp.sin, sp.cos, sp.sinh, sp.cosh, sp.tanh, sp.exp, sp.atan, sp.asinh)


def conditions(expressions: Iterable[sp.Expr]) -> tuple[Condition, ...] | None:
    """What must hold of the parts of the expressions; None where a part is nowhere smooth."""
    found: dict[Condition, None] = {}
    seen: set[sp.Expr] = set()
    todo: list[sp.Expr] = [sp.sympify(e) for e in expressions]
    while todo:
        part = todo.pop()
        if part in seen or part.is_Atom:
            continue
        seen.add(part)
        demands = _demands(part)
        if demands is None:
            return None
        found.update(dict.fromkeys(demands))
        todo.extend(part.args)
    return tuple(found)


def _demands(part: sp.Expr) -> list[Condition] | None:
    """The conditions of one operation on its arguments; None for one that is not known."""
    if part.is_Add or part.is_Mul or isinstance(part, _ENTIRE):
        return []
    if isinstance(part, sp.Pow):
        return _of_power(part.base, part.exp)
    argument = part.args[0] if len(part.args) == 1 else None
    if argument is None:
        return None
    if isinstance(part, sp.log):
        return [Condition(argument, True)]
    if isinstance(part, sp.tan):
        return [Condition(sp.cos(argument), False)]
    if isinstance(part, (sp.asin, sp.acos, sp.atanh)):
        return [Condition(1 - argument, True), Condition(1 + argument, True)]
    if isinstance(part, sp.acosh):
        return [Condition(argument - 1, True)]
    return None


def _of_power(base: sp.Expr, exponent: sp.Expr) -> list[Condition]:
    if exponent.is_Integer:
        return [] if exponent >= 0 else [Condition(base, False)]
    return [Condition(base, True)]


def is_analytic_at(expressions: Iterable[sp.Expr], point: Mapping[sp.Symbol, sp.Expr]) -> bool:
    """Whether all parts of the expressions are proved to be analytic near an exact point."""
    demands = conditions(expressions)
    if demands is None:
        return False
    signs = ((demand, sign(demand.part.subs(point))) for demand in demands)
    return all(kind == 1 or (kind == -1 and not demand.positive) for demand, kind in signs)


def without_hidden_zeros(expr: sp.Expr) -> sp.Expr:
    """`expr` without the sums of exponentials that are identically zero, for all real values.

    In floating point their terms overflow, or leave a rest. A sum that is not smooth everywhere
    stays, since it is not 0 where it has no value.
    """
    growing = (sp.exp, sp.sinh, sp.cosh)
    sums = [part for part in sp.preorder_traversal(expr) if part.is_Add and part.has(*growing)]
    gone = {s: sp.Integer(0) for s in sums if conditions([s]) == () and is_zero(s) is True}
    return expr.xreplace(gone) if gone else expr


def periodic(demands: Iterable[Condition], symbols: Iterable[sp.Symbol]) -> set[sp.Symbol]:
    """Symbols that all conditions contain in sin and cos of integer multiples alone.

    One period of such a symbol, [0, 2π], stands for the whole line.
    """
    parts = [demand.part for demand in demands]
    return {
        s
        for s in symbols
        if any(part.has(s) for part in parts) and all(_turns(part, s) for part in parts)
    }


def _turns(part: sp.Expr, s: sp.Symbol) -> bool:
    angles = {
        f: sp.Dummy() for f in part.atoms(sp.sin, sp.cos) if _coefficient(f.args[0], s) is not None
    }
    return not part.xreplace(angles).has(s)


def _coefficient(angle: sp.Expr, s: sp.Symbol) -> sp.Expr | None:
    """The integer k ≠ 0 of an angle k·s + rest."""
    k = sp.diff(angle, s)
    return k if k.is_Integer and k != 0 else None
