"""A plant with its parameters as symbols, beside the values that the model file gives them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import sympy as sp

__all__ = ["Parametric"]


@dataclass(frozen=True, eq=False)
class Parametric:
    """J, R, G and H of states and parameters; exact, and equal to the plant's at the values."""

    J: sp.ImmutableMatrix  # n × n
    R: sp.ImmutableMatrix  # n × n
    G: sp.ImmutableMatrix  # n × m
    H: sp.Expr
    values: Mapping[str, sp.Expr]  # of the parameters

    @property
    def symbols(self) -> tuple[sp.Symbol, ...]:
        """The parameters, in order of their names."""
        return tuple(sp.Symbol(name, real=True) for name in sorted(self.values))

    def at(self, values: Mapping[str, sp.Expr]) -> Parametric:
        """The same with numbers in place of the parameters that are named."""
        known = {sp.Symbol(name, real=True): value for name, value in values.items()}
        return Parametric(
            self.J.xreplace(known),
            self.R.xreplace(known),
            self.G.xreplace(known),
            self.H.xreplace(known),
            {name: value for name, value in self.values.items() if name not in values},
        )
