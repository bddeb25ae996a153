"""Why a family of target structures gives none: a value, not an exception."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["NoStructure"]


@dataclass(frozen=True)
class NoStructure:
    """A family of target structures without a member, or without one that was found.

    It says nothing about other families: a plant without a mechanical structure may still be
    stabilisable.
    """

    family: str  # e.g. "constant M_d"
    reason: str  # one sentence
    proved: bool  # there is none; otherwise none was found
