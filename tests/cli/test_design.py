"""necc-design as a process: exit codes, code words, clean stdout, files of its own only."""

import json
import re
from pathlib import Path

import pytest
from helpers.commands import DESIGN, check_refusal, design, process, without_progress
from helpers.models import FAULTS, FAULTS_AT_TARGET, model
from helpers.problems import PENDULUM
from helpers.runs import SMALL
from hypothesis import example, given, settings
from hypothesis import strategies as st

BLOCKS = {"status", "plant", "controller", "target", "verdict", "design", "certificate", "files",
          "timings"}  # fmt: skip
VERDICT = {"assignable", "reason", "stability", "a_max", "casimirs", "casimir_count",
           "kernel_rank", "casimir_count_generic"}  # fmt: skip
MADE = {"xi_star", "a", "a_requested", "loss", "gradient_norm", "hessian_min_eig", "z_bar",
        "distance", "bound_paper", "bound_rigorous", "spectral_abscissa", "stability"}  # fmt: skip
CERTIFICATE = {"claims", "level", "level_above_minimum", "level_u", "level_clipped", "limited_by",
               "obstacle", "reach", "domain_share", "simulated_share", "global"}  # fmt: skip


# --- the main job --------------------------------------------------------------------------------


def test_the_main_job_prints_a_summary_and_nothing_else(made):
    _, done = made
    assert done.returncode == 0, done.stderr
    assert without_progress(done.stderr) == []
    for word in ("certified", "q - xi1", "ε", "z̄", "proved", "abscissa", "settle",
                 "peak |u|", "written", "design.json"):  # fmt: skip
        assert word in done.stdout


def test_the_main_job_writes_its_files_and_keeps_those_of_others(made):
    folder, _ = made
    out = folder / "pendulum-design"
    written = {path.relative_to(out).as_posix() for path in out.rglob("*") if path.is_file()}
    expected = {"design.json", "certificate.json", "c/necc.h", "c/necc.c", "c/main.c",
                "c/CMakeLists.txt", "figures/lyapunov.png", "figures/responses.png"}  # fmt: skip
    assert expected | {"notes.txt"} <= written
    assert not [name for name in written if Path(name).name.startswith(".")]
    assert (out / "notes.txt").read_text() == "mine"
    assert [path.name for path in folder.iterdir()] == ["pendulum-design"]


def test_one_direction_of_hashes(made):
    import hashlib

    out = made[0] / "pendulum-design"
    hashes = {
        name: hashlib.sha256((out / name).read_bytes()).hexdigest()
        for name in ("design.json", "certificate.json")
    }
    assert hashes["design.json"] in (out / "certificate.json").read_text()
    header = (out / "c" / "necc.h").read_text()
    assert all(value in header for value in hashes.values())


def test_json_is_one_object_with_every_key(tmp_path):
    done = process(
        DESIGN, model(tmp_path, 'print("noise")'), "--target", "pi/4", "--json", "--no-plots",
        cwd=tmp_path,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    data = json.loads(done.stdout)
    assert set(data) >= BLOCKS
    assert data["status"] == "certified"
    assert data["plant"] == {"states": ["q", "p"], "inputs": 1}
    assert data["controller"] == {"states": ["xi1"]}
    assert data["target"] == {"q": pytest.approx(0.7853981633974483), "p": 0.0}
    assert set(data["verdict"]) >= VERDICT
    assert data["verdict"]["reason"] == "ok"
    assert data["verdict"]["casimirs"] == ["q - xi1"]
    assert (data["verdict"]["a_max"], data["verdict"]["stability"]) == (1.0, "asymptotic")
    assert set(data["design"]) >= MADE
    assert data["design"]["loss"] <= 1e-9
    assert data["design"]["bound_rigorous"] <= 1e-8
    assert set(data["certificate"]) >= CERTIFICATE
    assert all(set(claim) >= {"name", "holds", "statement"}
               for claim in data["certificate"]["claims"])  # fmt: skip
    assert {"symbolic", "solve"} <= set(data["timings"])
    out = tmp_path / "plant-design"
    assert {path.relative_to(out).as_posix() for path in out.rglob("*") if path.is_file()} == set(
        data["files"]
    )
    assert without_progress(done.stderr) == ["noise"]


def test_check_judges_and_writes_nothing(tmp_path):
    code, out, _ = design(
        PENDULUM, "--target", "pi/4", "--check", "--json", "--out", tmp_path / "o"
    )
    data = json.loads(out)
    assert (code, data["status"]) == (0, "assignable")
    assert set(data) >= BLOCKS
    assert data["design"] is None
    assert data["certificate"] is None
    assert data["files"] == []
    assert list(tmp_path.iterdir()) == []


def test_a_negative_target_needs_no_quoting(tmp_path):
    done = process(DESIGN, PENDULUM, "--target", "-pi/4", "--check", cwd=tmp_path)
    assert done.returncode == 0
    assert "-pi/4" in done.stdout


def test_a_refusal_is_exit_3_with_the_reason(tmp_path):
    path = model(tmp_path, "R = sp.diag(1, 0)")  # dissipation in the coordinate to be shaped
    alone = ("--method", "interconnection", "--json", "--out", tmp_path / "o")
    code, out, _ = design(path, "--target", "q=pi/4", *alone)
    data = json.loads(out)
    assert (code, data["status"], data["method"]) == (3, "refused", None)
    assert data["verdict"]["assignable"] is False
    assert data["verdict"]["reason"] in ("not_an_equilibrium", "invisible_gradient")
    assert data["design"] is None
    assert not (tmp_path / "o").exists()


def test_off_the_equilibrium_set_is_exit_3_and_suggests_one(tmp_path):
    code, out, _ = design(PENDULUM, "--target", "pi/4,1", "--json", "--out", tmp_path / "o")
    assert (code, json.loads(out)["verdict"]["reason"]) == (3, "not_an_equilibrium")
    code, out, _ = design(PENDULUM, "--target", "pi/4,1", "--out", tmp_path / "o")
    assert code == 3
    assert "nearest" in out


def test_out_of_reach_curvature_is_lowered_and_said(tmp_path):
    code, out, _ = design(PENDULUM, "--target", "pi/4", "--a", "7", "--json", "--no-plots",
                          "--out", tmp_path)  # fmt: skip
    data = json.loads(out)
    assert code == 0
    assert data["design"]["a_requested"] == 7.0
    assert data["design"]["a"] < data["verdict"]["a_max"]
    assert any("a_max" in note for note in data["notes"])


def test_parameters_from_the_command_line(tmp_path):
    path = model(tmp_path, 'k = sp.Symbol("k"); H = p**2 / 2 + k * q**4; params = {k: 1}')
    for value, kind in (("2", 0), ("0.5", 0)):
        code, _, _ = design(path, "--target", "1", "--param", f"k={value}", "--check")
        assert code == kind
    for text in ("k=", "k=abc", "k", "=3", "b=1", "k=1e400"):
        result = design(path, "--target", "1", "--param", text, "--check", "--json")
        check_refusal(result, "param")


# --- bad input -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("code", "text", "piece"), FAULTS, ids=[f"{c}: {t[:40]}" for c, t, _ in FAULTS]
)
def test_every_fault_of_a_model_file(tmp_path, code, text, piece):
    result = design(model(tmp_path, text), "--target", "pi/4", "--json", "--out", tmp_path / "o")
    check_refusal(result, code, piece.split("\n")[0])
    assert not (tmp_path / "o").exists()


@pytest.mark.parametrize(("code", "text", "target", "piece"), FAULTS_AT_TARGET)
def test_faults_that_show_at_the_target(tmp_path, code, text, target, piece):
    result = design(model(tmp_path, text), "--target", target, "--json", "--out", tmp_path / "o")
    check_refusal(result, code, piece)
    assert not (tmp_path / "o").exists()


@pytest.mark.parametrize(
    ("code", "text", "target"),
    [
        ("j_not_skew", "J = sp.Matrix([[0, 2], [0, 0]])", "pi/4"),
        ("model_file", "1 / 0", "pi/4"),
        ("duplicate_state", "", "q=1,q=2"),
    ],
)
def test_bad_input_as_a_process(tmp_path, code, text, target):
    done = process(DESIGN, model(tmp_path, text), "--target", target, "--json", cwd=tmp_path)
    check_refusal((done.returncode, done.stdout, done.stderr), code)
    assert [path.name for path in tmp_path.iterdir() if path.is_dir()] == []
    code_here, out, err = design(model(tmp_path, text), "--target", target)
    assert (code_here, out, err) == (2, "", done.stderr)


@pytest.mark.parametrize(
    "arguments",
    [
        ["--a", "0"], ["--a", "-1"], ["--a", "nan"], ["--a", "inf"], ["--a", "much"],
        ["--starts", "0"], ["--seed", "-1"], ["--hidden-k", "0"], ["--hidden-k", "64,"],
        ["--hidden-h", "a"], ["--activation", "relu"], ["--phi", "cubic"],
        ["--casimir-form", "both"], ["--damping", "0"], ["--damping", "-1"], ["--damping", "1,2"],
        ["--damping", ""], ["--controller-damping", "nan"], ["--sweep-a", "1:2"],
        ["--sweep-a", "0:1:3"], ["--sweep-a", "2:1:3"], ["--sample-time", "0"],
        ["--sample-time", "nan"], ["--sample-time", "inf"], ["--real", "half"], ["--elsewhere"],
        ["one", "too", "many"], ["--integrator", "casimir"],
        ["--integrator", "casimir", "--sample-time", "1", "--phi", "neural"],
        ["--integrator", "casimir", "--sample-time", "1", "--casimir-form", "sum"],
    ],
    ids=" ".join,
)  # fmt: skip
def test_options_that_make_no_sense(tmp_path, arguments):
    result = design(PENDULUM, "--target", "pi/4", "--json", "--out", tmp_path / "o", *arguments)
    check_refusal(result, "usage")
    assert not (tmp_path / "o").exists()


@pytest.mark.parametrize(
    ("name", "why"), [("dc_motor", "Jc and Rc are not 0"), ("parallel_rlc", "held by another")]
)
def test_casimirs_cannot_be_kept_of_every_loop(tmp_path, name, why):
    """Before any training."""
    options = ("--integrator", "casimir", "--sample-time", "0.01", "--json")
    path = PENDULUM.parent / f"{name}.py"
    result = design(path, *options, "--out", tmp_path / "o")
    check_refusal(result, "usage", why)
    assert not (tmp_path / "o").exists()


def test_no_model_and_no_target(tmp_path):
    check_refusal(design("--json"), "usage")
    check_refusal(design(PENDULUM, "--json"), "usage", "--target")
    check_refusal(design(tmp_path / "none.py", "--target", "1", "--json"), "model_file")
    check_refusal(design(tmp_path, "--target", "1", "--json"), "model_file")


@given(st.text(max_size=20))
@example("--check")
@example("-")
@example("\0")
@example("\udcff")
@example("1e999999999")
@example("((10**1000)**1000)**1000")
@example("exp(exp(1000))")
@settings(max_examples=60, deadline=None)
def test_no_target_text_is_an_internal_fault(text):
    code, out, err = design(PENDULUM, "--check", "--json", f"--target={text}")
    assert code in (0, 2, 3, 4), err
    assert "Traceback" not in err
    data = json.loads(out)
    if code == 2:
        assert re.fullmatch(r"target_\w+|duplicate_state|usage|singular|not_real",
                            data["error"]["code"])  # fmt: skip


# --- folders -------------------------------------------------------------------------------------


def test_an_output_folder_that_cannot_be_made(tmp_path):
    """A path below a regular file: nobody can write there, not even root."""
    (tmp_path / "file").write_text("mine")
    for out in (tmp_path / "file" / "below", tmp_path / "file"):
        done = process(DESIGN, PENDULUM, "--target", "pi/4", "--json", "--out", out, cwd=tmp_path)
        check_refusal((done.returncode, done.stdout, done.stderr), "output", str(out))
    assert (tmp_path / "file").read_text() == "mine"
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


@pytest.mark.parametrize("name", ["design.json", "certificate.json", "c/necc.c"])
def test_a_file_that_cannot_be_replaced(tmp_path, name):
    """A folder of the user's stands where a file should go: kept, and no temporary file stays."""
    (tmp_path / name / "inside").mkdir(parents=True)
    result = design(PENDULUM, "--target", "pi/4", "--json", "--no-plots", "--out", tmp_path)
    check_refusal(result, "output", Path(name).name)
    assert (tmp_path / name / "inside").is_dir()
    assert not list(tmp_path.rglob(".*"))


def test_designing_twice_replaces_the_files_and_changes_nothing_else(tmp_path):
    for seed in (0, 1):
        code, _, err = design(PENDULUM, "--target", "pi/4", *SMALL, "--no-plots", "--seed", seed,
                              "--out", tmp_path)  # fmt: skip
        assert code == 0, err
        (tmp_path / "c" / "mine.c").write_text("mine")
    assert (tmp_path / "c" / "mine.c").read_text() == "mine"
    assert not list(tmp_path.rglob(".*"))


@pytest.mark.parametrize("given", [("--out", ""), ("--out", " "), ("",)])
def test_an_empty_path_is_refused(tmp_path, monkeypatch, given):
    """It would mean the working directory."""
    monkeypatch.chdir(tmp_path)
    arguments = given if given == ("",) else (PENDULUM, *given)
    check_refusal(design(*arguments, "--target", "pi/4", "--json"), "output", "is empty")
    assert not list(tmp_path.iterdir())


# --- help ----------------------------------------------------------------------------------------


def test_every_option_of_the_contract_is_in_help():
    _, out, _ = design("--help")
    for option in (
        "target",
        "check",
        "json",
        "out",
        "paper",
        "hidden-k",
        "hidden-h",
        "activation",
        "casimir-form",
        "phi",
        "a",
        "seed",
        "starts",
        "param",
        "damping",
        "controller-damping",
        "no-plots",
        "sweep-a",
        "sample-time",
        "real",
        "debug",
    ):
        assert f"--{option}" in out  # fmt: skip
