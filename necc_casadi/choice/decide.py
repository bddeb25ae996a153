"""Which of the candidates is kept, and why none of the others.

In this order: what is proved; how many starts arrive, inputs clipped; what the inputs allow; no
region and no global claim of the default is given up; the least cost. Where costs are near enough,
the larger region.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from necc_casadi.choice.judged import Judged, Name, cost_ratio

__all__ = ["NEAR", "Passed", "decide", "gives_up"]


#: Costs within this share of each other are equal: other starts would tell otherwise.
NEAR = 0.1


@dataclass(frozen=True)
class Passed:
    """A candidate that was not kept, or not even made."""

    name: Name
    because: str


def decide(candidates: Sequence[Judged]) -> tuple[Judged, tuple[Passed, ...]]:
    """The candidate that is kept, and why the others are not; the first of equals is kept."""
    left, passed = list(candidates), list[Passed]()

    def drop(unfit: Callable[[Judged], str | None]) -> None:
        """Drop what is unfit, unless all of them are."""
        reasons = [unfit(c) for c in left]
        if all(reasons):
            return
        for candidate, reason in zip(list(left), reasons, strict=True):
            if reason is not None:
                left.remove(candidate)
                passed.append(Passed(candidate.name, reason))

    drop(lambda c: None if c.proved else "not every claim about it is proved")
    most = max(c.arrivals for c in left)
    count = len(left[0].response.arrived)
    drop(
        lambda c: (
            None
            if c.arrivals == most
            else f"{c.arrivals} of {count} starts arrive with it, not {most}"
        )
    )
    drop(lambda c: None if c.fits_limits else "it asks for more than the inputs' limits")
    default = next((c for c in left if c.name == "default"), None)
    if default is not None:
        drop(lambda c: gives_up(c, default, "the default"))
    kept = _cheapest(left)
    passed += [Passed(c.name, _dearer(c, kept)) for c in left if c is not kept]
    return kept, tuple(passed)


def gives_up(candidate: Judged, other: Judged, called: str) -> str | None:
    """What of another's region a candidate gives up."""
    if other.whole and not candidate.whole:
        return f"{called} is proved on the whole space, it is not"
    if other.converges and not candidate.converges:
        return f"solutions are proved to converge with {called}, with it they are not"
    if not candidate.whole and candidate.plant_share < other.plant_share:
        return (
            f"its region holds {100 * candidate.plant_share:.3g} % of the plant's states at rest, "
            f"{called}'s {100 * other.plant_share:.3g} %"
        )
    own, usual = candidate.unclipped_share, other.unclipped_share
    if own is not None and usual is not None and own < usual:
        return (
            f"inputs are proved to keep their limits from {100 * own:.3g} % of the plant's states "
            f"at rest, {called}'s from {100 * usual:.3g} %"
        )
    return None


def _cheapest(candidates: Sequence[Judged]) -> Judged:
    """Of those that cost about the least, the first with the largest region."""
    best = candidates[0]
    for candidate in candidates[1:]:
        ratio = cost_ratio(candidate.response.cost, best.response.cost)
        if ratio is not None and ratio < 1:
            best = candidate
    near = [c for c in candidates if _times(c, best) <= 1 + NEAR]
    return max(near or [best], key=lambda c: (c.whole, c.plant_share))


def _times(candidate: Judged, other: Judged) -> float:
    """What a candidate costs, as a multiple of another; 1 where they cannot be compared."""
    ratio = cost_ratio(candidate.response.cost, other.response.cost)
    return 1.0 if ratio is None else ratio


def _dearer(candidate: Judged, kept: Judged) -> str:
    times = _times(candidate, kept)
    if times > 1 + NEAR:
        return f"it costs {times:.3g} times as much"
    if (kept.whole, kept.plant_share) > (candidate.whole, candidate.plant_share):
        return f"it costs about the same ({times:.3g} times) and less is proved of it"
    return f"it is no better: it costs {times:.3g} times as much, and no more is proved of it"
