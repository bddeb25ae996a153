"""A loop for many set-points and plants, as a value: J, R, G and H with the symbols ϑ in them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import sympy as sp

from necc_casadi.model.closed_loop import ClosedLoop
from necc_casadi.model.ranges import Range

__all__ = ["FamilyLoop", "Kind", "NoFamily", "Parameter", "Reason"]


Kind = Literal["setpoint", "uncertain", "disturbance"]


#: Why there is no family: refused with a proof, or not decided, or not covered by the theory here.
Reason = Literal["refused", "undecided", "not_covered"]


@dataclass(frozen=True, eq=False)
class Parameter:
    """A constant of the loop that has a range."""

    name: str  # of the state that moves, of the plant's parameter, or of the input
    kind: Kind
    symbol: sp.Symbol
    range: Range
    nominal: sp.Expr


@dataclass(frozen=True, eq=False)
class NoFamily:
    """Why a design is not one of a family."""

    reason: Reason
    text: str
    witness: Mapping[str, sp.Expr] | None = None  # values for which it fails

    @property
    def sentence(self) -> str:
        """The reason, with the place where it fails."""
        if self.witness is None:
            return self.text
        shown = ", ".join(f"{name} = {sp.sstr(v)}" for name, v in self.witness.items())
        return f"{self.text} (at {shown})"


@dataclass(frozen=True, eq=False)
class FamilyLoop:
    """A loop whose J, R, G and H hold the symbols ϑ = (r, θ, d), in the states x̂."""

    loop: ClosedLoop
    parameters: tuple[Parameter, ...]
    x_star: tuple[sp.Expr, ...]  # (n,) x*(r)
    origin: tuple[sp.Expr, ...]  # (n,) x*(r₀)
    feedforward: sp.ImmutableMatrix  # GcᵀN_ξᵀΔλ(r), m × 1: is added to u

    def of(self, kind: Kind) -> tuple[Parameter, ...]:
        """The parameters of one kind."""
        return tuple(p for p in self.parameters if p.kind == kind)

    @cached_property
    def shift(self) -> sp.ImmutableMatrix:
        """X − x̂ = x*(r) − x*(r₀), n × 1."""
        return sp.ImmutableMatrix([a - b for a, b in zip(self.x_star, self.origin, strict=True)])

    @cached_property
    def symbols(self) -> tuple[sp.Symbol, ...]:
        """ϑ, in the order of the parameters."""
        return tuple(p.symbol for p in self.parameters)

    def at(self, values: Mapping[str, sp.Expr]) -> ClosedLoop:
        """The loop with numbers for ϑ, by name; those that are not named are nominal."""
        known = {p.symbol: values.get(p.name, p.nominal) for p in self.parameters}
        changed = self.loop.rewritten(lambda entry: entry.subs(known))
        return replace(changed, plant=replace(changed.plant, H=self.loop.plant.H.subs(known)))
