"""The checker on where the sampled loop stays: held as it is, and forged."""

import json

import pytest

from necc_casadi.certificate.checker.check import check
from necc_casadi.certificate.claims import statements
from necc_casadi.certificate.claims.certificate import Certificate
from necc_casadi.certificate.claims.disturbed import DisturbedRegion
from necc_casadi.certificate.claims.sampled import BEYOND, packed_tree
from necc_casadi.errors import OutputError

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


def test_a_faster_fall_is_refused(sampled_folder, tmp_path, found):
    assert not forged(sampled_folder, tmp_path, rate=10 * found.rate).holds
    cores = json.loads(json.dumps(found.data["cores"]))
    cores[-1]["rate"] *= 1.2
    assert not forged(sampled_folder, tmp_path, cores=cores).holds


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
    """A core smaller than where W may rise, and one that what comes from before does not fit in."""
    cores = found.data["cores"]
    box = cores[-1]["box"]
    small = [[m + (side - m) * 1e-5 for side in sides] for sides in box for m in [sum(sides) / 2]]
    last = {"box": small, "rate": cores[-1]["rate"]}
    assert not forged(sampled_folder, tmp_path, cores=[last]).holds
    assert not forged(sampled_folder, tmp_path, cores=[*cores, last]).holds


def test_boxes_that_are_no_tree_are_refused(sampled_folder, tmp_path, found):
    with pytest.raises(OutputError):
        forged(sampled_folder, tmp_path, tree=packed_tree(found.nodes[:-1]))
    one = packed_tree(bytes([BEYOND]))  # all of it, and z̄ with it
    assert not forged(sampled_folder, tmp_path, tree=one).holds


def test_it_does_not_hold_without_the_claim_that_it_rests_on(sampled_folder, tmp_path):
    data = json.loads((sampled_folder / "certificate.json").read_text("utf-8"))
    data["claims"] = [c for c in data["claims"] if c["name"] != "sampled"]
    (tmp_path / "certificate.json").write_text(json.dumps(data), encoding="utf-8")
    (tmp_path / "design.json").write_bytes((sampled_folder / "design.json").read_bytes())
    verdicts = {result.name: result.holds for result in check(tmp_path)}
    assert not verdicts.get("disturbed", False)
    assert not all(verdicts.values())
