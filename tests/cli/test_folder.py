"""The folder of a run as a user meets it: whole, the run's own, and the same for the same input."""

import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from helpers.commands import CERTIFY, DESIGN, check_refusal, design, here, process
from helpers.problems import PENDULUM

from necc_casadi.cli.certify import _certify
from necc_casadi.files import hash_of, read_listing

SMALL = ("--target", "pi/4", "--hidden-k", "8", "--hidden-h", "6")


def run(out, *arguments, **options):
    done = process(DESIGN, PENDULUM, *SMALL, "--out", out, "--json", *arguments, **options)
    assert "Traceback" not in done.stderr
    return done


def check_whole(out) -> str:
    """Files of one run, all of them, as its list says; the hash of the design."""
    listed = read_listing(out)
    for path, digest in listed.items():
        assert hash_of(out / path) == digest, path
    digest = listed["design.json"]
    certificate = listed["certificate.json"]
    assert digest in (out / "certificate.json").read_text(encoding="utf-8")
    assert digest in (out / "c" / "necc.c").read_text(encoding="utf-8")
    header = (out / "c" / "necc.h").read_text(encoding="utf-8")
    assert digest in header
    assert certificate in header
    return digest


def test_the_same_input_gives_the_same_bytes(tmp_path):
    """Whatever the order in which a process meets names, and however long it takes."""
    for seed in ("1", "2"):
        done = run(
            tmp_path / seed, "--no-plots", "--fmu", cwd=tmp_path,
            env={**os.environ, "PYTHONHASHSEED": seed},
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        assert json.loads(done.stdout)["timings"]["solve"] > 0
        assert json.loads(done.stdout)["design"]["starts"][0]["seconds"] > 0
    one, other = ({**read_listing(tmp_path / seed)} for seed in ("1", "2"))
    for listed in (one, other):
        del listed["c/README.md"]  # holds times that were measured on this machine
    assert one == other


@pytest.mark.slow
def test_a_rerun_leaves_nothing_of_the_earlier_one(tmp_path):
    out = tmp_path / "out"
    assert run(out, cwd=tmp_path).returncode == 0
    first = check_whole(out)
    assert (out / "figures").is_dir()
    (out / "notes.txt").write_text("mine")
    done = run(out, "--no-plots", "--seed", "1", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert check_whole(out) != first
    assert not (out / "figures").exists()
    assert (out / "notes.txt").read_text() == "mine"
    assert set(json.loads(done.stdout)["files"]) == {*read_listing(out), "files.json"}
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


@pytest.mark.parametrize("name", ["design.json", "c/necc.h", "figures/lyapunov.png", "files.json"])
def test_a_file_of_the_user_is_refused_before_any_training(tmp_path, name):
    path = tmp_path / "out" / name
    path.parent.mkdir(parents=True)
    path.write_text("mine")
    began = time.perf_counter()
    asked = (PENDULUM, *SMALL, "--out", tmp_path / "out", "--json", "--starts", "1000")
    check_refusal(design(*asked), "output", str(path))
    assert time.perf_counter() - began < 100, "a thousand starts take minutes"
    assert path.read_text() == "mine"


def test_a_file_that_was_changed_by_hand_is_refused(tmp_path):
    asked = (PENDULUM, *SMALL, "--out", tmp_path / "out", "--json", "--no-plots")
    assert design(*asked)[0] == 0
    with (tmp_path / "out" / "c" / "main.c").open("a") as stream:
        stream.write("/* mine */\n")
    check_refusal(design(*asked), "output", "changed by hand")
    assert (tmp_path / "out" / "c" / "main.c").read_text().endswith("/* mine */\n")


@pytest.mark.slow
def test_the_working_folder_as_output(tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    for arguments in ((), ("--no-plots",)):
        done = run(".", *arguments, cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        check_whole(tmp_path)
    assert not (tmp_path / "figures").exists()
    assert (tmp_path / "notes.txt").read_text() == "mine"
    assert process(CERTIFY, ".", cwd=tmp_path).returncode == 0


def start(out, seed):
    return subprocess.Popen(
        [sys.executable, "-c", DESIGN, str(PENDULUM), *SMALL, "--no-plots", "--out", str(out),
         "--seed", str(seed)],
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip


def finished(child) -> int:
    child.communicate()
    return child.returncode


@pytest.mark.slow
def test_a_hundred_kills_of_a_rerun(tmp_path):
    """SIGKILL at a random moment: the old folder or the new one, complete; nothing is lost."""
    out, dice = tmp_path / "out", random.Random(0)
    began = time.perf_counter()
    assert finished(start(out, 0)) == 0
    whole = time.perf_counter() - began
    hashes = {check_whole(out)}
    assert finished(start(out, 1)) == 0
    hashes.add(check_whole(out))
    (out / "notes.txt").write_text("mine")
    for number in range(100):
        child = start(out, number % 2)
        time.sleep(dice.uniform(0.2, 1.1) * whole)
        child.send_signal(signal.SIGKILL)
        child.communicate()
        assert check_whole(out) in hashes
        assert (out / "notes.txt").read_text() == "mine"
    assert finished(start(out, 0)) == 0
    check_whole(out)
    assert (out / "notes.txt").read_text() == "mine"
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


# --- what necc-certify says of c/ ----------------------------------------------------------------


@pytest.fixture
def copied(made, tmp_path):
    return Path(shutil.copytree(made[0] / "pendulum-design", tmp_path / "copy"))


def code_claim(folder):
    code, text, _ = here(_certify, folder, "--json")
    claims = {claim["name"]: claim for claim in json.loads(text)["claims"]}
    return code, claims["code"]["holds"], claims["code"]["statement"]


def test_the_code_is_compared(copied):
    code, holds, statement = code_claim(copied)
    assert (code, holds) == (0, True)
    assert "what the code computes is left to c/selftest.c" in statement


def replace(path, old, new):
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new), encoding="utf-8")


def another_header(folder):
    path = folder / "c" / "necc.h"
    replace(path, hash_of(folder / "design.json"), "0" * 64)
    relist(folder, "c/necc.h")


def another_source(folder):
    path = folder / "c" / "necc.c"
    replace(path, hash_of(folder / "design.json"), "0" * 64)
    relist(folder, "c/necc.c")


def another_certificate(folder):
    replace(folder / "c" / "necc.h", hash_of(folder / "certificate.json"), "0" * 64)
    relist(folder, "c/necc.h")


def relist(folder, name):
    """Let the list say what the file is now: only the hashes inside can tell."""
    data = json.loads((folder / "files.json").read_text(encoding="utf-8"))
    data["files"][name] = hash_of(folder / name)
    (folder / "files.json").write_text(json.dumps(data), encoding="utf-8")


CHANGED = {
    "c/necc.c was changed": lambda f: replace(f / "c" / "necc.c", "R(0.5)", "R(0.6)"),
    "c/main.c was changed": lambda f: (f / "c" / "main.c").unlink(),
    "c/necc.h is not of this design.json": another_header,
    "c/necc.c is not of this design.json": another_source,
    "c/necc.h is not of this certificate.json": another_certificate,
    "files.json does not list the code": lambda f: (f / "files.json").unlink(),
    "c/ cannot be read": lambda f: (f / "c" / "necc.c").unlink(),
}


@pytest.mark.parametrize("said", CHANGED)
def test_code_that_was_changed_is_found(copied, said):
    CHANGED[said](copied)
    code, holds, statement = code_claim(copied)
    assert (code, holds) == (4, False)
    assert statement.startswith(said)


def test_a_certificate_without_code_says_nothing_of_it(made, tmp_path):
    for name in ("design.json", "certificate.json"):
        shutil.copy(made[0] / "pendulum-design" / name, tmp_path)
    code, text, _ = here(_certify, tmp_path, "--json")
    assert code == 0
    assert "code" not in {claim["name"] for claim in json.loads(text)["claims"]}
