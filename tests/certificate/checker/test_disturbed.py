"""The checker on where the sampled loop stays: held as it is, and forged."""

import json
import re
from dataclasses import replace

import pytest

from necc_casadi.certificate.checker.check import check
from necc_casadi.certificate.checker.code import check_code
from necc_casadi.certificate.claims import statements
from necc_casadi.certificate.claims.certificate import Certificate
from necc_casadi.certificate.claims.disturbed import DisturbedRegion
from necc_casadi.certificate.claims.sampled import KEPT, packed_tree
from necc_casadi.errors import OutputError
from necc_casadi.export.sampled_loop import SampledLoop
from necc_casadi.report.design_rows import sampled_text

NAMES = (("q", "p", "xi1"), ("u",))


@pytest.fixture(scope="module")
def found(sampled_folder):
    text = (sampled_folder / "certificate.json").read_text("utf-8")
    return Certificate.from_json(text).disturbed


def forged(folder, tmp_path, **changes):
    """The verdict on the claim with entries changed, and worded as they say."""
    certificate = Certificate.from_json((folder / "certificate.json").read_text("utf-8"))
    data = json.loads(certificate.to_json())
    (claim,) = [c for c in data["claims"] if c["name"] == "disturbed"]
    claim["data"] |= changes
    region = DisturbedRegion.read(json.loads(json.dumps(claim["data"])))
    claim["statement"] = statements.disturbed(region, *NAMES, certificate.units, (1.0,))
    (tmp_path / "certificate.json").write_text(json.dumps(data), encoding="utf-8")
    (tmp_path / "design.json").write_bytes((folder / "design.json").read_bytes())
    return {result.name: result for result in check(tmp_path)}["disturbed"]


def test_the_claim_is_proved_again(sampled_folder):
    results = {result.name: result for result in check(sampled_folder)}
    claim = results["disturbed"]
    assert claim.holds
    for words in ("[0.0001, 0.01] s", "in float", "q within ±1e-05", "u within ±1e-06"):
        assert words in claim.statement


@pytest.mark.parametrize(
    "entry", ["radius", "above", "noise", "input_error", "shortest", "level", "height", "period"]
)
def test_a_little_more_than_is_proved_is_refused(sampled_folder, tmp_path, found, entry):
    """A radius a tenth smaller, twice the errors, and so on."""
    factors = {"radius": 0.9, "above": 0.8, "noise": 2.0, "input_error": 2.0, "shortest": 1e-7,
               "level": 1.1, "height": 1.01, "period": 1.5}  # fmt: skip
    value = getattr(found, entry)
    factor = factors[entry]
    changed = [factor * v for v in value] if isinstance(value, tuple) else factor * value
    assert not forged(sampled_folder, tmp_path, **{entry: changed}).holds


@pytest.mark.parametrize("entry", ["rate", "core_rate"])
def test_a_faster_fall_is_refused(sampled_folder, tmp_path, found, entry):
    assert not forged(sampled_folder, tmp_path, **{entry: 4 * getattr(found, entry)}).holds


def test_the_radius_of_double_is_not_that_of_float(sampled_folder, tmp_path, found):
    """What is claimed of float holds in double, and a smaller radius does not hold in float."""
    assert forged(sampled_folder, tmp_path, precision="double").holds
    small = [1e-3 * r for r in found.radius]
    assert not forged(sampled_folder, tmp_path, radius=small).holds


@pytest.mark.parametrize("name", ["law", "casimirs"])
def test_operations_of_another_law_are_refused(sampled_folder, tmp_path, found, name):
    """One that rounds less: its last step gives a constant."""
    data = json.loads(json.dumps(found.data[name]))
    data["steps"][-1] = ["const", [], 0.7]
    verdict = forged(sampled_folder, tmp_path, **{name: data})
    assert verdict.statement.endswith("not proved: the operations are those of the law")


def test_an_operation_that_takes_what_comes_later_is_refused(sampled_folder, tmp_path, found):
    data = json.loads(json.dumps(found.data["law"]))
    data["steps"][0] = ["mul", [0, 999], 0.0]
    assert not forged(sampled_folder, tmp_path, law=data).holds


def test_a_core_in_which_more_is_left_is_refused(sampled_folder, tmp_path, found):
    """A core smaller than where W may rise."""
    middle = [(lo + hi) / 2 for lo, hi in found.core]
    sides = zip(found.core, middle, strict=True)
    core = [[m + (lo - m) * 1e-4, m + (hi - m) * 1e-4] for (lo, hi), m in sides]
    assert not forged(sampled_folder, tmp_path, core=core).holds


def test_boxes_that_are_no_tree_are_refused(sampled_folder, tmp_path, found):
    with pytest.raises(OutputError):
        forged(sampled_folder, tmp_path, tree=packed_tree(found.nodes[:-1]))
    one = packed_tree(bytes([KEPT]))  # all in one box: the checker halves it itself, too rarely
    assert not forged(sampled_folder, tmp_path, tree=one, rate=100.0).holds


def test_it_does_not_hold_without_the_claim_that_it_rests_on(sampled_folder, tmp_path):
    data = json.loads((sampled_folder / "certificate.json").read_text("utf-8"))
    data["claims"] = [c for c in data["claims"] if c["name"] != "sampled"]
    (tmp_path / "certificate.json").write_text(json.dumps(data), encoding="utf-8")
    (tmp_path / "design.json").write_bytes((sampled_folder / "design.json").read_bytes())
    verdicts = {result.name: result.holds for result in check(tmp_path)}
    assert not verdicts.get("disturbed", False)
    assert not all(verdicts.values())


@pytest.mark.parametrize("share", [1.04, 1.0, 0.96])
def test_the_summary_says_no_more_than_is_proved(sampled_folder, found, share):
    """Radii are not rounded down, nor the longest period up."""
    certificate = Certificate.from_json((sampled_folder / "certificate.json").read_text("utf-8"))
    radius, period = (0.0841 * share, 0.0129 * share, 1.0), 0.012347 * share
    claims = [
        replace(c, data={**c.data, "radius": list(radius), "period": period})
        if c.name == "disturbed"
        else replace(c, data={**c.data, "period": period})
        if c.name == "sampled"
        else c
        for c in certificate.claims
    ]
    text = sampled_text(SampledLoop(0.01, 0.9, None, None), replace(certificate, claims=claims))
    (shown,) = re.findall(r"within \((.*?)\) of", text)
    assert all(float(v) >= r for v, r in zip(shown.split(","), radius, strict=True))
    longest = [float(v) for v in re.findall(r"(?:up to|to) (0\.0\d+) s", text)]
    assert len(longest) == 2
    assert max(longest) <= period


@pytest.mark.parametrize("real", ["float", "double"])
def test_code_of_another_type_than_is_claimed_is_found(tmp_path, real):
    """Hashes alone would not tell: they are made again along with the claim."""
    (tmp_path / "c").mkdir()
    for name in ("necc.h", "necc.c"):
        (tmp_path / "c" / name).write_text(f"typedef {real} own_real;\n", encoding="utf-8")
    other = "double" if real == "float" else "float"
    said = {
        name: "does not compute in" in check_code(tmp_path, "{}", name)[0].statement
        for name in (real, other)
    }
    assert said == {real: False, other: True}
