"""Closed forms as straight-line programs, for many evaluations in balls."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import reduce

import sympy as sp
from flint import arb

from necc_casadi.certificate.checker.arithmetic.balls import evaluate, times

__all__ = ["Tape"]


Step = Callable[[list[arb]], arb]


class Tape:
    """Expressions in some variables, common subexpressions once; called with a ball for each."""

    def __init__(self, expressions: Sequence[sp.Expr], variables: Sequence[sp.Symbol]) -> None:
        self._place: dict[sp.Expr, int] = {v: k for k, v in enumerate(variables)}
        self._size, self._steps = len(self._place), list[Step]()
        self._results = [self._add(sp.sympify(expr)) for expr in expressions]

    def __call__(self, values: Sequence[arb]) -> list[arb]:
        """The expressions, for one ball per variable."""
        known = list(values)
        for step in self._steps:
            known.append(step(known))
        return [known[k] for k in self._results]

    def _add(self, expr: sp.Expr) -> int:
        """Where the value of an expression stands, after the steps that it takes."""
        if expr not in self._place:
            step = self._step(expr)
            self._place[expr] = self._size + len(self._steps)
            self._steps.append(step)
        return self._place[expr]

    def _step(self, expr: sp.Expr) -> Step:
        if not expr.free_symbols:
            constant = evaluate(expr, {})
            return lambda known: constant
        places = [self._add(a) for a in expr.args]
        if expr.is_Add:
            return lambda known: sum((known[k] for k in places[1:]), known[places[0]])
        if expr.is_Mul:
            return lambda known: reduce(times, (known[k] for k in places))
        # anything else by the one evaluator, on symbols in place of the arguments
        symbols = [sp.Dummy(real=True) if a.free_symbols else a for a in expr.args]
        plain = expr.func(*symbols)
        named = [(s, k) for s, k in zip(symbols, places, strict=True) if isinstance(s, sp.Dummy)]
        return lambda known: evaluate(plain, {s: known[k] for s, k in named})
