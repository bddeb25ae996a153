"""The commands as processes: exit codes, code words, clean stdout, nothing half-written."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from helpers.commands import DESIGN, SIMULATE, check_refusal, design, here, process
from helpers.models import BASE, FAULTS, FAULTS_AT_TARGET
from helpers.problems import PENDULUM
from hypothesis import example, given, settings
from hypothesis import strategies as st

from necc_casadi.cli.simulate import _simulate

BLOCKS = {"status", "plant", "controller", "target", "verdict", "design", "certificate", "files",
          "timings"}  # fmt: skip
VERDICT = {"assignable", "reason", "stability", "a_max", "casimirs", "casimir_count",
           "kernel_rank", "casimir_count_generic"}  # fmt: skip
MADE = {"xi_star", "a", "a_requested", "loss", "gradient_norm", "hessian_min_eig", "z_bar",
        "distance", "bound_paper", "bound_rigorous", "spectral_abscissa", "stability"}  # fmt: skip
CERTIFICATE = {"claims", "level", "level_u", "limited_by", "domain_share",
               "simulated_share", "global"}  # fmt: skip


def simulate(*arguments):
    return here(_simulate, *arguments)


def model(folder, text="") -> Path:
    path = folder / "plant.py"
    path.write_text(BASE + text + "\n", encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """The main job, once, as a process: (folder, its result)."""
    folder = tmp_path_factory.mktemp("job")
    own = folder / "pendulum-design"
    own.mkdir()
    (own / "notes.txt").write_text("mine")
    return folder, process(DESIGN, PENDULUM, "--target", "pi/4", cwd=folder)


# --- the main job --------------------------------------------------------------------------------


def test_the_main_job_prints_a_summary_and_nothing_else(made):
    _, done = made
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    for word in ("certified", "q - xi1", "xi1*", "ε", "z̄", "proved", "abscissa", "settle",
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
    assert done.stderr == "noise\n"


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
    code, out, _ = design(path, "--target", "q=pi/4", "--json", "--out", tmp_path / "o")
    data = json.loads(out)
    assert (code, data["status"]) == (3, "refused")
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
        ["one", "too", "many"],
    ],
    ids=" ".join,
)  # fmt: skip
def test_options_that_make_no_sense(tmp_path, arguments):
    result = design(PENDULUM, "--target", "pi/4", "--json", "--out", tmp_path / "o", *arguments)
    check_refusal(result, "usage")
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
        began = time.perf_counter()
        done = process(DESIGN, PENDULUM, "--target", "pi/4", "--json", "--out", out, cwd=tmp_path)
        check_refusal((done.returncode, done.stdout, done.stderr), "output", str(out))
        assert time.perf_counter() - began < 30
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
    for seed in (0, 1, 0):
        code, _, err = design(PENDULUM, "--target", "pi/4", "--no-plots", "--seed", seed,
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


def test_a_fault_of_ours_is_one_json_object_too(monkeypatch):
    """Exit 1, the fault in words, where to look; never a traceback without --debug."""
    from necc_casadi.pipeline import run as pipeline

    def broken(*_):
        raise ZeroDivisionError("division\nby zero")

    monkeypatch.setattr(pipeline, "run_design", broken)
    code, out, err = design(PENDULUM, "--target", "pi/4", "--json")
    assert code == 1
    assert json.loads(out)["status"] == "error"
    assert json.loads(out)["error"]["code"] == "internal"
    assert "ZeroDivisionError: division by zero" in json.loads(out)["error"]["message"]
    assert err.splitlines()[0].endswith("ZeroDivisionError: division by zero")
    assert len(err.splitlines()) == 2
    code, out, err = design(PENDULUM, "--target", "pi/4")
    assert (code, out) == (1, "")


# --- interruption --------------------------------------------------------------------------------


@pytest.mark.parametrize("delay", [0.0, 0.7, 2.0])
def test_interrupting_leaves_nothing_half_written(tmp_path, delay):
    """SIGINT to the whole group while judging, compiling or training: 130, no temporary files."""
    path = model(tmp_path, 'print("loaded", flush=True)')
    child = subprocess.Popen(
        [sys.executable, "-c", DESIGN, str(path), "--target", "pi/4", "--starts", "1000",
         "--hidden-k", "64,64", "--hidden-h", "32,32", "--json"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=tmp_path,
        start_new_session=True,
        # a shell starts its background jobs, and so perhaps these tests, with SIGINT ignored
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )  # fmt: skip
    try:
        assert child.stderr.readline() == "loaded\n"
        time.sleep(delay)
        os.killpg(child.pid, signal.SIGINT)
        out, err = child.communicate(timeout=60)
    finally:
        child.kill()
    assert child.returncode == 130, err
    assert "Traceback" not in err
    assert json.loads(out)["error"]["code"] == "interrupted"
    for path in tmp_path.rglob("*.json"):
        json.loads(path.read_text())
    assert not list(tmp_path.rglob(".*"))


# --- necc-simulate -------------------------------------------------------------------------------


def test_simulate_as_a_process(made, tmp_path):
    out = made[0] / "pendulum-design"
    done = process(SIMULATE, out, "--x0", "-1,0.5", "--time", "20", "--csv", "r.csv", "--json",
                   "--points", "11", cwd=tmp_path)  # fmt: skip
    assert done.returncode == 0, done.stderr
    data = json.loads(done.stdout)
    assert data["states"] == ["q", "p", "xi1"]
    assert data["t_end"] == 20.0
    assert data["z_end"][0] == pytest.approx(0.7853981633974483, abs=1e-3)
    lines = (tmp_path / "r.csv").read_text().splitlines()
    assert lines[0] == "t,q,p,xi1,u1,V"
    assert len(lines) == 12
    assert [float(v) for v in lines[1].split(",")][:3] == [0.0, -1.0, 0.5]


def test_simulate_prints_csv_and_nothing_else(made):
    code, out, _ = simulate(made[0] / "pendulum-design", "--csv", "-", "--points", "5")
    assert code == 0
    assert out.startswith("t,q,p,xi1,u1,V\n")
    assert len(out.splitlines()) == 6


@pytest.mark.parametrize(
    "arguments",
    [["--x0", "1"], ["--x0", "nan,0"], ["--x0", "1,2,3"], ["--x0", ""], ["--xi0", "1,2"],
     ["--time", "0"], ["--time", "nan"], ["--time", "inf"], ["--points", "1"], ["--x0", "1e400,0"],
     ["--csv", "-"]],
    ids=" ".join,
)  # fmt: skip
def test_simulate_refuses(made, arguments):
    """`--csv -` beside `--json`: stdout can hold only one of them."""
    check_refusal(simulate(made[0] / "pendulum-design", "--json", *arguments), "usage")


def test_simulate_refuses_folders_and_files(made, tmp_path):
    (tmp_path / "file").write_text("{}")
    check_refusal(simulate(tmp_path, "--json"), "output")
    check_refusal(simulate(tmp_path / "file", "--json"), "output")
    out = made[0] / "pendulum-design"
    check_refusal(simulate(out, "--json", "--csv", tmp_path / "file" / "r.csv"), "output")
    check_refusal(simulate(out, "--json", "--plot", tmp_path / "file" / "r.png"), "output")


def test_a_response_that_diverges_is_an_outcome(made):
    """Far away the sums overflow: an outcome with its exit code, never a traceback."""
    code, out, err = simulate(made[0] / "pendulum-design", "--json", "--x0", "1e200,0")
    assert code in (0, 4), err
    json.loads(out, parse_constant=lambda word: pytest.fail(f"{word} is not JSON"))


# --- help ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(("code", "name"), [(DESIGN, "necc-design"), (SIMULATE, "necc-simulate")])
def test_help_and_version(code, name, tmp_path):
    helped = process(code, "--help", cwd=tmp_path)
    assert helped.returncode == 0
    assert helped.stderr == ""
    assert "--json" in helped.stdout
    version = process(code, "--version", cwd=tmp_path)
    assert version.returncode == 0
    assert name in version.stdout


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


def test_the_console_scripts_are_there():
    scripts = Path(sys.executable).parent
    for name in ("necc-design", "necc-simulate"):
        if (scripts / name).exists():
            done = subprocess.run([scripts / name, "--version"], capture_output=True, text=True)
            assert done.returncode == 0
            assert done.stdout.startswith(name)


def test_a_reader_that_leaves_early_is_no_fault(made):
    out = made[0] / "pendulum-design"
    child = subprocess.Popen(
        [sys.executable, "-c", SIMULATE, str(out), "--csv", "-", "--points", "20000"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    child.stdout.readline()
    child.stdout.close()
    err = child.stderr.read()
    child.stderr.close()
    assert child.wait(timeout=60) == 0
    assert err == ""
