"""What one value of a gave."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["SweepPoint"]


@dataclass(frozen=True)
class SweepPoint:
    """What one value of a gave: the paper's third figure, and the proved region.

    Shares are of the domain, momenta at rest.
    """

    a: float
    loss: float  # ε
    distance: float  # ‖z̄ − z*‖
    bound_paper: float | None  # ε/(a − ε), None where a ≤ ε
    bound_rigorous: float | None  # g/μ, None where nothing was proved
    domain_share: float | None = None  # sampled, in the proved region; None: none is proved
    simulated_share: float | None = None  # converges in simulation; None: not known
    limited_by: str | None = None  # what keeps the proved region from growing
