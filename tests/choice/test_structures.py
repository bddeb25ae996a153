"""Which structure is kept, of those that hold a target, and when another one is looked at."""

from types import SimpleNamespace

import numpy as np
import pytest
import sympy as sp
from helpers.symbolic_plants import EXAMPLES

from necc_casadi.choice import structures
from necc_casadi.methods.find import find_method
from necc_casadi.model.model_file import load_model
from necc_casadi.model.target import target_from_model
from necc_casadi.synthesis.options import Options

STARTS = 10


def designed(
    cost=1.5, arrivals=STARTS, *, whole=False, proved=True, share=0.5, against=False, beyond=0
):
    """A judged design as far as structures are compared by it; LQR's cost is 1."""
    arrived = np.arange(STARTS) < arrivals
    response = SimpleNamespace(
        arrived=arrived,
        cost=np.where(arrived, cost, np.inf),
        strayed=tuple(range(arrivals, STARTS)),
        exceeded=np.full((STARTS, 1), against),
        peak_u=np.ones((STARTS, 1)),
        beyond=STARTS if against else beyond,
        starts=np.zeros((STARTS, 1)),
        elsewhere=(),
    )
    plant = SimpleNamespace(m=1, u_limits=((-1, 1),), input_names=("u",))
    return SimpleNamespace(
        proved=proved,
        whole=whole,
        arrivals=arrivals,
        plant_share=share,
        cost_to_lqr=cost,
        response=response,
        fits_limits=not against,
        certificate=SimpleNamespace(stability="stable"),
        design=SimpleNamespace(loop=SimpleNamespace(plant=plant, feedback=sp.ones(1))),
    )


def structure(name, kept, everywhere=False):
    """A method whose design is known beforehand."""
    loop = SimpleNamespace(kept=kept, everywhere=everywhere)
    return SimpleNamespace(name=name, loop=loop, casimirs=None, verdict=None)


@pytest.fixture
def decide(monkeypatch):
    """The structure that is kept, what is said of the others, and which were designed for."""
    made, begun = [], []

    def choose(loop, *_):
        made.append(loop.kept)
        return SimpleNamespace(kept=loop.kept, seconds={"certify": 1.0})

    def default_trial(loop, *_):
        begun.append(loop.kept)
        return loop.kept, {"design": 0.5}

    monkeypatch.setattr(structures, "choose", choose)
    monkeypatch.setattr(structures, "default_trial", default_trial)
    monkeypatch.setattr(structures, "may_hold_everywhere", lambda loop, *_: loop.everywhere)

    def decided(*methods):
        made.clear()
        begun.clear()
        kept = structures.best_structure(methods, {}, None, lambda _: None)
        assert kept.choice.kept is kept.method.loop.kept
        assert kept.seconds.get("certify", 0) == len(made)
        assert kept.seconds.get("design", 0) == 0.5 * len(begun)
        return kept.method.name, {p.name: p.because for p in kept.passed}, len(made)

    return decided


@pytest.mark.parametrize(
    "first", [designed(1.1), designed(3.9, whole=True)], ids=["near LQR", "whole space"]
)
def test_what_will_do_is_kept_without_another(decide, first):
    better = structure("constant", designed(0.5, whole=True), everywhere=True)
    assert decide(structure("shaping", first), better) == ("shaping", {}, 1)


@pytest.mark.parametrize(
    ("first", "word"),
    [
        (designed(1.3), "the whole space is not proved with it"),
        (designed(1.1, 9), "the whole space is not proved with it"),
        (designed(4.5, whole=True), "it costs 2.25 times as much"),
        (designed(1.1, proved=False), "not every claim about it is proved"),
        (designed(1.1, against=True), "not every claim about it is proved"),
    ],
)
def test_another_is_taken_where_the_first_leaves_something_to_win(decide, first, word):
    other = structure("constant", designed(2.0, whole=True), everywhere=True)
    assert decide(structure("modulated", first), other) == ("constant", {"modulated": word}, 2)


def test_claims_come_before_starts_and_starts_before_cost(decide):
    def beside(first, second):
        return decide(structure("shaping", first), structure("constant", second, everywhere=True))

    whole = designed(5.0, 8, whole=True)
    assert beside(whole, designed(1.2))[0] == "shaping"
    assert beside(designed(2.0), designed(1.2, 9))[0] == "shaping"
    assert beside(designed(2.0, 9), designed(3.0))[0] == "constant"
    assert beside(designed(2.0), designed(1.8))[0] == "constant"


def test_what_asks_for_more_than_the_limits_is_not_taken_for_its_cost(decide):
    gentle, cheap = designed(2.0, beyond=1), designed(1.2, beyond=4)
    word = f"4 of {STARTS} starts ask for more than the inputs' limits with it, not 1"
    of_two = structure("shaping", gentle), structure("constant", cheap, everywhere=True)
    assert decide(*of_two) == ("shaping", {"constant": word}, 2)
    hardly = structure("constant", designed(1.2, beyond=2), everywhere=True)
    assert decide(of_two[0], hardly)[0] == "constant"  # a tenth of the starts more says nothing


def test_of_about_equal_costs_the_larger_region_and_of_equals_the_first_is_kept(decide):
    first = structure("shaping", designed(1.5, share=0.2))
    larger = structure("constant", designed(1.6, share=0.3))
    assert decide(first, larger)[:2] == (
        "constant",
        {"shaping": "its region is smaller, at about the same cost"},
    )
    equal = structure("constant", designed(1.5, share=0.2))
    assert decide(first, equal)[:2] == ("shaping", {"constant": "it is no better"})


def test_one_from_which_fewer_starts_arrive_is_given_up_before_anything_is_proved(decide):
    first, other = structure("shaping", designed(2.0)), structure("constant", designed(1.0, 4))
    because = "4 of 10 starts arrive with it, not 10"
    assert decide(first, other) == ("shaping", {"constant": because}, 1)


def test_a_third_is_looked_at_only_where_nothing_is_proved(decide):
    open_, proved = designed(1.1, proved=False), designed(2.0)
    names = "shaping", "mechanical", "constant"

    def among(*kept):
        return decide(*(structure(n, k) for n, k in zip(names, kept, strict=True)))

    assert among(open_, open_, proved)[0] == "constant"
    assert among(open_, proved, designed(1.5))[::2] == ("mechanical", 2)


def held(name):
    model = load_model(EXAMPLES / f"{name}.py")
    target = target_from_model(model.system, model.target)
    found = find_method(model, target, most=3)
    return target, (found.chosen, *found.alternatives)


def test_structures_of_later_methods_hold_the_target_too():
    _, methods = held("parallel_rlc")
    assert [method.name for method in methods] == ["shaping", "constant"]
    _, methods = held("maglev")
    assert [method.name for method in methods] == ["interconnection"]  # and no other is sought


@pytest.mark.slow
def test_a_motor_is_proved_everywhere_by_the_second_structure():
    target, methods = held("pmsm")
    kept = structures.best_structure(methods, target, Options(), lambda _: None)
    assert kept.method.name == "constant"
    assert kept.choice.certificate.is_global
    assert kept.choice.kept.cost_to_lqr < 1.4
    (other,) = kept.passed
    assert other.name == "modulated"
    assert other.because == "the whole space is not proved with it"
