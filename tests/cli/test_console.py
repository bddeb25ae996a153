"""What consoles show that have few letters, and what a pipe hears of a long run."""

import io
import json
import os
import time

import pytest
from helpers.commands import CERTIFY, DESIGN, SIMULATE, design, process, without_progress
from helpers.models import model
from helpers.problems import PENDULUM

from necc_casadi.cli import console
from necc_casadi.cli.console import Progress, fitting
from necc_casadi.texts import escaped, to_ascii

CONSOLES = {
    "cp1252": {"PYTHONIOENCODING": "cp1252"},
    "ascii": {"PYTHONIOENCODING": "ascii"},
    "C": {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"},
    "utf-8": {"PYTHONIOENCODING": "utf-8"},
}


@pytest.mark.parametrize(
    "letters",
    [pytest.param(c, marks=[pytest.mark.slow] * (c in ("ascii", "utf-8"))) for c in CONSOLES],
)
def test_every_command_on_every_console(made, tmp_path, letters):
    environment = {k: v for k, v in os.environ.items() if not k.startswith("PYTHONIO")}
    options = {
        "cwd": tmp_path, "env": environment | CONSOLES[letters], "errors": "surrogateescape",
        "encoding": letters if letters in ("cp1252", "utf-8") else "ascii",
    }  # fmt: skip
    out = made[0] / "pendulum-design"
    for code, *arguments in (
        (DESIGN, PENDULUM, "--target", "pi/4", "--check"),
        (DESIGN, "--help"),
        (SIMULATE, out, "--time", "1"),
        (SIMULATE, "--help"),
        (CERTIFY, out),
        (CERTIFY, "--help"),
    ):
        done = process(code, *arguments, **options)
        assert done.returncode == 0, done.stderr
        assert without_progress(done.stderr) == []
        assert "\\u" not in done.stdout
        assert not [letter for letter in done.stdout if "\udc80" <= letter <= "\udcff"]
    assert ("z̄" if letters == "utf-8" else "zbar") in process(CERTIFY, out, **options).stdout
    done = process(DESIGN, PENDULUM, "--target", "ξ", **options)
    assert done.returncode == 2
    assert done.stderr.startswith("error [target_value]: ")


def test_what_a_model_file_prints_is_readable_too(tmp_path):
    path = model(tmp_path, 'print("ξ₁ ≤ 2")')
    environment = os.environ | {"PYTHONIOENCODING": "ascii"}
    done = process(DESIGN, path, "--target", "pi/4", "--check", cwd=tmp_path, env=environment)
    assert done.returncode == 0
    assert without_progress(done.stderr) == ["xi1 <= 2"]


@pytest.mark.parametrize(
    ("text", "plain"),
    [
        ("ξ₁ ≤ z̄² Φ₁", "xi1 <= zbar^2 Phi1"),
        ("10⁻⁹ kg m²/s, 5°", "10^-9 kg m^2/s, 5deg"),
        ("ẋ = −∂V/∂ξ", "xdot = -dV/dxi"),
        ("∇²V ⪰ μI, ‖z̄ − z*‖", "hess V >= muI, ||zbar - z*||"),
        ("naïve µ Ω", "naive u Omega"),
        ("漢", "\\u6f22"),
    ],
)
def test_letters_in_ascii(text, plain):
    assert to_ascii(text) == plain


def test_what_a_terminal_would_obey_is_escaped():
    assert escaped("a\x1b[2J\n\x07\u202eb\x9b") == "a\\x1b[2J\\n\\x07\\u202eb\\x9b"
    assert escaped("ξ₁ kg m²") == "ξ₁ kg m²"
    assert fitting("one\ntwo\x1b", io.StringIO()) == "one\ntwo\\x1b"


def test_control_characters_in_a_model(tmp_path, monkeypatch):
    """A name or a unit goes into C, XML and plots: it is refused with its place."""
    monkeypatch.chdir(tmp_path)
    for line in (r'name = "a\x01b"', r'units = {q: "rad\x01"}', r'units = {q: "a\nb"}'):
        path = model(tmp_path, line)
        code, out, _ = design(path, "--target", "pi/4", "--fmu", "--json")
        assert code == 2
        error = json.loads(out)["error"]
        assert error["code"] == "model_file"
        assert "cannot be shown" in error["message"]
        assert "\\x01" in error["message"] or "\\n" in error["message"]
    assert not (tmp_path / "plant-design").exists()


def test_a_pipe_hears_of_long_stages_once_and_of_short_ones_never(monkeypatch, capsys):
    monkeypatch.setattr(console, "_QUIET", 0.2)
    progress = Progress()
    with progress.shown():
        progress.say("reading")
        progress.say("training")
        for start in range(40):
            progress.say(f"training: start {start}")
            time.sleep(0.01)
        progress.say("proving")
    time.sleep(0.4)
    heard = capsys.readouterr()
    assert heard.out == ""
    (line,) = heard.err.splitlines()
    assert line.startswith("training: start ")
    assert line.endswith(" ...")
