"""Families from the command line, as a process: proved, certified again, refused, forged."""

import json
import shutil
from pathlib import Path

import jsonschema
import pytest
from helpers.commands import CERTIFY, DESIGN, check_refusal, design, process
from helpers.models import WEIGHTED

from necc_casadi.designs.design import Design
from necc_casadi.designs.family import Family
from necc_casadi.model.model_file import load_model
from necc_casadi.pipeline.call import run

ROOT = Path(__file__).resolve().parents[2]

COORDINATES = """
import sympy as sp
q, g = sp.symbols("q g")
M, V, B, friction = 1, g * (1 - sp.cos(q)), 1, 0.1
params = {g: 1}
"""

TWO_MASSES = """
import sympy as sp
q1, q2, p1, p2, load = sp.symbols("q1 q2 p1 p2 load")
x = (q1, q2, p1, p2)
J = sp.Matrix([[0, 0, 1, 0], [0, 0, 0, 1], [-1, 0, 0, 0], [0, -1, 0, 0]])
R = sp.diag(0, 0, 0, 1)
G = sp.Matrix([0, 0, 1, 0])
H = (p1**2 + p2**2) / 2 + (q1 - q2)**2 / 2 - load * q2
params = {load: 0}
"""


@pytest.fixture(scope="module")
def own(tmp_path_factory):
    """A pendulum with an uncertain weight and a disturbance, once: (its folder, the JSON)."""
    folder = tmp_path_factory.mktemp("family")
    (folder / "own.py").write_text(WEIGHTED, encoding="utf-8")
    asked = ("--target", "pi/4", "--uncertain", "g=5%", "--disturbance", "0.1")
    done = process(DESIGN, "own.py", *asked, "--json", "--no-plots", cwd=folder)
    assert done.returncode == 0, done.stderr
    return folder / "own-design", json.loads(done.stdout)


def test_the_error_at_rest_holds_true_minima_of_corners(own):
    folder, data = own
    found = data["family"]
    assert found["uncertain"] == {"g": [0.95, 1.05]}
    assert found["disturbance"] == [[-0.1, 0.1]]
    assert (found["exact_equilibrium"], found["proved_share"]) == (False, 1.0)
    lo, hi = found["error"]["q"]
    family = Family.load(folder)
    for g in (0.95, 1.05):
        for d in (-0.1, 0.1):
            member = family.member({"g": g, "d_u": d})
            assert lo <= member.z_bar[0] - member.z_star[0] <= hi
    assert max(-lo, hi) < 0.2
    held = {claim["name"] for claim in data["certificate"]["claims"] if claim["holds"]}
    assert {"momenta", "family"} <= held


def test_the_folder_is_certified_again(own):
    folder, data = own
    assert "family.json" in data["files"]
    assert json.loads((folder / "family.json").read_text("utf-8"))["design"] == (
        Design.load(folder).hash
    )
    done = process(CERTIFY, folder, cwd=folder.parent)
    assert done.returncode == 0, done.stdout
    assert "\nfamily " in done.stdout
    schema = json.loads((ROOT / "docs" / "schema" / "design-run.schema.json").read_text("utf-8"))
    jsonschema.validate(data, schema)


def test_a_forged_family_is_rejected(own, tmp_path):
    """Another range than the proved one, in the file that the claim rests on."""
    forged = tmp_path / "forged"
    shutil.copytree(own[0], forged)
    path = forged / "family.json"
    text = path.read_text("utf-8")
    assert '"19/20"' in text
    path.write_text(text.replace('"19/20"', '"1/2"'), encoding="utf-8")
    done = process(CERTIFY, forged, cwd=tmp_path)
    assert done.returncode != 0
    line = next(line for line in done.stdout.splitlines() if line.startswith("family "))
    assert " holds " not in line


@pytest.mark.parametrize(
    ("options", "code", "piece"),
    [
        (("--uncertain", "z=5%"), "param", "no parameter z"),
        (("--uncertain", "g=2:3"), "param", "no range around 1"),
        (("--uncertain", "g=-5%"), "param", "no range around 1"),
        (("--uncertain", "g"), "param", "no range"),
        (("--disturbance", "1,2"), "usage", "--disturbance 1,2"),
        (("--disturbance=-1",), "usage", "--disturbance -1"),
        (("--disturbance", "inf"), "usage", "--disturbance"),
        (("--target", "q=1:0"), "target_value", "LO < HI"),
        (("--target", "q=0:1:2"), "target_value", "LO < HI"),
        (("--target", "-1:1"), "target_value", "the name of a state"),
        (("--target", "z=-1:1"), "target_value", "the name of a state"),
    ],
)
def test_ranges_that_are_none_are_refused(tmp_path, options, code, piece):
    model = tmp_path / "own.py"
    model.write_text(WEIGHTED, encoding="utf-8")
    target = () if "--target" in options else ("--target", "0")
    check_refusal(design(model, *target, *options, "--json", "--check"), code, piece)


@pytest.mark.parametrize("value", ["[(0.1, 0.2)]", "[(-1, 1), (-1, 1)]", "0.2", "[(1, -1)]"])
def test_a_disturbance_of_the_file_that_is_none(tmp_path, value):
    model = tmp_path / "own.py"
    model.write_text(WEIGHTED + f"disturbance = {value}\n", encoding="utf-8")
    check_refusal(design(model, "--target", "0", "--json", "--check"), "limits", "disturbance")


def test_a_set_point_that_moves_goes_with_no_integral_action(tmp_path):
    model = tmp_path / "own.py"
    model.write_text(COORDINATES + "disturbance = [(-0.1, 0.2)]\n", encoding="utf-8")
    low, high = load_model(model).ranges.disturbance[0]
    assert (low * 10, high * 10) == (-1, 2)
    result = design(model, "--target", "q=0:1", "--integral", "--json", "--out", tmp_path / "out")
    check_refusal(result, "usage", "a target that is a range")


@pytest.mark.parametrize("more", [(), ("--check",)])
def test_a_load_that_moves_the_equilibrium_is_refused_with_the_witness(tmp_path, more):
    model, out = tmp_path / "own.py", tmp_path / "out"
    model.write_text(TWO_MASSES, encoding="utf-8")
    asked = ("--target", "q2=0", "--uncertain", "load=-1:1", "--method", "interconnection")
    code, text, err = design(model, *asked, "--out", out, "--json", *more)
    assert code == 3, err
    data = json.loads(text)
    assert (data["status"], data["family"]) == ("refused", None)
    assert any("load = 1" in note for note in data["notes"])
    assert not out.exists()


@pytest.mark.slow
def test_a_target_that_is_a_range(tmp_path):
    """The middle is the target, and the claims about set-points stand in one certificate."""
    (tmp_path / "own.py").write_text(COORDINATES, encoding="utf-8")
    asked = ("--target", "q=-0.5:1", "--uncertain", "g=5%", "--json", "--no-plots")
    done = process(DESIGN, "own.py", *asked, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    data = json.loads(done.stdout)
    assert data["target"]["q"] == 0.25
    assert data["family"]["setpoints"] == {"q": [-0.5, 1.0]}
    held = {c["name"] for c in data["certificate"]["claims"] if c["holds"]}
    assert {"setpoints", "family"} <= held
    assert "necc_set_target" in (tmp_path / "own-design" / "c" / "necc.h").read_text("utf-8")
    done = process(CERTIFY, "own-design", cwd=tmp_path)
    assert done.returncode == 0, done.stdout
    assert "\nfamily " in done.stdout


def test_a_neural_phi_is_not_proved_and_says_why(tmp_path):
    path = tmp_path / "own.py"
    path.write_text(WEIGHTED, encoding="utf-8")
    result = run(path, "pi/4", phi="neural", hidden_k=(4,), hidden_h=(4,), disturbance="0.1")
    claim = next(c for c in result.certificate.claims if c.name == "family")
    assert not claim.holds
    assert result.exit_code == 4
    assert any("Φ is a network" in note for note in result.notes)
