"""Runs that would look well in one word: what is wrong with them is the first that is said."""

import re
from pathlib import Path

import pytest
from helpers.actuated import JOINT, PAN_TILT, written

from necc_casadi.pipeline.request import Choices, Request
from necc_casadi.pipeline.run import run_design
from necc_casadi.report.to_json import to_json
from necc_casadi.report.to_text import summary

#: Small networks, so that proofs of input limits take a second or two.
SMALL = {"hidden_k": (8,), "hidden_h": (6,)}
EXAMPLES = Path(__file__).parents[2] / "examples"


def found(model, folder, **asked):
    request = Request(model=model, out=folder / "out", plots=False, **asked)
    return run_design(request, lambda text: None)


def first_line(run) -> str:
    """The headline, on one line."""
    return " ".join(summary(run).split("\n\n")[0].split())


def test_a_joint_that_settles_a_turn_away_says_so(tmp_path):
    path = written(tmp_path, JOINT)
    run = found(path, tmp_path, target="q=1", chosen=Choices(casimir_form="sum"))
    response = run.choice.kept.response
    assert not response.arrived.all()
    assert run.status == "certified"  # its starts are outside of the proved region
    line = first_line(run)
    assert re.search("(do|does) not arrive: ", line)
    assert re.search(r"V has a lower minimum at q = -?\d", line)
    assert line.index("not arrive") < line.index("certified")
    assert line.endswith("in the proved region alone")
    assert to_json(run)["arrivals"]["lower_minimum"]["below"] > 0


def test_the_joint_arrives_from_everywhere_where_the_choice_is_the_tools(tmp_path):
    run = found(written(tmp_path, JOINT), tmp_path, target="q=1", chosen=Choices(**SMALL))
    assert run.choice.kept.name == "whole space"
    assert run.choice.kept.response.arrived.all()
    assert run.choice.lower is None
    line = first_line(run)
    assert "not arrive" not in line
    assert "starts ask for |u| up to" in line  # more than the motor gives: they are clipped


@pytest.mark.slow
def test_a_design_within_the_limits_is_kept_and_what_is_beyond_them_comes_first(tmp_path):
    run = found(written(tmp_path, PAN_TILT), tmp_path, chosen=Choices(**SMALL))
    data = to_json(run)
    assert data["choice"]["kept"] == "default"
    assert "starts ask for more than the inputs' limits, not" in data["choice"]["reason"]
    assert 0 < data["arrivals"]["beyond_limits"] < 10
    assert 1.5 < max(data["arrivals"]["peak_u"]) < 3
    line = first_line(run)
    assert run.status == "certified"  # a level says from where the limits are kept
    assert re.match(r"Pan-tilt head: \d of 40 starts ask for \|u\d\| up to 1\.\d+, limits", line)
    assert line.endswith("; certified, asymptotically stable as long as no input is clipped")


def test_inputs_beyond_limits_that_no_region_keeps_fall_short(tmp_path):
    chosen = Choices(casimir_form="sum", **SMALL)
    weaker = PAN_TILT.replace("(-1.5, 1.5)", "(-1, 1)")
    run = found(written(tmp_path, weaker), tmp_path, chosen=chosen)
    assert run.certificate.level_u is run.certificate.level_clipped is None
    assert not run.choice.kept.response.keeps_limits
    assert (run.status, run.exit_code) == ("fell_short", 4)
    assert any("limits -1 … 1" in fault for fault in run.faults)


@pytest.mark.slow
def test_a_satellite_that_ends_half_a_turn_off_says_where(tmp_path):
    run = found(EXAMPLES / "satellite.py", tmp_path)
    response = run.choice.kept.response
    assert response.share < 0.8
    line = first_line(run)
    assert "random starts do not arrive: " in line
    assert "yaw = " in line
    assert not line.startswith("Satellite: certified")
    places = to_json(run)["arrivals"]["elsewhere"]
    assert sum(place["starts"] for place in places) == len(response.strayed)
