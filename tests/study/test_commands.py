"""necc-montecarlo and necc-sweep as processes: killed, run again, without Dask."""

import csv
import json
import os
import signal
import subprocess
import sys
import time

import pytest
from helpers.commands import here

from necc_casadi import run as run_once
from necc_casadi.cli.montecarlo import _montecarlo
from necc_casadi.cli.sweep import _sweep
from necc_casadi.study.rows import ROWS


def command(name, *arguments):
    return [sys.executable, "-m", "necc_casadi", name, *map(str, arguments)]


def done(name, *arguments, **environment):
    return subprocess.run(
        command(name, *arguments), capture_output=True, text=True, timeout=240,
        env={**os.environ, **environment},
    )  # fmt: skip


def table(folder, name="table.csv"):
    with (folder / name).open(encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


@pytest.fixture(scope="module")
def whole(weighed, tmp_path_factory):
    """A Monte Carlo study that nobody disturbed: (folder, its process)."""
    out = tmp_path_factory.mktemp("whole") / "study"
    return out, done(
        "montecarlo", weighed[1], "--vary", "m=10%", "-n", 40, "--starts", 3, "--out", out,
        "--workers", 2, "--json",
    )  # fmt: skip


def test_a_study_is_a_table_and_a_figure(whole):
    out, process = whole
    assert process.returncode == 0, process.stderr
    assert process.stderr == ""  # quiet on a pipe
    answer = json.loads(process.stdout)
    assert {path.name for path in out.iterdir()} == set(answer["files"])
    rows = table(out)
    assert [row["row"] for row in rows] == [str(k) for k in range(40)]
    assert sorted(map(str, table(out, ROWS))) == sorted(map(str, rows))
    assert answer["rows"] == 40
    assert answer["settled"] == sum(row["settled"] == "true" for row in rows)
    assert answer["peak"]["u"] == max(float(row["peak_u"]) for row in rows)
    assert (out / "study.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="no SIGKILL there")
def test_a_study_that_is_killed_goes_on(weighed, whole, tmp_path):
    """Nothing is lost, nothing is done twice, and the table is the undisturbed one."""
    out = tmp_path / "study"
    arguments = (weighed[1], "--vary", "m=10%", "-n", 40, "--starts", 3, "--out", out)
    process = subprocess.Popen(
        command("montecarlo", *arguments, "--workers", 1),
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    until = time.monotonic() + 120
    while time.monotonic() < until and process.poll() is None:
        if (out / ROWS).is_file() and (out / ROWS).read_bytes().count(b"\n") > 4:
            break
        time.sleep(0.002)
    process.send_signal(signal.SIGKILL)
    process.wait(timeout=60)
    before = (out / ROWS).read_bytes()
    kept = before[: before.rfind(b"\n") + 1]
    assert 4 < kept.count(b"\n") < 41
    again = done("montecarlo", *arguments, "--workers", 2)
    assert again.returncode == 0, again.stderr
    after = (out / ROWS).read_bytes()
    assert after.startswith(kept)
    assert after.count(b"\n") == 41
    assert (out / "table.csv").read_bytes() == (whole[0] / "table.csv").read_bytes()
    third = done("montecarlo", *arguments)
    assert third.returncode == 0
    assert (out / ROWS).read_bytes() == after


@pytest.mark.slow
def test_a_study_on_a_scheduler_that_runs_elsewhere(weighed, whole, tmp_path):
    code = (
        "from distributed import LocalCluster\n"
        "if __name__ == '__main__':\n"
        "    with LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=None,\n"
        "                      host='127.0.0.1', silence_logs=50) as cluster:\n"
        "        print(cluster.scheduler_address, flush=True)\n"
        "        input()\n"
    )
    script = tmp_path / "cluster.py"
    script.write_text(code, encoding="utf-8")
    cluster = subprocess.Popen(
        [sys.executable, script], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    try:
        address = cluster.stdout.readline().strip()
        out = tmp_path / "study"
        process = done(
            "montecarlo", weighed[1], "--vary", "m=10%", "-n", 40, "--starts", 3, "--out", out,
            "--scheduler", address,
        )  # fmt: skip
        assert process.returncode == 0, process.stderr
        assert (out / "table.csv").read_bytes() == (whole[0] / "table.csv").read_bytes()
    finally:
        cluster.communicate("\n", timeout=60)


def test_without_dask_one_line_says_so(weighed, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    code, out, err = here(
        _montecarlo, weighed[1], "--vary", "m=10%", "--out", tmp_path / "o", "--json"
    )
    assert code == 2
    assert json.loads(out)["error"]["code"] == "usage"
    assert err.splitlines() == [
        "error [usage]: studies run on Dask, which is not installed",
        "  Install it: python -m pip install 'necc-casadi[study]'.",
    ]


@pytest.mark.slow  # waits for ten seconds
def test_a_scheduler_that_does_not_answer_is_named(weighed, tmp_path):
    process = done(
        "montecarlo", weighed[1], "--vary", "m=10%", "--out", tmp_path / "o",
        "--scheduler", "tcp://127.0.0.1:9",
    )  # fmt: skip
    assert process.returncode == 2
    assert process.stderr.startswith("error [usage]: --scheduler tcp://127.0.0.1:9: nobody answers")
    assert len(process.stderr.splitlines()) == 2


def test_a_sweep_has_a_row_for_every_design(weighed, tmp_path):
    """Each what one run finds; targets that are refused or that are none have rows, too."""
    model, _ = weighed
    out = tmp_path / "sweep"
    process = done(
        "sweep", model, "--vary", "q=0,pi/4,4", "--vary", "p=0,1", "--vary", "m=1,2", "--check",
        "--out", out,
    )  # fmt: skip
    assert process.returncode == 0, process.stderr
    rows = table(out)
    assert len(rows) == 12
    assert {row["status"] for row in rows if row["p"] == "0.0"} == {"assignable"}
    assert {row["reason"] for row in rows if row["p"] == "1.0"} == {"not_an_equilibrium"}
    for row in (rows[0], rows[5]):
        single = run_once(
            model, {"q": float(row["q"]), "p": float(row["p"])}, check=True,
            param={"m": float(row["m"])},
        )  # fmt: skip
        assert float(row["a_max"]) == pytest.approx(single.verdict.a_max, rel=1e-9)
    assert "8 assignable" not in process.stdout
    assert "6 assignable, 6 refused" in process.stdout


@pytest.mark.slow
def test_a_sweep_designs_as_the_command_does(weighed, tmp_path):
    model, _ = weighed
    out = tmp_path / "sweep"
    process = done(
        "sweep", model, "--vary", "target=0.5,0.75", "--seeds", "3:5", "--hidden-k", "8",
        "--hidden-h", "6", "--out", out, "--workers", 1,
    )  # fmt: skip
    assert process.returncode == 0, process.stderr
    rows = table(out)
    assert [(row["target"], row["seed"]) for row in rows] == [
        ("0.5", "3"), ("0.5", "4"), ("0.75", "3"), ("0.75", "4"),
    ]  # fmt: skip
    single = run_once(model, 0.75, seed=4, hidden_k=(8,), hidden_h=(6,))
    assert float(rows[3]["loss"]) == single.findings.measures.loss
    assert float(rows[3]["settling_time"]) == max(r.settling_time for r in single.responses)
    assert rows[3]["proved"].split() == [c.name for c in single.claims if c.holds]
    assert rows[3]["status"] == single.status


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--vary", "k=0:1:2"], "there is no k to vary"),
        (["--vary", "target=0:1:2", "--target", "1"], "there is no target to vary"),
        (["--vary", "q=0:1:2", "--target", "1"], "there is no q to vary"),
        (["--vary", "m=1:2:2", "--seeds", "x"], "--seeds x is not FROM:TO"),
        (["--vary", "m=1:2:2", "--rate", "1", "--settle", "2"], "both ask for a speed"),
    ],
)
def test_what_cannot_be_swept_is_named_before_anything_runs(weighed, tmp_path, arguments, message):
    code, _, err = here(_sweep, weighed[0], *arguments, "--out", tmp_path / "o")
    assert code == 2
    assert message in err
    assert not (tmp_path / "o").exists()
