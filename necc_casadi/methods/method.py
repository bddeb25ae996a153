"""A loop that is to hold a target, whatever structure of the plant it rests on."""

from __future__ import annotations

from dataclasses import dataclass

from necc_casadi.cases import MethodName
from necc_casadi.casimirs.casimirs import Casimirs
from necc_casadi.model.closed_loop import ClosedLoop
from necc_casadi.verdict.verdict import Verdict

__all__ = ["Method", "PassedStructure", "Refusal"]


@dataclass(frozen=True, eq=False)
class Method:
    """A loop with its Casimirs and the verdict at the target."""

    name: MethodName
    loop: ClosedLoop
    casimirs: Casimirs
    verdict: Verdict


@dataclass(frozen=True)
class Refusal:
    """Why a method does not hold a target."""

    name: MethodName
    reason: str  # one sentence
    proved: bool  # that it cannot; False: it was not found or not decided


@dataclass(frozen=True)
class PassedStructure:
    """A structure that holds a target too, and is not kept."""

    name: MethodName
    because: str  # what it falls short of beside the one that is kept
