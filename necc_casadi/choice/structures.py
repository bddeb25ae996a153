"""Of the structures of one method that hold a target, the one that responds best."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
import sympy as sp

from necc_casadi.choice.choose import Choice, choose
from necc_casadi.choice.fitness import response_faults
from necc_casadi.choice.judged import Judged
from necc_casadi.methods.method import Method
from necc_casadi.model.family_loop import FamilyLoop
from necc_casadi.synthesis.options import Options

__all__ = ["best_structure"]


#: Multiple of LQR's cost up to which a structure will do, and the next one is not tried.
_CHEAP = 4.0


def best_structure(
    methods: Sequence[Method],
    x_star: Mapping[sp.Symbol, sp.Expr],
    options: Options,
    say: Callable[[str], None],
    family: Callable[[Method], FamilyLoop | None] = lambda _: None,
) -> tuple[Choice, Method, dict[str, float]]:
    """What is kept, for which structure, and the seconds that all of them took by stage.

    Parameters
    ----------
    methods
        Structures that hold the target, at least one, in the order in which they are tried.
    x_star, options, say
        As of :func:`choose`.
    family
        The loop of a structure for other plants and set-points, where they are asked for.
    """
    made: list[tuple[Choice, Method]] = []
    seconds: dict[str, float] = {}
    for method in methods:
        if made and _is_good(made[0][0].kept):
            break
        at = (method.loop, method.casimirs, method.verdict, x_star)
        choice = choose(*at, options, say, family(method))
        made.append((choice, method))
        for stage, time in choice.seconds.items():
            seconds[stage] = seconds.get(stage, 0.0) + time
    choice, method = max(made, key=lambda pair: _merit(pair[0].kept))
    return choice, method, seconds


def _is_good(kept: Judged) -> bool:
    """Whether another structure need not be tried."""
    cheap = kept.cost_to_lqr is not None and kept.cost_to_lqr <= _CHEAP
    return cheap and kept.proved and not response_faults(kept)


def _merit(kept: Judged) -> tuple[bool, int, float]:
    """What is proved, how many starts arrive, and what they cost: the more the better."""
    cost = np.inf if kept.cost_to_lqr is None else kept.cost_to_lqr
    return kept.proved and not response_faults(kept), kept.arrivals, -cost
