"""necc-certify: a line or an object per claim, and its exit codes."""

import json
import shutil

from helpers.commands import check_refusal, here, without_progress

from necc_casadi.cli.certify import _certify


def test_every_claim_is_checked_again(made):
    out = made[0] / "pendulum-design"
    stored = json.loads((out / "certificate.json").read_text(encoding="utf-8"))["claims"]
    code, text, err = here(_certify, out)
    assert (code, without_progress(err)) == (0, [])
    rows = [tuple(line.split()[:2]) for line in text.splitlines()]
    assert {(claim["name"], "holds") for claim in stored if claim["holds"]} <= set(rows)
    assert {mark for _, mark in rows} == {"holds"}
    code, text, err = here(_certify, out, "--json")
    assert (code, without_progress(err)) == (0, [])
    data = json.loads(text)
    assert set(data) == {"status", "claims", "seconds"}
    assert data["status"] == "certified"
    assert all(set(claim) >= {"name", "holds", "statement"} for claim in data["claims"])
    assert [claim["name"] for claim in data["claims"]] == [name for name, _ in rows]


def test_a_claim_that_does_not_hold_is_exit_4(made, tmp_path):
    """The ball around z* is claimed to be larger than any proof could have missed."""
    shutil.copy(made[0] / "pendulum-design" / "design.json", tmp_path)
    text = (made[0] / "pendulum-design" / "certificate.json").read_text(encoding="utf-8")
    data = json.loads(text)
    data["mu"] *= 10
    (tmp_path / "certificate.json").write_text(json.dumps(data), encoding="utf-8")
    code, text, _ = here(_certify, tmp_path)
    assert code == 4
    assert "DOES NOT HOLD" in text
    code, text, _ = here(_certify, tmp_path, "--json")
    assert (code, json.loads(text)["status"]) == (4, "fell_short")


def test_a_folder_without_a_certificate_is_refused(made, tmp_path):
    check_refusal(here(_certify, tmp_path, "--json"), "output")
    shutil.copy(made[0] / "pendulum-design" / "design.json", tmp_path)
    check_refusal(here(_certify, tmp_path, "--json"), "output")
