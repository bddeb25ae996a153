"""--integral and measured velocities from the command line, as a process."""

import json

import pytest
from helpers.commands import CERTIFY, DESIGN, SIMULATE, check_refusal, design, process

PENDULUM = """
import sympy as sp
q = sp.symbols("q")
M, V, B, friction = 1, 1 - sp.cos(q), 1, 0.1
units = {q: "rad"}
target = {q: 0.5}
"""
CART_POLE = """
import sympy as sp
s, a = sp.symbols("s a")
q = (s, a)
M, V, B = [[2, sp.cos(a)], [sp.cos(a), 1]], -sp.cos(a), [[1], [0]]
friction = sp.diag(0, a**2)
target = {s: 0, a: 0}
"""


@pytest.mark.parametrize(
    ("text", "options", "piece"),
    [
        (CART_POLE, (), "are not constant"),
        (PENDULUM + 'measured = "state"', (), "does not measure velocities"),
        (PENDULUM, ("--compare",), "--compare"),
        (PENDULUM, ("--settle", "3"), "--rate, --settle and --peak-u"),
        (PENDULUM, ("--phi", "neural"), "not the sum"),
    ],
)
def test_what_integral_action_does_not_cover_is_refused(tmp_path, text, options, piece):
    model = tmp_path / "own.py"
    model.write_text(text, encoding="utf-8")
    result = design(model, "--integral", "--out", tmp_path / "out", "--json", *options)
    check_refusal(result, "usage", piece)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("tau", ["0", "soon"])
def test_a_time_that_is_none(tmp_path, tau):
    model = tmp_path / "own.py"
    model.write_text(PENDULUM, encoding="utf-8")
    check_refusal(design(model, f"--integral={tau}", "--json"), "usage", "--integral")


@pytest.mark.slow
def test_a_run_with_integral_action(tmp_path):
    """Designed, certified again and simulated, each as a process."""
    (tmp_path / "own.py").write_text(PENDULUM, encoding="utf-8")
    done = process(
        DESIGN, "own.py", "--integral", "1.5", "--disturbance", "0.1", "--json", "--no-plots",
        "--fmu", cwd=tmp_path,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    data = json.loads(done.stdout)
    assert data["design"]["measured"] == ["q", "q_dot"]
    assert data["status"] == "certified"
    words = next(c["statement"] for c in data["certificate"]["claims"] if c["name"] == "integral")
    assert "every constant disturbance in [-1/10, 1/10]" in words
    integral = data["design"]["integral"]
    assert integral["tau"] == pytest.approx(1.5, rel=1e-2)
    assert set(integral["box"]) == {"q", "xi1"}
    assert integral["level"] > 0
    certified = process(CERTIFY, "own-design", cwd=tmp_path)
    assert certified.returncode == 0, certified.stdout
    assert "integral" in certified.stdout
    shown = process(SIMULATE, "own-design", "--x0", "0,1", "--time", "60", "--json", cwd=tmp_path)
    found = json.loads(shown.stdout)
    assert found["states"] == ["q", "q_dot", "xi1"]
    assert found["z_end"][0] == pytest.approx(0.5, abs=1e-9)
