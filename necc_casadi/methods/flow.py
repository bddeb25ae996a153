"""Vector fields whose first integrals are sought as Casimirs are."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import sympy as sp

from necc_casadi.model.closed_loop import ClosedLoop
from necc_casadi.model.controller import Controller
from necc_casadi.model.plant import Plant

__all__ = ["Flow"]


@dataclass(frozen=True, eq=False)
class Flow(ClosedLoop):
    """Fields as the columns of M: :func:`find_casimirs` finds C with ∇CᵀM = 0."""

    fields: sp.ImmutableMatrix  # states × any number

    @classmethod
    def of(cls, x: Sequence[sp.Symbol], fields: sp.MatrixBase, energy: sp.Expr) -> Flow:
        """The fields over states x; functions that occur in `energy` are tried as words, too."""
        n, none = len(x), sp.ImmutableMatrix(sp.zeros(0, 0))
        square = sp.ImmutableMatrix(sp.zeros(n, n))
        plant = Plant("", tuple(x), square, square, sp.ImmutableMatrix(sp.zeros(n, 0)), energy)
        return cls(plant, Controller((), none, none, none), sp.ImmutableMatrix(fields))

    @property
    def M(self) -> sp.ImmutableMatrix:
        """The fields."""
        return self.fields

    @property
    def matrices(self) -> tuple[sp.MatrixBase, ...]:
        """The fields alone."""
        return (self.fields,)

    def rewritten(self, change: Callable[[sp.Expr], sp.Expr]) -> Flow:
        """The fields with every entry changed."""
        return Flow(self.plant, self.controller, sp.ImmutableMatrix(self.fields.applyfunc(change)))
