"""The checker on the claim about the sampled loop: held as it is, and forged."""

import json
from dataclasses import replace

import numpy as np
import pytest
import sympy as sp
from flint import arb, arb_mat
from helpers.sampled import limited_around, sampled_step, with_limits

from necc_casadi.certificate.checker.arithmetic.balls import ball
from necc_casadi.certificate.checker.check import check
from necc_casadi.certificate.checker.evidence import Evidence
from necc_casadi.certificate.checker.model import StoredDesign
from necc_casadi.certificate.checker.reading import read_folder
from necc_casadi.certificate.checker.sampled.sampled import SampledProof
from necc_casadi.certificate.checker.sampled.step import StepProof
from necc_casadi.certificate.claims import statements
from necc_casadi.certificate.claims.certificate import Certificate
from necc_casadi.certificate.claims.sampled import BEYOND, KEPT, SampledRegion, packed_tree
from necc_casadi.certificate.prover.certify import certify, with_sampled_loop
from necc_casadi.certificate.prover.sampled import prove
from necc_casadi.errors import OutputError

T = 0.01


@pytest.fixture(scope="module")
def folder(sampled_folder):
    return sampled_folder


@pytest.fixture(scope="module")
def clipped(default_design, tmp_path_factory):
    """Where u is clipped, by limits that leave no more than the damping of a small region."""
    limited = with_limits(default_design, [(-0.9, 0.9)])
    return proved(limited, tmp_path_factory.mktemp("clipped"))


@pytest.fixture(scope="module")
def scaled(default_design, tmp_path_factory):
    """The same of a damping that is coupled with ξ, which the limits scale."""
    limited = with_limits(coupled(default_design), [(-0.9, 0.9)])
    return proved(limited, tmp_path_factory.mktemp("scaled"))


def coupled(design):
    """With as much between u and ξ as is in them, half of it skew."""
    between = 0.4 * np.sqrt(design.damping[0, 0] * design.damping[1, 1])
    return replace(design, damping=design.damping + np.array([[0, between], [0, 0]]))


def proved(limited, made):
    """What is proved of the sampled loop up to a small height."""
    limited.save(made / "design.json")
    part = replace(certify(limited, region=False), level_above_minimum=0.02)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(prove, "_TRIALS", 0)
        found = with_sampled_loop(limited, part, T, "heun")
    found = replace(found, level_above_minimum=None)
    (made / "certificate.json").write_text(found.to_json(), encoding="utf-8")
    return made


@pytest.mark.slow
def test_clipped_inputs_are_proved_again(clipped):
    assert region_of(clipped).clipped
    assert of(clipped).holds
    assert "u is clipped to [-0.9, 0.9]" in of(clipped).statement


@pytest.mark.slow
def test_damping_that_is_scaled_is_proved_again(scaled):
    assert region_of(scaled).clipped
    assert of(scaled).holds
    kept = "u is kept within [-0.9, 0.9], as the code does, by scaling its damping injection"
    assert kept in of(scaled).statement


@pytest.mark.slow
def test_scaled_damping_is_not_within_limits_by_itself(scaled, tmp_path):
    verdict = forged(scaled, tmp_path, clipped=False)
    assert verdict.statement.endswith("not proved: u is clipped where it is said to be alone")


@pytest.mark.slow
def test_inputs_that_are_clipped_are_not_within_their_limits(clipped, tmp_path):
    verdict = forged(clipped, tmp_path, clipped=False)
    assert verdict.statement.endswith("not proved: u is clipped where it is said to be alone")


def test_inputs_without_limits_are_not_clipped(folder, tmp_path):
    assert not forged(folder, tmp_path, clipped=True).holds


@pytest.mark.slow
@pytest.mark.parametrize("limits", [(-0.75, 0.75), (-0.1, 0.1)])
def test_tighter_limits_are_not_proved(clipped, tmp_path, limits):
    """The same claim of a design with other limits; u holds with 0.7 at z̄."""
    copy = tmp_path / "tight"
    copy.mkdir()
    data = json.loads((clipped / "design.json").read_text("utf-8"))
    data["model"]["u_limits"] = [limits]
    (copy / "design.json").write_text(json.dumps(data), encoding="utf-8")
    (copy / "certificate.json").write_bytes((clipped / "certificate.json").read_bytes())
    region, (_, stored, design) = region_of(clipped), read_folder(copy)
    proofs = dict(SampledProof(Evidence(StoredDesign(design), stored), region).obligations())
    assert not proofs["W falls at every step, on every box"]()


def of(folder, name="sampled"):
    return {result.name: result for result in check(folder)}[name]


def forged(folder, tmp_path, **changes):
    """The verdict on the claim with entries changed, and worded as they say."""
    certificate = Certificate.from_json((folder / "certificate.json").read_text("utf-8"))
    data = json.loads(certificate.to_json())
    data["claims"] = [c for c in data["claims"] if c["name"] != "disturbed"]
    (claim,) = [c for c in data["claims"] if c["name"] == "sampled"]
    claim["data"] |= changes
    region = SampledRegion.read(claim["data"])
    states = ("q", "p", "xi1")
    stored = json.loads((folder / "design.json").read_text("utf-8"))
    limits = stored["model"]["u_limits"] or ()
    claim["statement"] = statements.sampled(region, states, certificate.units, limits, False)
    (tmp_path / "certificate.json").write_text(json.dumps(data), encoding="utf-8")
    (tmp_path / "design.json").write_bytes((folder / "design.json").read_bytes())
    return of(tmp_path)


def region_of(folder):
    return Certificate.from_json((folder / "certificate.json").read_text("utf-8")).sampled


def test_the_claim_is_proved_again(folder):
    results = check(folder)
    assert all(result.holds for result in results if result.name != "code")
    assert of(folder).statement.startswith("for every sequence of sampling periods in (0, 0.01] s")


def test_longer_periods_are_not_proved(folder, tmp_path):
    assert not forged(folder, tmp_path, period=100 * T).holds


def test_a_higher_level_is_not_proved(folder, tmp_path):
    region = region_of(folder)
    raised = region.height * 4
    verdict = forged(folder, tmp_path, level=region.level + 3 * region.height, height=raised)
    assert not verdict.holds


def test_a_height_beyond_the_level_is_not_proved(folder, tmp_path):
    verdict = forged(folder, tmp_path, height=region_of(folder).height * 1.001)
    assert verdict.statement.endswith("not proved: the height above V(z̄)")


@pytest.mark.parametrize("sign", [-1.0, 5.0])
def test_another_metric_is_not_proved(folder, tmp_path, sign):
    metric = [[sign * q for q in row] for row in region_of(folder).metric]
    assert not forged(folder, tmp_path, metric=metric).holds


def test_the_core_must_hold_the_minimum(folder, tmp_path):
    core = [[lo + 10 * (hi - lo), hi + 10 * (hi - lo)] for lo, hi in region_of(folder).core]
    verdict = forged(folder, tmp_path, core=core)
    assert verdict.statement.endswith("not proved: V has one minimum in the core")


def test_boxes_that_touch_a_side_must_be_beyond_the_level(folder, tmp_path):
    """A box that is inside of Ω."""
    box = [
        [(lo + c) / 2, (hi + c) / 2]
        for (lo, hi), (a, b) in zip(region_of(folder).box, region_of(folder).core, strict=True)
        for c in [(a + b) / 2]
    ]
    core = [[c - 0.01, c + 0.01] for c in ((a + b) / 2 for a, b in region_of(folder).core)]
    assert not forged(folder, tmp_path, box=box, core=core).holds


def test_boxes_said_to_be_beyond_the_level_are_looked_at(folder, tmp_path):
    region = region_of(folder)
    nodes = bytes(BEYOND if node == KEPT else node for node in region.nodes)
    assert not forged(folder, tmp_path, tree=packed_tree(nodes)).holds


def test_a_tree_that_does_not_end_is_unreadable(folder, tmp_path):
    """What the checker cannot read at all it refuses as a file."""
    nodes = region_of(folder).nodes
    for broken in (nodes[:-1], nodes + b"\x00", bytes([200]), b"\x02" * 50):
        with pytest.raises(OutputError):
            forged(folder, tmp_path, tree=packed_tree(broken))


@pytest.mark.parametrize("inside", [False, True])
def test_a_jump_of_V_that_no_derivative_shows_is_seen(folder, inside):
    """d/dq atan(tan q) = 1, and atan(tan q) jumps by π."""
    _, stored, design = read_folder(folder)
    model, region = StoredDesign(design), region_of(folder)
    lo, hi = region.box[0]
    width = sp.Rational(hi) - sp.Rational(lo)
    pole = sp.Rational(lo) + width * (sp.Rational(1, 2) if inside else 2)
    model.H += sp.atan(sp.tan((model.z[0] - pole) / width + sp.Rational(11, 7)))
    proofs = dict(SampledProof(Evidence(model, stored), region).obligations())
    assert proofs["everything is smooth on the box"]() is not inside


@pytest.mark.parametrize("method", ["euler", "heun"])
@pytest.mark.parametrize("width", [0.0, 0.2])
@pytest.mark.parametrize("clipped", ["never", "clipped", "scaled"])
def test_the_form_says_what_a_step_does_to_w(folder, default_design, method, width, clipped):
    """W(z⁺) − W(z) = s ∇VᵀΠ∇V, by simulation of plant and controller."""
    _, stored, data = read_folder(folder)
    design, rng = default_design.natural, np.random.default_rng(3)
    if clipped == "scaled":
        full = coupled(default_design)
        data = json.loads(full.text)
        design = full.natural
    around, lost = design.z_bar + rng.uniform(-0.5, 0.5, (8, 3)), 0
    if clipped != "never":
        design = limited_around(design, around, 0.15)
        pairs = np.array(design.loop.plant.u_limits) * default_design.units.input[0]
        data["model"]["u_limits"] = pairs.tolist()
    proof = SampledProof(
        Evidence(StoredDesign(data), stored), replace(region_of(folder), integrator=method)
    )
    for z in around:
        s = rng.uniform(0.02, 0.1)
        low = z - rng.uniform(0, 1, 3) * width
        period = (s, s) if width == 0.0 else (s - 0.01, s + 0.01)
        box = tuple(zip(low, low + width, strict=True))
        gradient, _ = proof.gradient_and_hessian(box)
        held = (proof.step.inputs(box, gradient), [])
        if clipped != "never":
            held = proof.step.held(box, gradient)
            if held is None:
                assert width > 0
                continue
            lost += not bool(held[1][0] == 1)
        form = proof.step.form(box, gradient, held[0], period, proof.Q, held[1])
        after = sampled_step(design, z[None], np.array([s]), method)[0]
        slopes = design.lyapunov.gradient(np.array([z, after]))
        values = design.lyapunov.V(np.array([z, after]))
        W = values + np.einsum("bi,ij,bj->b", slopes, proof.region.metric, slopes) / 2
        g = arb_mat([[v] for v in slopes[0]])
        said = (g.transpose() * form.center * g)[0, 0]
        for part in form.parts.values():
            said += ball(-1.0, 1.0) * (g.transpose() * part * g)[0, 0].abs_upper()
        said = said * s
        assert abs(said.mid() - (W[1] - W[0])) <= said.rad() + 1e-12
        assert width > 0.0 or said.rad() < 0.1 * abs(said.mid())  # and it is worth something
    assert (lost > 0) == (clipped != "never")


def test_a_limit_that_is_touched_without_damping_is_not_covered_where_it_scales():
    """The code then lets that limit clip, and leaves all of the other damping."""
    step = StepProof.__new__(StepProof)
    step.limits = [(-1.0, 1.0), (-1.0, 1.0)]
    v, inside = [arb(1) / 2, arb(1) / 4], arb(0)
    assert step._scaled([arb(1), inside], v) is None
    assert step._scaled([arb(-1), inside], [-v[0], v[1]]) is None
    held, (share,) = step._scaled([arb(3) / 4, inside], v)
    assert share == arb(1) / 2  # the least, and the other input goes along
    assert [held[0].overlaps(arb(1)), held[1].overlaps(arb(1) / 8)] == [True, True]


def drawn(design, region, count, seed=0):
    """States of {W < w₀} in the box, (count, N), natural units."""
    rng, found = np.random.default_rng(seed), []
    lo, hi = np.array(region.box).T
    while len(found) < count:
        z = rng.uniform(lo, hi, (2000, len(lo)))
        found += list(z[level_of(design, region, z) < region.level])
    return np.array(found[:count])


def level_of(design, region, z):
    slopes = design.lyapunov.gradient(z)
    square = np.einsum("bi,ij,bj->b", slopes, np.array(region.metric), slopes)
    return design.lyapunov.V(z) + square / 2


FORGED = {
    "period": (1.05, 20.0, 200.0),
    "level": (1.01, 3.0),
    "metric": (0.0, 1.1, 3.0),
    "box": (0.5, 1.03),
    "euler": (1.0,),
}


@pytest.mark.slow
def test_what_is_accepted_of_a_forger_is_true(folder, tmp_path, default_design):
    """Each entry moved a little and a lot: refused, or so that W falls in simulated samples."""
    region, design, verdicts = region_of(folder), default_design.natural, []
    for entry, factors in FORGED.items():
        for factor in factors:
            changes = {"period": region.period * factor} if entry == "period" else {}
            if entry == "level":
                raised = region.level + (factor - 1) * region.height
                changes = {"level": raised, "height": region.height * factor}
            if entry == "metric":
                changes = {"metric": [[factor * q for q in row] for row in region.metric]}
            if entry == "box":
                sides = zip(region.box, design.z_bar, strict=True)
                changes = {"box": [[c + factor * (v - c) for v in side] for side, c in sides]}
            if entry == "euler":
                changes = {"integrator": "euler"}
            holds = forged(folder, tmp_path, **changes).holds
            verdicts.append((entry, factor, holds))
            if holds:
                claimed = SampledRegion.read(region.data | changes)
                z, rng = drawn(design, claimed, 1000), np.random.default_rng(1)
                shares = np.where(np.arange(1000) % 4 == 0, 1.0, rng.uniform(size=1000) ** 4)
                s = claimed.period * np.maximum(shares, 1e-9)
                after = sampled_step(design, z, s, claimed.integrator)
                before = level_of(design, claimed, z)
                assert np.all(level_of(design, claimed, after) <= before + 1e-12), verdicts
    refused = {(entry, factor) for entry, factor, holds in verdicts if not holds}
    assert {("period", 200.0), ("box", 0.5)} <= refused, verdicts
    assert len(refused) < len(verdicts), verdicts


@pytest.mark.slow
def test_no_box_may_be_said_to_be_what_it_is_not(folder, tmp_path):
    """The first leaves, one by one: beyond for kept, and what holds nothing for the whole."""
    region = region_of(folder)
    nodes = region.nodes
    kept = [i for i, node in enumerate(nodes) if node == KEPT]
    for i in kept[:3]:
        forgery = bytes([*nodes[:i], BEYOND, *nodes[i + 1 :]])
        assert not forged(folder, tmp_path, tree=packed_tree(forgery)).holds
    assert not forged(folder, tmp_path, tree=packed_tree(bytes([BEYOND]))).holds
    for i in range(min(len(nodes), 4)):  # a box left out
        with pytest.raises(OutputError):
            forged(folder, tmp_path, tree=packed_tree(bytes([*nodes[:i], *nodes[i + 1 :]])))
