"""The sampled loop under rounding, noise and delay as data: where it comes to and stays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from necc_casadi.certificate.claims.regions import Rows, Side
from necc_casadi.certificate.claims.rounding import Number, Program
from necc_casadi.certificate.claims.sampled import Cell, Covered, SampledRegion, walk

__all__ = ["Disturbances", "DisturbedRegion"]


@dataclass(frozen=True)
class Disturbances:
    """What the sampled loop is asked to bear beyond exact arithmetic; units of the model."""

    precision: Number = "double"
    noise: Mapping[str, float] = field(default_factory=dict)  # of what is measured, at most
    input_error: Mapping[str, float] = field(default_factory=dict)  # of inputs as applied
    shortest: float | None = None  # period, s; None: a hundredth of the longest
    delayed: bool = False  # u comes one sample late


@dataclass(frozen=True)
class Core:
    """A box around z̄ outside of which W falls, once solutions are near enough; natural units."""

    box: tuple[Side, ...]
    rate: float  # Π ⪯ −rate CᵀC on it


@dataclass(frozen=True)
class DisturbedRegion(Covered):
    """What is proved of {W < w₁}, a part of Ω_T of the claim `sampled`; natural units.

    The Q, the box and the method are those of that claim.
    """

    shortest: float  # period
    period: float  # the longest
    precision: Number
    noise: tuple[float, ...]  # (n,), of what is measured: x, or (q, q̇)
    input_error: tuple[float, ...]  # (m,), of u as it is applied
    delay: float | None  # α of S = W + αT|e|², e the change of u within a sample; None: no delay
    casimirs: Program  # (y, ξ) -> c, y measured
    law: Program  # (y, ξ, ∇Hc, ∇K) -> (u, ξ̇)
    frame: Rows  # C, lower triangular, |C∇V| for the length of a slope
    level: float  # w₁, of W or of S
    height: float  # w₁ − V(z̄) is at least this
    rate: float  # Π ⪯ −rate CᵀC on every box
    slope: float  # W falls where |C∇V| is larger, as it is outside of the first core
    tree: str
    cores: tuple[Core, ...]  # solutions come into one after the other
    above: float  # w_∞ − V(z̄)
    radius: tuple[float, ...]  # (N,)

    def leaves(self, region: SampledRegion) -> tuple[tuple[Cell, int], ...]:
        """Boxes that together are the box of the region and all periods, and what each is.

        Raises
        ------
        ValueError
            When the nodes are no tree.
        """
        return tuple(walk((*region.box, (0.0, self.period)), self.nodes))
