"""One walk over an expression, for every arithmetic that gives each part a value.

An :class:`Algebra` says what numbers, functions, sums, products and powers are in an arithmetic
(balls, intervals, jets, CasADi symbols); :func:`fold` goes through the expression. Two walks are
not this one: residues (:mod:`finite_field`) look at the argument of a function before it has a
value, and the checker's balls share nothing with the prover but what they are meant to check.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from typing import Any, Generic, TypeVar

import sympy as sp

from necc_casadi.errors import NeccError

__all__ = ["Algebra", "fold", "product", "total"]


T = TypeVar("T")


def total(parts: Sequence[Any]) -> Any:
    """The sum, from left to right."""
    return reduce(lambda a, b: a + b, parts)


def product(parts: Sequence[Any]) -> Any:
    """The product, from left to right."""
    return reduce(lambda a, b: a * b, parts)


def _without_value(expr: sp.Expr) -> Any:
    raise NeccError(f"{expr}: {type(expr).__name__} has no counterpart here")


@dataclass(frozen=True)
class Algebra(Generic[T]):
    """What the parts of an expression are in one arithmetic."""

    functions: Mapping[str, Callable[[T], T]]  # by the names of expressions.FUNCTIONS
    number: Callable[[sp.Expr], T | None]  # a part that is taken whole; None: look inside
    power: Callable[[sp.Pow, Callable[[sp.Expr], T]], T]  # with the walk, for base and exponent
    add: Callable[[list[T]], T] = total
    multiply: Callable[[list[T]], T] = product
    other: Callable[[sp.Expr], T] = _without_value  # a symbol or a function that is not known


def fold(expr: sp.Expr, algebra: Algebra[T], known: dict[sp.Expr, T]) -> T:
    """The value of `expr`; `known` holds those of symbols, and takes up that of every part.

    Raises
    ------
    NeccError
        For a part that the algebra knows nothing of, unless its ``other`` says otherwise.
    """

    def value(part: sp.Expr) -> T:
        number = algebra.number(part)
        if number is not None:
            return number
        if isinstance(part, sp.Pow):
            return algebra.power(part, walk)
        if part.is_Add or part.is_Mul:
            parts = [walk(a) for a in part.args]
            return algebra.add(parts) if part.is_Add else algebra.multiply(parts)
        name = type(part).__name__
        if name in algebra.functions:
            return algebra.functions[name](walk(part.args[0]))
        return algebra.other(part)

    def walk(part: sp.Expr) -> T:
        if part not in known:
            known[part] = value(part)
        return known[part]

    return walk(expr)
