"""Set-points, parameters and ξ at run time: Python and C alike, and each move within the proof."""

import json
import zipfile
from dataclasses import replace

import numpy as np
import pytest
import sympy as sp
from helpers.certificates import claim, of_small_level, verdicts
from helpers.velocity import pendulum, pendulum_with_load

from necc_casadi.certificate.prover.setpoints import prove_setpoints
from necc_casadi.designs.design import Design
from necc_casadi.errors import ModelError, OptionError, OutputError
from necc_casadi.export.compiled import compile_controller
from necc_casadi.export.fmu import export_fmu
from necc_casadi.export.governor import Governor
from necc_casadi.model.model_file import make_model

SWITCHES = ("keep", "bumpless", "least")
ANSWERS = {0: "ok", 8: "outside", 16: "limited", 32: "refused", 64: "uncovered"}


@pytest.fixture(scope="module")
def loaded():
    """A pendulum whose load and set-point change, and a smaller level, to be met often."""
    told = pendulum_with_load(l=(sp.Rational(-1, 5), sp.Rational(1, 2)))
    made = replace(pendulum(), setpoints={"q": (sp.Integer(-2), sp.Integer(2))}, told=told)
    return made, of_small_level(made)


@pytest.fixture(scope="module")
def code(loaded):
    made, certificate = loaded
    return compile_controller(made, certificate=certificate)


@pytest.mark.parametrize("switch", SWITCHES)
def test_python_and_c_move_alike(loaded, code, switch):
    governor, running = Governor(*loaded, switch), code.running()
    running.set_switch(SWITCHES.index(switch))
    rng, answers = np.random.default_rng(0), set()
    for _ in range(60):
        x = [governor.r[0] + rng.uniform(-0.9, 0.9), rng.uniform(-0.5, 0.5)]
        running.state[0] = rng.uniform(-0.3, 0.3)
        running.step(x, 0.0)
        xi = running.xi
        assert running.margin(x) == pytest.approx(governor.margin(x, xi), abs=1e-9)
        if rng.random() < 0.3:
            theta = [rng.uniform(-0.25, 0.55)]
            flag, (word, after) = running.set_parameter(theta), governor.set_parameter(x, xi, theta)
        else:
            r = [rng.uniform(-2.2, 2.2)]
            flag, (word, after) = running.set_target(x, r), governor.move(x, xi, r)
        answers.add(word)
        assert ANSWERS[flag] == word
        assert running.xi == pytest.approx(after, abs=1e-6)
        assert running.target() == pytest.approx(governor.r, abs=1e-6)
        governor.r = running.target()
        wanted = governor.control(x, running.xi)[0]
        assert running.step(x, 0.0)[0] == pytest.approx(wanted, abs=1e-9)
        if word not in ("outside", "refused", "uncovered"):
            assert governor.margin(x, running.xi) >= -1e-9
    assert {"ok", "limited"} <= answers


def test_what_each_switch_does(loaded):
    """u stays, or V is least; and the farther the lower V."""
    x, xi, far = [0.75, 0.0], np.zeros(1), [-2.0]
    reached = {}
    for switch in SWITCHES:
        governor = Governor(*loaded, switch)
        before = governor.control(x, xi)[0]
        word, after = governor.move(x, xi, far)
        assert word == "limited"
        reached[switch] = governor.r[0]
        jump = abs(governor.control(x, after)[0] - before)[0]
        assert (jump < 1e-9) == (switch == "bumpless")
        if switch == "keep":
            assert np.array_equal(after, xi)
            force = np.sin(governor.r[0]) - np.sin(0.75)
            assert jump == pytest.approx(abs(force), abs=1e-12)
        if switch == "least":
            at = [governor.above(x, after + step) for step in (-1e-4, 0.0, 1e-4)]
            assert at[1] < min(at[0], at[2])
    assert reached["least"] < reached["keep"] < 0.75


def test_what_is_told_holds_the_plant_where_it_is(loaded, code):
    """At rest at r with the load the law gives the weight of both, and V of both is 0."""
    governor, running = Governor(*loaded), code.running()
    for r, load in ((0.3, 0.4), (-1.5, -0.2)):
        x = [r, 0.0]
        running.step(x, 0.0)
        running.state[1], running.state[2] = r, load
        governor.r, governor.theta = np.array([r]), np.array([load])
        u = running.step(x, 0.0)[0]
        assert u == pytest.approx([(1 + load) * np.sin(r)], abs=1e-12)
        assert running.margin(x) == pytest.approx(1.0, abs=1e-12)
        assert governor.above([r + 0.1, 0.2], [0.05]) == pytest.approx(
            0.5 * (1 + load) * 0.2**2
            + (1 + load) * (np.cos(r) - np.cos(r + 0.1) - 0.1 * np.sin(r))
            + 2 * 0.05**2 + 2 * (0.1 - 0.05) ** 2,
            abs=1e-12,
        )  # fmt: skip


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e300])
def test_what_is_no_parameter_changes_nothing(loaded, code, bad):
    running = code.running()
    running.step([0.75, 0.0], 0.0)
    assert running.set_parameter([bad]) == (8 if np.isfinite(bad) else 2)
    assert running.state[2] == 0.0
    assert running.set_target([bad, 0.0], [0.8]) != 0
    assert running.margin([bad, 0.0]) == -1
    assert running.margin([0.75, bad]) < 0
    assert running.target() == pytest.approx([0.75])
    governor = Governor(*loaded)
    assert governor.set_parameter([0.75, 0.0], [0.0], [bad])[0] == "outside"
    assert governor.set_target([0.75, 0.0], [0.0], [bad]) == "outside"
    assert governor.set_target([0.75, bad], [0.0], [0.8]) == "refused"
    assert governor.margin([0.75, bad], [0.0]) < 0


def test_a_switch_that_is_none(loaded):
    with pytest.raises(OptionError, match="switch"):
        Governor(*loaded, "jump")
    with pytest.raises(OptionError, match="Use move"):
        Governor(*loaded, "least").set_target([0.75, 0.0], [0.0], [0.8])


# --- what is written --------------------------------------------------------------------------


def test_what_is_told_is_saved(loaded, tmp_path):
    made, _ = loaded
    path = made.save(tmp_path / "design.json")
    assert Design.load(path).hash == made.hash
    data = json.loads(path.read_text(encoding="utf-8"))
    data["told"]["plant"]["H"] = data["told"]["plant"]["H"].replace("cos", "sin")
    with pytest.raises(OutputError, match="not that of the model"):
        Design.from_text(json.dumps(data))


@pytest.mark.slow
def test_every_load_is_proved_and_proved_again(loaded, tmp_path):
    """One that is wider, and a plant that is not the design's, are found out."""
    made, certificate = loaded
    found = prove_setpoints(made)
    assert found.holds
    assert found.data["level"] > 1.0
    assert "q in [-2, 2], l in [-1/5, 1/2]" in found.statement
    claims = (*certificate.claims[:-1], found)
    whole = replace(certificate, claims=claims)
    text = whole.to_json()
    (tmp_path / "certificate.json").write_text(text, encoding="utf-8")
    made.save(tmp_path / "design.json")
    assert verdicts(tmp_path)["setpoints"]
    wide = json.loads((tmp_path / "design.json").read_text(encoding="utf-8"))
    wide["told"]["ranges"]["l"] = ["-1/5", "20"]
    (tmp_path / "design.json").write_text(json.dumps(wide), encoding="utf-8")
    data = json.loads(text)
    held = claim(data, "setpoints")
    held["statement"] = held["statement"].replace("l in [-1/5, 1/2]", "l in [-1/5, 20]")
    (tmp_path / "certificate.json").write_text(json.dumps(data), encoding="utf-8")
    assert not verdicts(tmp_path)["setpoints"]
    made.save(tmp_path / "design.json")
    other = json.loads((tmp_path / "design.json").read_text(encoding="utf-8"))
    other["told"]["plant"]["H"] = other["told"]["plant"]["H"].replace("cos", "sin")
    (tmp_path / "design.json").write_text(json.dumps(other), encoding="utf-8")
    (tmp_path / "certificate.json").write_text(text, encoding="utf-8")
    assert not verdicts(tmp_path)["setpoints"]


def test_the_unit_takes_targets_and_parameters(loaded, tmp_path):
    made, certificate = loaded
    path = export_fmu(made, tmp_path / "moving.fmu", certificate=certificate)
    with zipfile.ZipFile(path) as bundle:
        text = bundle.read("modelDescription.xml").decode()
    for name, words in {
        "target_q": 'causality="input"',
        "l": 'causality="parameter" variability="tunable"',
        "change_of_xi": 'causality="parameter" variability="tunable"',
        "margin": 'causality="output"',
    }.items():
        line = next(row for row in text.splitlines() if f'name="{name}"' in row)
        assert words in line


def model(**names):
    q, m, g = sp.symbols("q m g")
    return make_model(q=q, M=m, V=m * g * (1 - sp.cos(q)), B=1, params={m: 1, g: 10}, **names)


def test_the_model_names_what_is_told():
    m = sp.Symbol("m")
    assert model(runtime={m: (1, 2)}).told == {"m": (1, 2)}
    for names in ({"runtime": {m: (1, 2)}, "uncertain": {m: (0.9, 1.1)}}, {"runtime": {m: (1, 1)}},
                  {"runtime": {sp.Symbol("k"): (1, 2)}}, {"runtime": {m: (2, 3)}}):  # fmt: skip
        with pytest.raises(ModelError, match="runtime"):
            model(**names)
