"""A request: each option sets one field, and what was given takes the place of a default."""

import re
from dataclasses import fields
from pathlib import Path
from typing import get_args, get_type_hints

import click
import numpy as np
import pytest
from helpers.commands import check_refusal, design
from helpers.problems import PENDULUM
from helpers.runs import EXAMPLES, SMALL, run

from necc_casadi import cases
from necc_casadi.cli.design import _design
from necc_casadi.designs.design import Design
from necc_casadi.errors import OptionError
from necc_casadi.model.model_file import load_model
from necc_casadi.pipeline.request import Choices, Request, read_options, read_parameters
from necc_casadi.synthesis.options import Options, paper_options

#: Options that say how the result is shown, or the contrary of a field.
SHOWN = {"as_json", "debug", "every_claim", "no_plots", "version"}
Literal = type(cases.Shape)


def names(kind) -> set[str]:
    return {field.name for field in fields(kind)}


def test_each_option_sets_one_field_and_each_field_has_an_option():
    options = {parameter.name for parameter in _design.params} - SHOWN
    assert not names(Request) & names(Choices)
    assert options == (names(Request) | names(Choices)) - {"chosen", "command", "plots", "verbose"}


def test_choices_are_fields_of_the_options_and_of_their_types():
    ours, theirs = get_type_hints(Choices), get_type_hints(Options)
    for name in names(Choices):
        assert ours[name] in (theirs[name], theirs[name] | None), name


def test_the_words_of_an_option_are_those_of_its_type():
    """No word stands a second time in the command line."""
    offered = {p.name: p.type for p in _design.params if isinstance(p.type, click.Choice)}
    hints = get_type_hints(Request) | get_type_hints(Choices)
    assert set(offered) == {
        "activation", "casimir_form", "format", "integrator", "method", "phi", "real", "shape",
    }  # fmt: skip
    for name, kind in offered.items():
        literal, *_ = [a for a in (hints[name], *get_args(hints[name])) if isinstance(a, Literal)]
        assert tuple(kind.choices) == get_args(literal), name


def test_what_was_given_takes_the_place_of_the_forms_own():
    plain, published = Options(), paper_options(1)
    assert Choices().over(plain) == plain
    given = Choices(hidden_k=(8,), a=0.3, shape="level", convex=False)
    for form in (plain, published):
        options = given.over(form)
        assert (options.hidden_k, options.a, options.shape) == ((8,), 0.3, "level")
        assert options.hidden_h == form.hidden_h
        assert options.D is form.D


def test_options_come_from_the_request_and_the_model():
    model = load_model(PENDULUM)
    request = Request(PENDULUM, Path("out"), paper=True, damping=(2.0,), chosen=Choices(seed=3))
    options = read_options(request, model)
    assert options.D.tolist() == [[2.0]]
    assert np.array_equal(options.Dc, paper_options(1).Dc)
    assert (options.seed, options.a, options.casimir_form) == (3, 0.5, "sum")
    clash = Request(PENDULUM, Path("out"), chosen=Choices(gamma=2.0))
    with pytest.raises(OptionError, match="--gamma 2"):
        read_options(clash, model)


def test_parameters_are_names_and_values():
    assert read_parameters(["k=4", " m = 1/2"]) == {"k": "4", "m": " 1/2"}
    with pytest.raises(OptionError, match="NAME=VALUE"):
        read_parameters(["k"])


# --- controller structures -----------------------------------------------------------------------


@pytest.fixture
def motor(tmp_path) -> Path:
    """The DC motor without its resonator: the default integrator has no Casimir at all."""
    text = (EXAMPLES / "dc_motor.py").read_text(encoding="utf-8")
    path = tmp_path / "motor.py"
    path.write_text(text[: text.index("xi = ")], encoding="utf-8")
    return path


def offers(data) -> list[str]:
    return [word for note in data["notes"] for word in re.findall(r"--structure (\S+)", note)]


@pytest.mark.slow
def test_a_structure_that_helps_is_offered_and_taken(motor, tmp_path):
    code, data = run(motor, "--check", "--method", "interconnection")
    assert (code, data["status"]) == (3, "refused")
    assert data["verdict"]["assignable"] is False
    assert offers(data) == ["resonator"]
    code, data = run(motor, "--check", "--structure", "resonator")
    assert (code, data["status"]) == (0, "assignable")
    assert data["verdict"]["assignable"] is True
    assert len(data["controller"]["states"]) == 2
    assert data["verdict"]["casimir_count"] >= 1
    assert offers(data) == []
    code, data = run(
        motor, "--structure", "resonator", "--no-plots", *SMALL, "--out", tmp_path / "o"
    )
    assert (code, data["status"]) == (0, "certified")
    assert data["design"]["loss"] <= 1e-9
    assert Design.load(tmp_path / "o").loop.controller.nc == 2


def test_a_structure_that_nobody_offered_is_a_usage_error(motor, tmp_path):
    result = design(motor, "--structure", "gyrator", "--json", "--out", tmp_path / "o")
    check_refusal(result, "usage", "gyrator")
    assert "Offered here: resonator." in result[2]
    assert not (tmp_path / "o").exists()
    code, text, err = design(PENDULUM, "--target", "pi/4", "--structure", "resonator", "--json")
    check_refusal((code, text, err), "usage", "resonator")
    assert "Offered here: none." in err


def test_a_settling_time_asks_for_a_rate(tmp_path):
    """exp(−4) is 1.8 %."""
    model = load_model(PENDULUM)
    options = read_options(Request(PENDULUM, tmp_path, settle=0.5), model)
    assert options.rate == 8.0
    assert options.asks_for_cost


def test_one_peak_is_that_of_every_input_and_others_are_refused(tmp_path):
    model = load_model(PENDULUM)
    assert read_options(Request(PENDULUM, tmp_path, peak_u=(2.0,)), model).peak_u.tolist() == [2.0]
    for wrong in ((1.0, 2.0), (-1.0,), (0.0,)):
        with pytest.raises(OptionError, match="--peak-u"):
            read_options(Request(PENDULUM, tmp_path, peak_u=wrong), model)
    with pytest.raises(OptionError, match="both ask for a speed"):
        read_options(Request(PENDULUM, tmp_path, rate=1.0, settle=1.0), model)
