"""Of the structures that hold a target, of any method, the one that is kept.

The first one is designed for. Another one is looked at where the first leaves something to win: it
is not proved, starts do not arrive with it, the whole space is not proved and it costs more than
LQR, or the whole space is proved at a multiple of LQR's cost. Where the other has no V with one
critical point, it is given up after its default, which costs a second or two, if fewer starts
arrive.

What is claimed comes first, then how many starts arrive, how many ask for more than the inputs'
limits where clipping may do harm, if it is a tenth of them more, and the cost; where costs are
about equal, the larger region.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import sympy as sp

from necc_casadi.certificate.prover.input_limits import holds_everywhere
from necc_casadi.choice.choose import Choice, choose, default_trial, may_hold_everywhere
from necc_casadi.choice.decide import NEAR
from necc_casadi.choice.fitness import response_faults
from necc_casadi.choice.judged import Judged, Trial, cost_ratio
from necc_casadi.methods.method import Method, PassedStructure
from necc_casadi.model.family_loop import FamilyLoop
from necc_casadi.synthesis.options import Options

__all__ = ["KeptStructure", "best_structure"]


#: Multiples of LQR's cost up to which a structure will do, and no other is looked at: where the
#: whole space is proved, and where a region is.
_CHEAP, _NEAR_LQR = 4.0, 1.15

#: Structures that are looked at, beyond which it takes one of which nothing is proved.
_MOST = 2


@dataclass(frozen=True, eq=False)
class KeptStructure:
    """What is kept, for which structure, and what the search took."""

    choice: Choice
    method: Method
    passed: tuple[PassedStructure, ...]  # those that were designed for and are not kept
    seconds: Mapping[str, float]  # of all of them, by stage


def best_structure(
    methods: Sequence[Method],
    x_star: Mapping[sp.Symbol, sp.Expr],
    options: Options,
    say: Callable[[str], None],
    family: Callable[[Method], FamilyLoop | None] = lambda _: None,
) -> KeptStructure:
    """The structure that is kept, with its design.

    Parameters
    ----------
    methods
        Structures that hold the target, at least one, in the order in which they are tried.
    x_star, options, say
        As of :func:`choose`.
    family
        The loop of a structure for other plants and set-points, where they are asked for.
    """
    seconds: dict[str, float] = {}

    def took(times: Mapping[str, float]) -> None:
        for stage, time in times.items():
            seconds[stage] = seconds.get(stage, 0.0) + time

    kept: tuple[Choice, Method] | None = None
    passed: list[PassedStructure] = []
    for index, method in enumerate(methods):
        parts = (method.loop, method.casimirs, method.verdict, x_star, options, say)
        if kept is not None:
            if _will_do(kept[0].kept) or (index >= _MOST and kept[0].kept.proved):
                break
            say(f"another structure: {method.name}")
            if not may_hold_everywhere(*parts[:-1]):
                trial, times = default_trial(*parts)
                took(times)
                fewer = _fewer(trial, kept[0].kept)
                if fewer is not None:
                    passed.append(PassedStructure(method.name, fewer))
                    continue
        choice = choose(*parts, family(method))
        took(choice.seconds)
        if kept is None:
            kept = choice, method
            continue
        because = _worse(kept[0].kept, choice.kept)
        left = method if because is None else kept[1]
        why = because or _worse(choice.kept, kept[0].kept) or "it is no better"
        passed.append(PassedStructure(left.name, why))
        kept = kept if because is None else (choice, method)
    if kept is None:
        raise ValueError("no structure was given")
    return KeptStructure(*kept, tuple(passed), seconds)


def _sound(kept: Judged) -> bool:
    """Whether every claim is proved and no response is against one."""
    return kept.proved and not response_faults(kept)


def _will_do(kept: Judged) -> bool:
    """Whether another structure need not be tried."""
    most = _CHEAP if kept.whole else _NEAR_LQR
    cheap = kept.cost_to_lqr is not None and kept.cost_to_lqr <= most
    return cheap and _sound(kept) and not kept.response.strayed


def _worse(kept: Judged, other: Judged) -> str | None:
    """What a structure falls short of beside another one; None: it is no worse."""
    if _sound(kept) != _sound(other):
        return None if _sound(kept) else "not every claim about it is proved"
    if kept.whole != other.whole:
        return None if kept.whole else "the whole space is not proved with it"
    fewer = _fewer(kept, other)
    if fewer is not None or kept.arrivals > other.arrivals:
        return fewer
    beyond = _overreaches(kept, other)
    if beyond is not None or _overreaches(other, kept) is not None:
        return beyond
    ratio = cost_ratio(kept.response.cost, other.response.cost)
    if ratio is None or 1 / (1 + NEAR) <= ratio <= 1 + NEAR:
        smaller = kept.plant_share < other.plant_share
        return "its region is smaller, at about the same cost" if smaller else None
    return f"it costs {ratio:.3g} times as much" if ratio > 1 else None


def _overreaches(kept: Judged, other: Judged) -> str | None:
    """That more starts ask for too much of the inputs; nothing is where clipping does no harm.

    A tenth of the starts more or less says nothing: of other starts it would be another number.
    """
    more, fewer, count = kept.response.beyond, other.response.beyond, len(kept.response.arrived)
    if more <= fewer + NEAR * count or holds_everywhere(kept.design):
        return None
    return f"{more} of {count} starts ask for more than the inputs' limits with it, not {fewer}"


def _fewer(trial: Trial, other: Trial) -> str | None:
    """That fewer starts arrive than with another structure."""
    if trial.arrivals >= other.arrivals:
        return None
    count = len(trial.response.arrived)
    return f"{trial.arrivals} of {count} starts arrive with it, not {other.arrivals}"
