"""Which candidate is kept, by one property at a time."""

from types import SimpleNamespace

import numpy as np
import pytest

from necc_casadi.choice.decide import decide

STARTS = 10


def candidate(name="default", cost=1.0, arrivals=STARTS, **changes):
    arrived = np.arange(STARTS) < arrivals
    response = SimpleNamespace(arrived=arrived, cost=np.where(arrived, cost, np.inf))
    usual = {
        "proved": True,
        "converges": True,
        "fits_limits": True,
        "whole": False,
        "plant_share": 0.5,
        "unclipped_share": 0.3,
    }
    return SimpleNamespace(name=name, arrivals=arrivals, response=response, **(usual | changes))


def kept(*candidates):
    best, passed = decide(candidates)
    assert {best.name, *(p.name for p in passed)} == {c.name for c in candidates}
    return best.name, {p.name: p.because for p in passed}


def test_the_cheapest_is_kept_among_equals():
    name, why = kept(candidate("least cost", cost=1.0), candidate(cost=1.3))
    assert name == "least cost"
    assert why == {"default": "it costs 1.3 times as much"}


def test_of_those_that_cost_about_the_same_the_larger_region_is_kept():
    whole = candidate("whole space", cost=1.08, whole=True, plant_share=1.0)
    assert kept(whole, candidate("least cost"), candidate(cost=1.5))[0] == "whole space"
    dear = candidate("whole space", cost=1.2, whole=True, plant_share=1.0)
    assert kept(dear, candidate("least cost"), candidate(cost=1.5))[0] == "least cost"


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({"proved": False}, "not every claim"),
        ({"arrivals": 9}, "9 of 10 starts arrive with it, not 10"),
        ({"fits_limits": False}, "limits"),
        ({"converges": False}, "proved to converge with the default"),
        ({"unclipped_share": 0.2}, "20 % of the plant's states at rest, the default's from 30 %"),
        ({"plant_share": 0.4}, "40 % of the plant's states at rest, the default's 50 %"),
    ],
)
def test_a_cheaper_one_that_is_worse_is_not_kept(changes, word):
    name, why = kept(candidate("least cost", cost=0.1, **changes), candidate())
    assert name == "default"
    assert word in why["least cost"]


def test_a_global_claim_of_the_default_is_not_given_up():
    default = candidate(whole=True, plant_share=1.0)
    name, why = kept(candidate("least cost", cost=0.1, plant_share=1.0), default)
    assert name == "default"
    assert "whole space" in why["least cost"]


def test_the_region_of_a_default_that_does_not_arrive_binds_nobody():
    name, why = kept(candidate("least cost", plant_share=0.2), candidate(arrivals=8))
    assert name == "least cost"
    assert "8 of 10" in why["default"]


def test_one_is_kept_where_all_are_unfit():
    worse = candidate("least cost", proved=False, fits_limits=False)
    assert kept(worse, candidate(proved=False, fits_limits=False, arrivals=9))[0] == "least cost"


def test_costs_are_compared_over_starts_from_which_both_arrive():
    one, other = candidate("least cost"), candidate()
    one.response.cost = np.array([1.0] * 5 + [np.inf] * 5)
    other.response.cost = np.array([2.0] * 5 + [1e-3] * 5)
    assert kept(one, other)[0] == "least cost"
