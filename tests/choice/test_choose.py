"""Designs that are chosen: what the plant allows, what the options leave, and the reason."""

from pathlib import Path

import numpy as np
import pytest
from helpers.problems import problem

from necc_casadi.choice.choose import choose
from necc_casadi.model.model_file import load_model
from necc_casadi.performance.saturated import saturated
from necc_casadi.synthesis.options import Options, paper_options

EXAMPLES = Path(__file__).parents[2] / "examples"
SMALL = {"hidden_k": (8,), "hidden_h": (6,)}


def chosen(task, options=None, say=None):
    return choose(task.loop, task.casimirs, task.verdict, task.x_star, options, say)


@pytest.fixture(scope="module")
def levitation():
    return problem(load_model(EXAMPLES / "maglev.py"), None)


@pytest.fixture(scope="module")
def pendulums(pendulum):
    return chosen(pendulum)


def test_the_pendulum_is_proved_everywhere_at_about_the_cost_of_lqr(pendulums):
    assert pendulums.kept.name == "whole space"
    assert pendulums.certificate.is_global
    assert pendulums.kept.response.arrived.all()
    assert 0.9 < pendulums.kept.cost_to_lqr < 1.05
    assert {p.name for p in pendulums.passed} == {"least cost", "default"}
    assert pendulums.others == ()  # nothing is made that cannot win
    assert pendulums.lower is None


def test_the_reason_names_every_candidate_once(pendulums):
    head, _, rest = pendulums.reason.partition("; instead of ")
    assert head.startswith("kept: whole space (")
    assert rest.startswith("least cost and default, because the whole space is proved at")


def test_the_same_input_keeps_the_same_design(pendulum, pendulums):
    assert chosen(pendulum).design.hash == pendulums.design.hash


def test_every_stage_is_told(pendulum):
    told = []
    chosen(pendulum, Options(**SMALL), told.append)
    for word in ("training", "following starts", "proving: region", "comparing regions"):
        assert any(text.startswith("whole space: ") and word in text for text in told), word


@pytest.mark.parametrize(
    "options",
    [
        Options(shape="regulariser", **SMALL),
        Options(convex=True, **SMALL),
        Options(least_cost=True, **SMALL),
        Options(phi="neural", **SMALL),
        paper_options(1),
    ],
)
def test_options_that_say_how_v_is_made_leave_no_choice(pendulum, options):
    choice = chosen(pendulum, options)
    assert choice.kept.name == "as asked"
    assert choice.kept.options == options
    assert not choice.was_made
    assert choice.others == choice.passed == ()


def test_damping_that_is_given_is_kept(pendulum):
    D, Dc = np.array([[2.0]]), np.array([[3.0]])
    choice = chosen(pendulum, Options(D=D, Dc=Dc, **SMALL))
    assert choice.was_made
    np.testing.assert_allclose(choice.design.D, D, rtol=1e-12)
    np.testing.assert_allclose(choice.design.Dc, Dc, rtol=1e-12)
    assert not choice.design.damping[:1, 1:].any()


@pytest.mark.slow
def test_a_region_of_the_default_is_not_given_up():
    """Nothing sees the pole's angle: no global claim, and the default's V holds more."""
    task = problem(load_model(EXAMPLES / "cart_pole.py"), "x=1,theta=pi,p_x=0,p_theta=0")
    choice = chosen(task)
    assert choice.kept.name == "damping alone"
    least, usual = (
        next(other for other in choice.others if other.name == name)
        for name in ("least cost", "default")
    )
    assert least.plant_share < choice.kept.plant_share == usual.plant_share
    assert choice.kept.cost_to_lqr < usual.cost_to_lqr
    assert "least cost" in choice.reason


def test_a_second_minimum_of_v_loses_to_one_critical_point():
    """The least-cost V of the DC motor has a lower minimum a turn away, where starts settle."""
    target = "phi=sqrt(2)/2,p=0,theta=pi/4"
    task = problem(load_model(EXAMPLES / "dc_motor.py"), target)
    choice = chosen(task)
    assert choice.kept.name == "whole space"
    assert choice.kept.whole
    assert choice.kept.response.arrived.all()
    assert "of 40 starts arrive with it" in choice.reason
    plain = chosen(task, Options(least_cost=True))
    assert not plain.kept.response.arrived.all()
    assert plain.lower is not None
    assert abs(plain.lower.at["theta"] - 2 * np.pi) < 1


def test_the_response_is_the_one_that_the_design_gives(pendulums, pendulum):
    from necc_casadi.model.cost import bryson

    made = pendulums.design
    again = saturated(made, bryson(made.sizes, 2))
    np.testing.assert_array_equal(again.cost, pendulums.kept.response.cost)


def test_a_level_that_gains_is_kept(levitation):
    choice = chosen(levitation, Options(shape="level"))
    assert choice.kept.name == "shaped"
    (default,) = choice.others
    assert choice.kept.plant_share > default.plant_share
    heights = [c.certificate.obstacle.level_above_minimum for c in (choice.kept, default)]
    assert heights[0] > 8 * heights[1]
    assert "times lower" in choice.reason


def test_a_level_that_loses_part_of_the_region_is_not_kept(levitation):
    """With sines, the height is gained and a part of the region lost."""
    choice = chosen(levitation, Options(shape="level", activation="sin"))
    assert choice.kept.name == "default"
    assert [c.name for c in choice.others] == ["shaped"]
    assert choice.kept.plant_share > choice.others[0].plant_share
    assert [start.mode for start in choice.design.starts] == ["hard"]


def test_where_nothing_can_be_shaped_the_default_is_kept_and_said_so():
    task = problem(load_model(EXAMPLES / "cart_pole.py"), None)
    choice = chosen(task, Options(shape="level", **SMALL))
    assert choice.kept.name == "default"
    assert choice.others == ()
    assert "no state that a Casimir contains" in choice.reason


def test_a_level_without_an_obstacle_needs_no_other_candidate(pendulum):
    choice = chosen(pendulum, Options(shape="level", **SMALL))
    assert choice.kept.name == "shaped"
    assert choice.certificate.is_global
    assert "leaves no obstacle" in choice.reason


def test_a_shaped_design_can_be_polished(pendulum):
    """Responses cost less, and V keeps its one critical point."""
    plain = chosen(pendulum, Options(shape="level", **SMALL))
    polished = chosen(pendulum, Options(shape="level", polish=True, **SMALL))
    assert polished.certificate.is_global
    assert polished.kept.cost_to_lqr <= plain.kept.cost_to_lqr
    names = {polished.kept.name, *(p.name for p in polished.passed)}
    assert {"shaped", "polished"} <= names
