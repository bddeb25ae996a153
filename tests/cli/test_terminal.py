"""What every command does: help, faults, interruption, and stdout for the result alone."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import click
import pytest
from helpers.commands import CERTIFY, DESIGN, SIMULATE, design, here, process
from helpers.models import model
from helpers.problems import PENDULUM

from necc_casadi.cli.terminal import columns

# --- help ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("code", "name"),
    [(DESIGN, "necc-design"), (SIMULATE, "necc-simulate"), (CERTIFY, "necc-certify")],
)
def test_help_and_version(code, name, tmp_path):
    helped = process(code, "--help", cwd=tmp_path)
    assert helped.returncode == 0
    assert helped.stderr == ""
    assert "--json" in helped.stdout
    version = process(code, "--version", cwd=tmp_path)
    assert version.returncode == 0
    assert name in version.stdout


def test_the_console_scripts_are_there():
    scripts = Path(sys.executable).parent
    for name in ("necc-design", "necc-simulate", "necc-certify"):
        if (scripts / name).exists():
            done = subprocess.run([scripts / name, "--version"], capture_output=True, text=True)
            assert done.returncode == 0
            assert done.stdout.startswith(name)


# --- faults --------------------------------------------------------------------------------------


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


SWALLOWED = """
import os, signal, sys
from necc_casadi.cli.design import design_command
class Finder:
    def find_spec(self, name, *_):
        if name == "casadi":
            try:  # as CasADi itself: it has bare excepts where it starts
                os.kill(os.getpid(), signal.SIGINT)
                sum(range(1000))
            except BaseException:
                pass
signal.signal(signal.SIGINT, signal.default_int_handler)
sys.meta_path.insert(0, Finder())
design_command()
"""


def test_an_interrupt_while_casadi_is_loaded_is_not_lost(tmp_path):
    """The run ends there, before anything is designed or written."""
    arguments = [str(model(tmp_path, "")), "--target", "pi/4", "--no-plots", "--out", "out"]
    done = subprocess.run(
        [sys.executable, "-c", SWALLOWED, *arguments],
        capture_output=True, text=True, cwd=tmp_path, timeout=120,
    )  # fmt: skip
    assert done.returncode == 130, done.stderr
    assert not (tmp_path / "out").exists()


def test_an_interrupt_while_a_redirection_ends_leaves_stdout_to_the_result():
    """`contextlib.redirect_stdout` may not get to the end of its own exit."""

    @click.command()
    @click.option("--json", is_flag=True)
    def interrupted(json):
        sys.stdout = sys.stderr
        raise KeyboardInterrupt

    before = sys.stdout
    code, out, err = here(interrupted, "--json")
    assert code == 130
    assert json.loads(out)["error"]["code"] == "interrupted"
    assert err.strip().startswith("interrupted; ")
    assert sys.stdout is before


# --- width ---------------------------------------------------------------------------------------


def test_the_page_is_as_wide_as_the_terminal(monkeypatch):
    for given_columns, expected in (("80", 80), ("300", 98), ("20", 60)):
        monkeypatch.setenv("COLUMNS", given_columns)
        assert columns() == expected
