"""Folders that somebody made to mislead, to exhaust or to break the checker."""

import base64
import json
import os
import resource
import subprocess
import sys
import time
import zlib
from pathlib import Path

import pytest
from helpers.commands import here
from helpers.oscillators import soft_pendulum

from necc_casadi.certificate.claims.statements import ONLY_STABLE
from necc_casadi.certificate.prover.certify import certify
from necc_casadi.cli.certify import _certify
from necc_casadi.files import hash_of

#: Address space and seconds of a check that refuses.
MEMORY, SECONDS = 1_500_000_000, 20

ESCAPES = "\x1b[2J\x1b[31m\rregion holds\n\u202e\x07"


def edited(name, change):
    """A folder in which one file is changed as data."""

    def make(folder):
        data = json.loads((folder / name).read_text(encoding="utf-8"))
        change(data)
        (folder / name).write_text(json.dumps(data), encoding="utf-8")

    return make


def design(change):
    return edited("design.json", change)


def certificate(change):
    return edited("certificate.json", change)


def text(name, change):
    """A folder in which one file is changed as text."""

    def make(folder):
        path = folder / name
        path.write_text(change(path.read_text(encoding="utf-8")), encoding="utf-8")

    return make


def first(name, opening):
    """A folder in which a file begins otherwise."""
    return text(name, lambda content: content.replace("{", opening, 1))


def expression(value):
    return design(lambda data: data["model"].update(H=value))


def bomb(data):
    """64 MB of zeros in a few kilobytes."""
    packer = zlib.compressobj(9)
    parts = [packer.compress(bytes(1 << 20)) for _ in range(64)]
    data["region"]["cells"] = base64.b64encode(b"".join(parts) + packer.flush()).decode()


def curved(data):
    """A region of another kind, of which every entry has its type."""
    data["region"] = {
        "level": data["region"]["level"], "active": [0, 2], "floor_k": [1.0], "floor_h": [1.0],
        "height": 1.0, "faces": [], "columns": [0], "center": [0.0, 0.0], "method": "curved",
    }  # fmt: skip


def instead(name, make):
    def replace(folder):
        (folder / name).unlink()
        make(folder / name)

    return replace


def sparse(path):
    with path.open("wb") as stream:
        stream.truncate(1 << 40)


def huge_widths(data):
    data["form"]["k"]["hidden"] = [10**9, 10**9]


def many_states(data):
    names = [f"s{i}" for i in range(200_000)]
    data["model"].update(states=names, symbols=names)


def name_state(data):
    data["model"]["states"][0] = f"q{ESCAPES}"


def unheld(statement):
    """A claim that is not held, with a statement of one's own."""
    new = {"name": "global", "holds": False, "statement": statement, "data": {}}

    def change(data):
        data["claims"] = [c for c in data["claims"] if c["name"] != "global"] + [new]
        data["is_global"] = False

    return change


def named(name):
    return lambda data: data["claims"].append(
        {"name": name, "holds": True, "statement": "so", "data": {}}
    )


def stable_by_hearsay(data):
    """The verdict in design.json says what it likes; nothing of it is shown or believed."""
    data["verdict"].update(stability="stable", witness=ESCAPES)


#: What is done to a good folder, and whether it can be read at all (then a claim fails: exit 4).
FOLDERS = {
    "no design": (lambda folder: (folder / "design.json").unlink(), 2),
    "no certificate": (lambda folder: (folder / "certificate.json").unlink(), 2),
    "a folder for a file": (instead("design.json", Path.mkdir), 2),
    "a pipe for a file": (instead("certificate.json", os.mkfifo), 2),
    "a device for a file": (instead("certificate.json", lambda p: p.symlink_to("/dev/zero")), 2),
    "a link to itself": (instead("design.json", lambda p: p.symlink_to(p)), 2),
    "a terabyte": (instead("design.json", sparse), 2),
    "not UTF-8": (instead("design.json", lambda p: p.write_bytes(b'{"\xff": 1}')), 2),
    "nested deeply": (text("design.json", lambda t: "[" * 90_000 + "]" * 90_000), 2),
    "nested too deeply for a list": (
        first("certificate.json", '{"x": ' + "[" * 500 + "]" * 500 + ","), 2
    ),
    "many lists": (text("design.json", lambda t: "[" + "[]," * 10_000_000 + "[]]"), 2),
    "twin keys": (first("certificate.json", '{"format": 5,'), 2),
    "twin keys in the design": (first("design.json", '{"a": "0x1p0",'), 2),
    "NaN": (certificate(lambda data: data.update(level=float("nan"))), 2),
    "1e999": (first("certificate.json", '{"nu": 1e999,'), 2),
    "a number of 10000 digits": (
        first("certificate.json", '{"nu": ' + "9" * 10_000 + ","), 2
    ),
    "infinite weights": (design(lambda data: data["weights"].__setitem__(0, "inf")), 2),
    "no numbers": (certificate(lambda data: data.update(z_bar="here")), 2),
    "other types": (design(lambda data: data.update(model=[1, 2])), 2),
    "a tower of powers": (expression("9**9**9**9"), 2),
    "a power of a power": (expression("((10**1000)**1000)**1000"), 2),
    "deep parentheses": (expression("(" * 9_000 + "q" + ")" * 9_000), 2),
    "deep functions": (expression("sin(" * 3_000 + "q" + ")" * 3_000), 2),
    "a long expression": (expression("+".join(["q"] * 1_000_000)), 2),
    "a call": (expression("__import__('os').system('true')"), 2),
    "wide networks": (design(huge_widths), 2),
    "many states": (design(many_states), 2),
    "a state that writes to the terminal": (design(name_state), 2),
    "a huge grid": (certificate(lambda data: data["region"]["box"].update(parts=10**9)), 2),
    "a flood of cells": (certificate(bomb), 2),
    "cells that are not base 64": (certificate(lambda data: data["region"].update(cells="é")), 2),
    "a region of no kind": (certificate(lambda data: data["region"].update(method="magic")), 2),
    "a curved region of a plant that has none": (certificate(curved), 4),
    "an edited model": (design(lambda data: data["model"].update(name="other")), 4),
    "a claim of one's own": (certificate(named("everything")), 4),
    "a claim that writes to the terminal": (certificate(named(ESCAPES * 1000)), 4),
    "words that are not held": (certificate(unheld("no global claim: but nearly")), 4),
    "words that write to the terminal": (certificate(unheld(f"no global claim: {ESCAPES}")), 4),
    "an entry that writes to the terminal": (certificate(lambda d: d.update({ESCAPES: 1})), 4),
    "a verdict that writes to the terminal": (design(stable_by_hearsay), 4),
}  # fmt: skip


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    folder = tmp_path_factory.mktemp("good")
    made = soft_pendulum()
    made.save(folder / "design.json")
    (folder / "certificate.json").write_text(certify(made).to_json(), encoding="utf-8")
    return folder


def all_of_them(folder, results) -> None:
    """Check each folder, in a process of bounded memory."""
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    found = {}
    for index, name in enumerate(FOLDERS):
        began = time.perf_counter()
        code, out, err = here(_certify, folder / str(index))
        found[name] = (code, out, err, time.perf_counter() - began)
    results.write_text(json.dumps(found), encoding="utf-8")


@pytest.fixture(scope="module")
def answers(good, tmp_path_factory):
    """Exit code, both outputs and seconds of each folder."""
    folder = tmp_path_factory.mktemp("hostile")
    for index, (make, _) in enumerate(FOLDERS.values()):
        (folder / str(index)).mkdir()
        for name in ("design.json", "certificate.json"):
            (folder / str(index) / name).write_bytes((good / name).read_bytes())
        make(folder / str(index))
    here_is, results = Path(__file__).parent, folder / "results.json"
    code = (
        f"import sys; sys.path[:0] = [{str(here_is)!r}, {str(here_is.parents[1])!r}]; "
        "from pathlib import Path; import test_hostile; "
        f"test_hostile.all_of_them(Path({str(folder)!r}), Path({str(results)!r}))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=SECONDS * len(FOLDERS)
    )
    assert done.returncode == 0, done.stderr
    return json.loads(results.read_text(encoding="utf-8"))


@pytest.mark.parametrize("name", FOLDERS)
def test_a_hostile_folder_is_refused_soon_and_shown_harmlessly(answers, name):
    code, out, err, seconds = answers[name]
    assert code == FOLDERS[name][1], err or out
    assert seconds < SECONDS
    assert "Traceback" not in err
    assert len(out + err) < 5000
    assert (out + err).replace("\n", "").isprintable()
    assert not [line for line in out.splitlines() if line.startswith("region holds")]
    if code == 2:
        assert len([line for line in err.splitlines() if not line.endswith(" ...")]) == 2


def test_the_folder_that_was_spoilt_is_good(good):
    code, out, err = here(_certify, good)
    assert code == 0, out + err


def test_stability_is_proved_without_the_verdict(tmp_path):
    """What the verdict in design.json says is shown nowhere and changes nothing."""
    made = soft_pendulum()
    made.save(tmp_path / "design.json")
    design(stable_by_hearsay)(tmp_path)
    stored = json.loads(certify(made, region=False).to_json())
    stored["design_hash"] = hash_of(tmp_path / "design.json")
    stored["stability"] = "stable"
    stored["claims"] = [
        claim if claim["name"] != "attraction"
        else {"name": "stability", "holds": True, "statement": ONLY_STABLE, "data": {}}
        for claim in stored["claims"]
    ]  # fmt: skip
    (tmp_path / "certificate.json").write_text(json.dumps(stored), encoding="utf-8")
    code, out, err = here(_certify, tmp_path)
    assert code == 0, out + err
    assert ONLY_STABLE in out
    assert "region holds" not in out
