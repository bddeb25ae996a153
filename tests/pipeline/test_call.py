"""necc_casadi.run: what the command does, in one call, with nothing written unless asked for."""

import inspect
import io
import pydoc
import sys
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
import sympy as sp
from helpers.commands import design
from helpers.problems import PENDULUM
from html5lib import HTMLParser
from matplotlib.figure import Figure

import necc_casadi
from necc_casadi import Design, RunOptions, make_model, make_plant, run
from necc_casadi.cli.design import _design
from necc_casadi.errors import ModelError, OptionError
from necc_casadi.pipeline.request import Choices, Request

SMALL = {"hidden_k": (8,), "hidden_h": (6,)}


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        empty = tmp_path_factory.mktemp("here")
        patch.chdir(empty)
        found = run(PENDULUM, "pi/4", compare=True, paper=True)
        assert not list(empty.iterdir())
    return found


@pytest.mark.slow
def test_the_command_and_the_call_make_the_same_folder(tmp_path):
    """Same design, same proof, same C code, byte for byte."""
    code, _, err = design(
        PENDULUM, "--target", "pi/4", "--hidden-k", "8", "--hidden-h", "6", "--out", tmp_path / "a"
    )
    assert code == 0, err
    by_call = run(str(PENDULUM), target=sp.pi / 4, out=tmp_path / "b", **SMALL)
    assert by_call.exit_code == 0
    run(PENDULUM, target={"q": sp.pi / 4}, **SMALL).save(tmp_path / "c")
    names = {p.relative_to(tmp_path / "a") for p in (tmp_path / "a").rglob("*") if p.is_file()}
    for other in ("b", "c"):
        assert {p.relative_to(tmp_path / other) for p in (tmp_path / other).rglob("*.*")} >= names
        # these name the command, or hold measured times
        for name in names - {Path(n) for n in ("report.html", "files.json", "c/README.md")}:
            same = (tmp_path / "a" / name).read_bytes() == (tmp_path / other / name).read_bytes()
            assert same, name
    assert Design.load(tmp_path / "b").hash == by_call.design.hash


def test_a_comparison_changes_no_design(result):
    assert result.design.hash == run(PENDULUM, "pi/4", paper=True).design.hash
    compared = run(PENDULUM, "pi/4", compare=True, **SMALL)
    assert compared.performance is not None
    assert compared.design.hash == run(PENDULUM, "pi/4", **SMALL).design.hash


def test_a_plant_of_a_notebook():
    q, p = sp.symbols("q p", real=True)
    J, G = sp.Matrix([[0, 1], [-1, 0]]), sp.Matrix([0, 1])
    plant = make_plant((q, p), J, sp.zeros(2, 2), G, p**2 / 2 + 1 - sp.cos(q), name="own")
    found = run(plant, "pi/4", check=True)
    assert (found.status, found.design) == ("assignable", None)
    assert repr(found) == "<Result own: the target is assignable; q = pi/4, p = 0>"
    with pytest.raises(ModelError, match="the model is no file"):
        run(plant, "pi/4", param={"k": 4})
    with pytest.raises(OptionError, match="there is no design, the run ended assignable"):
        found.loop_transfer()


def test_a_mechanical_plant_of_a_notebook_is_that_of_its_file(tmp_path):
    q, m, g = sp.symbols("q m g")
    V = m * g * (1 - sp.cos(q))
    model = make_model(q=q, M=m, V=V, B=1, params={m: 2, g: 9.81}, u_limits=[(-40, 40)])
    text = """
import sympy as sp
q, m, g = sp.symbols("q m g")
M, V, B = m, m * g * (1 - sp.cos(q)), 1
params = {m: 2, g: 9.81}
u_limits = [(-40, 40)]
name = "plant"
"""
    (tmp_path / "file.py").write_text(text, encoding="utf-8")
    mine, file = (run(own, "pi/4", **SMALL) for own in (model, tmp_path / "file.py"))
    assert mine.status == "certified"
    assert mine.design.text == file.design.text
    assert repr(mine) == "<Result plant: certified, with 1 warning; q = pi/4, p_q = 0>"
    assert " starts ask for |u|" in mine.summary()


@pytest.mark.parametrize(
    ("names", "message"),
    [
        ({"q": sp.Symbol("q"), "M": 1, "V": 0}, "make_model does not define x, J, R, G, H"),
        ({"frction": 1}, "no model has a name frction\nDid you mean friction"),
        ({"colour": 1}, "no model has a name colour\nNames: x, J, R, G, H, q, M, V, B, friction"),
    ],
)
def test_a_model_that_lacks_or_misspells_a_name_is_refused(names, message):
    with pytest.raises(ModelError, match=message):
        make_model(**names)


def test_a_refusal_is_a_value():
    found = run(PENDULUM, target=(0, 1))
    assert (found.status, found.exit_code, found.claims) == ("refused", 3, ())


def test_what_the_summary_says(result):
    page = result.summary()
    assert len(page.splitlines()) < len(result.summary(verbose=True).splitlines())
    assert result.to_dict()["status"] == result.status
    assert result.performance.starts == 20


def test_a_notebook_shows_a_short_table(result):
    page = result._repr_html_()
    HTMLParser(strict=True).parseFragment(page)
    assert len(page) < 20_000
    for claim in result.claims:
        assert claim.name in page
    assert "http" not in page


def test_plots_on_axes_of_ones_own(result):
    axes = Figure().subplots(1, 3)
    assert result.plot_responses(ax=axes, show=["q", "u", "V"]) is None
    for line, response in zip(axes[0].lines, result.responses, strict=False):
        np.testing.assert_array_equal(line.get_ydata(), response.z[:, 0])
    assert [axis.get_ylabel() for axis in axes] == ["q [rad]", "u", "V − V(z̄)"]
    assert {axis.get_xlabel() for axis in axes} == {"time [s]"}
    (gain,) = [Figure().add_subplot()]
    result.plot_comparison(ax=gain, show="gain")
    loop = result.performance.loops[0]
    np.testing.assert_array_equal(gain.lines[0].get_ydata(), np.abs(loop.inputs[0].L))
    single = Figure().add_subplot()
    result.plot_responses(ax=single, show="p")
    assert single.get_ylabel() == "p [kg m²/s]"
    for draw in (result.plot_lyapunov, result.plot_region, result.plot_landscape):
        own = Figure().add_subplot()
        assert draw(ax=own) is None
        assert own.has_data()


def test_plots_without_axes_are_figures_that_a_notebook_shows(result):
    for figure in (
        result.plot_responses(),
        result.plot_responses(show="q"),
        result.plot_comparison(),
        result.plot_lyapunov(),
        result.plot_region(),
        result.plot_landscape(),
    ):
        assert figure._repr_png_().startswith(b"\x89PNG")


def test_plots_of_what_is_not_there_are_refused(result):
    with pytest.raises(OptionError, match="there is no w\nChoose from q, p, xi1, u, V"):
        result.plot_responses(show="w")
    with pytest.raises(OptionError, match="names 1 quantities, ax holds 2"):
        result.plot_responses(ax=Figure().subplots(1, 2), show="q")
    with pytest.raises(OptionError, match="compare=True"):
        run(PENDULUM, "pi/4", **SMALL).plot_comparison()


def test_the_loop_as_a_system_of_python_control(result):
    import control

    system = result.to_control()
    assert system.input_labels == ["u"]
    assert system.state_labels == ["q", "p", "xi1"]
    _, phase, _, _ = control.margin(system)
    assert phase == pytest.approx(result.performance.design.margins.phase_deg, rel=1e-3)


def test_without_python_control_one_line_says_so(result, monkeypatch):
    monkeypatch.setitem(sys.modules, "control", None)
    with pytest.raises(OptionError, match="not installed\nInstall it: python -m pip"):
        result.to_control()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"colour": 1}, "run has no option colour"),
        ({"setle": 3}, "Did you mean settle"),
        ({"settle": -3}, "settle = -3 is no positive number"),
        ({"phi": "product"}, "phi = 'product' is none of sum, neural"),
        ({"starts": 1.5}, "starts = 1.5 is no whole number"),
        ({"check": 1}, "check = 1 is not True or False"),
        ({"damping": "much"}, "damping = 'much' is of the wrong kind"),
        ({"sweep_a": (1, 0.5, 3)}, "sweep_a = \\(1, 0.5, 3\\) needs lo < hi"),
        ({"gamma": 1}, "--gamma 1 belongs to the regulariser"),
    ],
)
def test_options_that_cannot_be_used_are_named(options, message):
    with pytest.raises(OptionError, match=message):
        run(PENDULUM, "pi/4", **options)


def test_every_option_of_the_command_is_one_of_the_call():
    """And each has a line of help."""
    command = {option.name for option in _design.params}
    shown = {"as_json", "every_claim", "debug", "version", "no_plots", "out", "model", "target"}
    names = set(RunOptions.__annotations__)
    assert names - {"plots"} == command - shown
    known = {field.name for kind in (Choices, Request) for field in fields(kind)}
    assert names <= known
    text = inspect.getdoc(RunOptions).split("Attributes\n----------\n")[1].split("\n\nExamples")[0]
    lines = [line for line in text.splitlines() if not line.startswith(" ")]
    assert {name for line in lines for name in line.split(", ")} == names


def test_the_help_fits_a_screen():
    page = pydoc.render_doc(necc_casadi.run, renderer=pydoc.plaintext)
    assert len(page.splitlines()) <= 48
    assert max(map(len, page.splitlines()[:8])) <= 250  # one line of it is the signature


def test_a_call_is_quiet(capsys):
    said = io.StringIO()
    run(PENDULUM, "pi/4", check=True, say=lambda text: said.write(text + "\n"))
    assert capsys.readouterr() == ("", "")
    assert "judging the target" in said.getvalue()


def test_a_target_from_a_float_is_shown_as_a_decimal():
    result = run(PENDULUM, [1.3962634015954636, 0], check=True)
    assert "q = 1.39626" in repr(result)
    assert "q ≈ 1.39626 rad," in result.summary()
    assert "q = pi/4 = 0.785398 rad," in run(PENDULUM, "pi/4", check=True).summary()


def test_a_call_tells_the_logger_what_it_does(caplog, capsys):
    with caplog.at_level("INFO", logger="necc_casadi"):
        run(PENDULUM, "pi/4", check=True)
    assert "judging the target" in caplog.text
    assert capsys.readouterr().out == ""
