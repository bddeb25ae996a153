"""Casimirs: a value that says which functions were found, how, and how many exist."""

from __future__ import annotations

from dataclasses import dataclass

import sympy as sp

__all__ = ["Casimirs"]


@dataclass(frozen=True, eq=False)
class Casimirs:
    """Functionally independent closed forms with ∇Cᵀ(Jcl − Rcl) = 0, each one proved.

    Examples
    --------
    >>> from necc_casadi import find_casimirs, load_model
    >>> casimirs = find_casimirs(load_model("pendulum.py").loop)
    >>> casimirs.functions, casimirs.generic_count, casimirs.complete
    ((q - xi1,), 1, True)
    """

    functions: tuple[sp.Expr, ...]  # (r,) of z
    kernel_rank: int  # generic rank of ker Jcl ∩ ker Rcl
    generic_count: int  # how many exist (docs/theory.md#count-of-casimirs)
    origins: tuple[str, ...] = ()  # (r,) how each was found
    count_proved: bool = True  # that no more than `generic_count` exist
    undecided: str | None = None  # an expression that is not known to be zero or not

    @property
    def complete(self) -> bool:
        """Whether every Casimir that exists is a function of the closed forms in hand."""
        return len(self.functions) == self.generic_count

    @property
    def note(self) -> str | None:
        """What is missing and how to supply it; None where nothing is."""
        if self.undecided is not None:
            return f"Casimirs were not sought: no proof was found whether {self.undecided} is zero"
        missing = self.generic_count - len(self.functions)
        if missing <= 0:
            return None
        return (
            f"{self.generic_count} Casimirs exist, {len(self.functions)} found in closed form. "
            "Write the others into the model file: casimirs = [...]; each is proved before use."
        )
