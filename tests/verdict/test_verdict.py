"""The order of verdicts: the answer first, then stability, then what is seen, then the ceiling."""

from itertools import combinations, pairwise
from math import inf
from typing import get_args

import pytest

from necc_casadi.verdict.verdict import Merit, Reason, assignable


def test_an_answer_goes_with_every_reason():
    answers = {reason: assignable(reason) for reason in get_args(Reason)}
    assert answers.pop("ok") is True
    assert answers.pop("undecided") is None
    assert set(answers.values()) == {False}


@pytest.mark.parametrize("ceiling", [-inf, -1.0, 0.0, inf])
def test_a_better_answer_outweighs_every_ceiling(ceiling):
    ranked = ["invisible_gradient", "invisible_flat_curvature", "undecided", "ok"]
    for worse, better in combinations(ranked, 2):
        assert Merit.of(worse, inf) < Merit.of(better, ceiling)
    for low, high in pairwise((-inf, -1.0, 0.5, inf)):
        assert Merit.of("ok", low) < Merit.of("ok", high)


def test_structures_are_compared_by_answer_then_stability_then_what_they_see():
    no, perhaps, yes = (False, False), (True, False), (True, True)
    ordered = [
        Merit(no, False, -1), Merit(perhaps, False, -4), Merit(perhaps, False, -3),
        Merit(yes, False, -2), Merit(yes, True, -5), Merit(yes, True, -1),
    ]  # fmt: skip
    for worse, better in combinations(ordered, 2):
        assert worse < better
