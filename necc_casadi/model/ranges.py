"""What is not one number: ranges of set-points, of parameters and of constant disturbances."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import sympy as sp

__all__ = ["Range", "Ranges"]


#: (least, greatest), exact.
Range = tuple[sp.Expr, sp.Expr]


@dataclass(frozen=True)
class Ranges:
    """What a family is asked for; empty where one plant and one set-point are."""

    setpoints: Mapping[str, Range] = field(default_factory=dict)  # state -> moved at run time
    uncertain: Mapping[str, Range] = field(default_factory=dict)  # parameter -> constant, unknown
    disturbance: tuple[Range, ...] = ()  # (m,) constant, unknown, added to u; (): none

    def __bool__(self) -> bool:
        """Whether anything has a range."""
        return bool(self.setpoints or self.uncertain or self.disturbance)
