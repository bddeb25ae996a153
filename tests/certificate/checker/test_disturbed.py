"""The checker on where the sampled loop stays: held as it is, and forged."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from flint import arb

from necc_casadi.certificate.checker.check import check
from necc_casadi.certificate.checker.code import check_code
from necc_casadi.certificate.checker.evidence import Evidence
from necc_casadi.certificate.checker.model import StoredDesign
from necc_casadi.certificate.checker.reading import read_folder
from necc_casadi.certificate.checker.sampled.disturbed import _Disturbed, check_disturbed
from necc_casadi.certificate.claims.certificate import Certificate
from necc_casadi.certificate.claims.disturbed import DisturbedRegion
from necc_casadi.certificate.claims.fields import Fields
from necc_casadi.certificate.claims.sampled import BEYOND, SampledRegion, packed_tree
from necc_casadi.certificate.prover.arithmetic.intervals import Interval
from necc_casadi.certificate.prover.arithmetic.potential import Potential
from necc_casadi.designs.design import Design
from necc_casadi.export.sampled_loop import SampledLoop
from necc_casadi.report.design_rows import sampled_text
from necc_casadi.report.values import TIE

NAMES = (("q", "p", "xi1"), ("u",))


@pytest.fixture(scope="module")
def found(sampled_folder):
    text = (sampled_folder / "certificate.json").read_text("utf-8")
    return Certificate.from_json(text).disturbed


def forged(folder, **changes):
    """The verdict on the claim alone, with entries changed, and worded as they say."""
    _, _, design = read_folder(folder)
    data = json.loads((folder / "certificate.json").read_text("utf-8"))
    (claim,) = [c for c in data["claims"] if c["name"] == "disturbed"]
    claim["data"] = json.loads(json.dumps(claim["data"] | changes))
    return check_disturbed(Evidence(StoredDesign(design), Fields(data)), True)


@pytest.mark.slow
def test_the_claim_is_proved_again(sampled_folder):
    results = {result.name: result for result in check(sampled_folder)}
    claim = results["disturbed"]
    assert claim.holds
    for words in ("[0.0001, 0.01] s", "in float", "q within ±1e-05", "u within ±1e-06"):
        assert words in claim.statement


@pytest.mark.slow
def test_the_claim_is_proved_again_where_velocities_are_measured(velocity_folder):
    results = {result.name: result for result in check(velocity_folder)}
    assert all(result.holds for result in results.values())
    for words in (
        "q within ±1e-05, q_dot within ±0.0001",
        "of z̄, states of the model: p_q = M(q)q̇ of the plant, without noise",
    ):
        assert words in results["disturbed"].statement


@pytest.mark.slow
def test_noise_of_velocities_and_momenta_of_another_plant_are_refused(velocity_folder):
    """More noise of q̇ than is proved, momenta nearer than is proved, and M twice as large."""
    _, stored, design = read_folder(velocity_folder)
    found = DisturbedRegion.read(Evidence(StoredDesign(design), stored).claims["disturbed"].data)
    assert forged(velocity_folder).holds
    noise, radius = list(found.noise), list(found.radius)
    assert not forged(velocity_folder, noise=[noise[0], 1.5 * noise[1]]).holds
    assert not forged(velocity_folder, radius=[radius[0], 0.9 * radius[1], radius[2]]).holds
    design["model"]["inertia"] = [[f"2*({design['model']['inertia'][0][0]})"]]
    proof = proof_of(stored, design)
    assert not dict(proof.obligations())["q̇ of the plant at p = M(q)q̇"]()


@pytest.mark.slow
def test_the_hessian_of_a_wide_core_is_enclosed_closely(velocity_folder):
    """Where M moves, balls of a whole core were wider than what the prover had, and refused it."""
    _, stored, design = read_folder(velocity_folder)
    proof, made = proof_of(stored, design), Design.load(velocity_folder)
    half = np.array([0.15, 0.3, 0.1])
    box = tuple(zip(made.z_bar - half, made.z_bar + half, strict=True))
    close, whole = proof._hull(box).tolist(), proof.energy.hull(box)
    lo, hi = np.array(box).T[:, None]
    proved = Potential(made.natural).jet(Interval(lo, hi)).hess.rad[0]
    z = np.random.default_rng(0).uniform(*np.array(box).T, (200, 3))
    for i, j in np.ndindex(3, 3):
        exact = made.lyapunov.hessian(z)[:, i, j]
        lo, hi = (float(end(close[i][j])) for end in (arb.lower, arb.upper))
        assert (lo - 1e-9 <= exact.min()) & (exact.max() <= hi + 1e-9)
        assert float(close[i][j].rad()) <= 1.01 * proved[i, j] + 1e-9
    assert float(whole[0][0].rad()) > 1.1 * proved[0, 0]


def proof_of(stored, design):
    """What is to be proved of what is claimed."""
    evidence = Evidence(StoredDesign(design), stored)
    claims = {name: claim.data for name, claim in evidence.claims.items()}
    region = SampledRegion.read(claims["sampled"])
    return _Disturbed(evidence, region, DisturbedRegion.read(claims["disturbed"]))


def test_what_is_left_near_the_minimum_is_proved_again(sampled_folder):
    """All but the boxes, which take longest."""
    _, stored, design = read_folder(sampled_folder)
    *others, _, boxes = proof_of(stored, design).obligations()
    assert all(proved() for _, proved in others)
    assert "on every box" in boxes[0]


@pytest.mark.parametrize(
    "entry", ["radius", "above", "noise", "input_error", "shortest", "level", "height", "period"]
)
def test_a_little_more_than_is_proved_is_refused(sampled_folder, found, entry):
    """A radius a tenth smaller, twice the errors, and so on."""
    factors = {"radius": 0.9, "above": 0.8, "noise": 2.0, "input_error": 2.0, "shortest": 1e-7,
               "level": 1.1, "height": 1.01, "period": 1.5}  # fmt: skip
    value = getattr(found, entry)
    factor = factors[entry]
    changed = [factor * v for v in value] if isinstance(value, tuple) else factor * value
    assert not forged(sampled_folder, **{entry: changed}).holds


@pytest.mark.slow
def test_a_faster_fall_is_refused(sampled_folder, found):
    assert not forged(sampled_folder, rate=10 * found.rate).holds
    assert not forged(sampled_folder, slope=100 * found.slope).holds
    assert not forged(sampled_folder, slope=1e-3 * found.slope).holds
    cores = json.loads(json.dumps(found.data["cores"]))
    cores[-1]["rate"] *= 1.2
    assert not forged(sampled_folder, cores=cores).holds


@pytest.mark.slow
def test_other_words_than_what_is_proved_are_refused(sampled_folder, tmp_path):
    """Twice the noise in the text alone."""
    text = (sampled_folder / "certificate.json").read_text("utf-8")
    assert "q within ±1e-05" in text
    changed = text.replace("q within ±1e-05", "q within ±2e-05")
    (tmp_path / "certificate.json").write_text(changed, encoding="utf-8")
    (tmp_path / "design.json").write_bytes((sampled_folder / "design.json").read_bytes())
    verdict = {result.name: result for result in check(tmp_path)}["disturbed"]
    assert not verdict.holds
    assert verdict.statement.startswith("claimed in other words")


@pytest.mark.slow
def test_the_radius_of_double_is_not_that_of_float(sampled_folder, found):
    """What is claimed of float holds in double, and a smaller radius does not hold in float."""
    assert forged(sampled_folder, precision="double").holds
    small = [1e-3 * r for r in found.radius]
    assert not forged(sampled_folder, radius=small).holds


@pytest.mark.parametrize("name", ["law", "casimirs"])
def test_operations_of_another_law_are_refused(sampled_folder, found, name):
    """One that rounds less: its last step gives a constant."""
    data = json.loads(json.dumps(found.data[name]))
    data["steps"][-1] = ["const", [], 0.7]
    verdict = forged(sampled_folder, **{name: data})
    assert verdict.statement.endswith("not proved: the operations are those of the law")


def test_an_operation_that_takes_what_comes_later_is_refused(sampled_folder, found):
    data = json.loads(json.dumps(found.data["law"]))
    data["steps"][0] = ["mul", [0, 999], 0.0]
    assert not forged(sampled_folder, law=data).holds


def test_a_core_in_which_more_is_left_is_refused(sampled_folder, found):
    """A core smaller than where W may rise, and one that what comes from before does not fit in."""
    cores = found.data["cores"]
    box = cores[-1]["box"]
    small = [[m + (side - m) * 1e-5 for side in sides] for sides in box for m in [sum(sides) / 2]]
    last = {"box": small, "rate": cores[-1]["rate"]}
    assert not forged(sampled_folder, cores=[last]).holds
    assert not forged(sampled_folder, cores=[*cores, last]).holds


def test_boxes_that_are_no_tree_are_refused(sampled_folder, found):
    with pytest.raises(ValueError, match="boxes of the sampled region"):
        forged(sampled_folder, tree=packed_tree(found.nodes[:-1]))
    one = packed_tree(bytes([BEYOND]))  # all of it, and z̄ with it
    assert not forged(sampled_folder, tree=one).holds


@pytest.mark.slow
def test_it_does_not_hold_without_the_claim_that_it_rests_on(sampled_folder, tmp_path):
    data = json.loads((sampled_folder / "certificate.json").read_text("utf-8"))
    data["claims"] = [c for c in data["claims"] if c["name"] != "sampled"]
    (tmp_path / "certificate.json").write_text(json.dumps(data), encoding="utf-8")
    (tmp_path / "design.json").write_bytes((sampled_folder / "design.json").read_bytes())
    verdicts = {result.name: result.holds for result in check(tmp_path)}
    assert not verdicts.get("disturbed", False)
    assert not all(verdicts.values())


@pytest.mark.parametrize("share", [1.04, 1.0, 0.96])
def test_the_summary_says_no_more_than_is_proved(sampled_folder, default_design, share):
    """Radii, each with its state and unit, are not rounded down, nor the longest period up."""
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
    certificate = replace(certificate, claims=claims)
    text = sampled_text(default_design, SampledLoop(0.01, 0.9, None, None), certificate)
    (shown,) = re.findall(r"within (.*?) of z̄", text.replace(TIE, " "))
    states = [re.fullmatch(r"(\w+) ± ([\d.]+) ?(.*)", part).groups() for part in shown.split(", ")]
    assert [name for name, _, _ in states] == ["q", "p", "xi1"]
    assert [unit for _, _, unit in states] == ["rad", "kg m²/s", ""]
    assert all(float(v) >= r for (_, v, _), r in zip(states, radius, strict=True))
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
