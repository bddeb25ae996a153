"""Families proved, checked, and attacked: true minima of random members, and altered claims."""

import dataclasses
import json
from itertools import product

import numpy as np
import pytest
import sympy as sp
from helpers.certificates import checked_family
from helpers.models import WEIGHTED
from helpers.problems import problem, solve

from necc_casadi.certificate.claims.family import FamilyClaim, proved_share
from necc_casadi.certificate.claims.family import statement as words
from necc_casadi.certificate.prover.certify import certify
from necc_casadi.certificate.prover.family import prove_family
from necc_casadi.designs.family import lift
from necc_casadi.designs.plant_file import plant_text
from necc_casadi.errors import OutputError
from necc_casadi.model.model_file import load_model
from necc_casadi.model.ranges import Ranges
from necc_casadi.synthesis.options import Options

S = sp.Rational

RANGES = Ranges(
    {"q": (S(-1, 2), S(1))},
    {"m": (S(9, 10), S(11, 10)), "g": (S(19, 20), S(21, 20))},
    ((S(-1, 20), S(1, 20)),),
)


@pytest.fixture(scope="module")
def task(tmp_path_factory):
    path = tmp_path_factory.mktemp("family") / "plant.py"
    path.write_text(WEIGHTED, encoding="utf-8")
    return problem(load_model(path), "pi/4")


@pytest.fixture(scope="module")
def family(task):
    made = solve(task, Options(convex=True))
    return lift(made, RANGES, task.model.parametric)


@pytest.fixture(scope="module")
def claim(family):
    return prove_family(family)


@pytest.fixture(scope="module")
def written(family, claim):
    """What stands in the three files."""
    certificate = certify(family.design, region=False)
    whole = dataclasses.replace(certificate, claims=(*certificate.claims, claim))
    return family.design.text, family.text, json.loads(whole.to_json())


@pytest.fixture
def folder(family, task, tmp_path):
    """A folder with plant.json, which says what the unknown parameters do."""
    text = plant_text(family.design, task.model.parametric)
    (tmp_path / "plant.json").write_text(text, encoding="utf-8")
    return tmp_path


def test_it_is_proved_and_checked(claim, written, folder):
    assert claim.holds, claim.statement
    results = checked_family(folder, *written)
    assert all(result.holds for result in results.values()), results
    assert results["family"].statement == claim.statement


def test_true_minima_of_members_are_where_the_boxes_say(family, claim):
    rng = np.random.default_rng(0)
    boxes = [(np.array(b["theta"]), np.array(b["minimum"])) for b in claim.data["boxes"]]
    lo, hi = claim.data["error"]["q"]
    largest = 0.0
    corners = product(*(map(float, p.range) for p in family.parameters))
    inside = [[rng.uniform(*map(float, p.range)) for p in family.parameters] for _ in range(40)]
    for theta in map(np.array, [*corners, *inside]):
        named = dict(zip((p.name for p in family.parameters), theta, strict=True))
        member = family.member(named)
        z = member.z_bar
        off = z[0] - member.z_star[0]
        assert lo <= off <= hi
        largest = max(largest, abs(off))
        holding = [m for t, m in boxes if (t[:, 0] <= theta).all() and (theta <= t[:, 1]).all()]
        assert holding
        natural = z / member.units.state
        assert all(((m[:, 0] <= natural) & (natural <= m[:, 1])).all() for m in holding)
    assert max(-lo, hi) < 1.3 * largest


def test_set_points_alone_are_held_exactly(task, family):
    claim = prove_family(lift(family.design, Ranges({"q": (S(-5, 2), S(5, 2))})))
    assert claim.holds
    assert max(map(abs, claim.data["error"]["q"])) < 1e-9


def test_where_no_minimum_is_nothing_is_claimed(task):
    """A design that is as stiff as its target needs is not stiff enough near upright."""
    soft = solve(task)
    family = lift(soft, Ranges({"q": (S(0), sp.pi)}))
    claim = prove_family(family)
    assert 0.3 < proved_share(claim.data) < 1
    left = np.array(claim.data["left"])[:, 0]
    assert "except for q in" in claim.statement
    assert left[:, 1].max() >= np.pi
    for r in (0.1, 0.5, 1.0):  # there is a minimum where one is claimed, and none near upright
        boxes = np.array([box["theta"][0] for box in claim.data["boxes"]])
        if ((boxes[:, 0] <= r) & (r <= boxes[:, 1])).any():
            member = family.member({"q": r})
            assert np.linalg.eigvalsh(member.lyapunov.hessian(member.z_star))[0] > 0
    upright = family.member({"q": 3.1})
    assert np.linalg.eigvalsh(upright.lyapunov.hessian(upright.z_star))[0] < 0


def test_a_part_of_a_range_is_certified_again(task, tmp_path):
    soft = solve(task)
    family = lift(soft, Ranges({"q": (S(0), sp.pi)}))
    claim = prove_family(family)
    certificate = certify(soft, region=False).having(claim)
    assert not certificate.certified
    data = json.loads(certificate.to_json())
    assert checked_family(tmp_path, soft.text, family.text, data)["family"].holds
    family_claim(data)["data"]["left"].pop()
    assert not checked_family(tmp_path, soft.text, family.text, data)["family"].holds


def shrink(certificate):
    """A smaller error than the boxes have, in the words of that error."""
    data = family_claim(certificate)["data"]
    data["error"]["q"] = [data["error"]["q"][0] / 2, data["error"]["q"][1] / 2]


def drop(certificate):
    """One box less."""
    family_claim(certificate)["data"]["boxes"].pop()


def move(certificate):
    """The minimum elsewhere in one box."""
    box = family_claim(certificate)["data"]["boxes"][0]
    lo, hi = box["minimum"][0]
    box["minimum"][0] = [v + (hi - lo) / 2 for v in (lo, hi)]


def family_claim(certificate):
    return next(c for c in certificate["claims"] if c["name"] == "family")


@pytest.mark.parametrize("alter", [shrink, drop, move])
def test_an_altered_claim_does_not_hold(alter, written, folder):
    design, family, certificate = written
    certificate = json.loads(json.dumps(certificate))
    alter(certificate)
    assert not checked_family(folder, design, family, certificate)["family"].holds


def renamed(parameters, k, **entries):
    """One of the parameters with other entries."""
    return [p | entries if i == k else p for i, p in enumerate(parameters)]


@pytest.mark.parametrize(
    ("entry", "change", "fault"),
    [
        ("H", lambda H: f"{H} + q**4", "the plant of the design"),
        ("H", lambda H: f"{H} + (r_q - pi/4)*q**2", "seen from the set-point"),
        ("feedforward", lambda u: [f"{u[0]} + r_q - pi/4"], "seen from the set-point"),
        ("x_star", lambda x: ["r_q", "1"], "the target at r₀"),
        ("x_star", lambda x: ["2*r_q", "0"], "what its name says"),
        ("R", lambda R: [["0", "0"], ["0", "m - 1"]], "R ⪰ 0"),
        ("feedforward", lambda u: [f"{u[0]} - d_u"], "set-points alone"),
        ("feedforward", lambda u: [f"m*g*({u[0]})"], "set-points alone"),
        ("feedforward", lambda u: [f"{u[0]} - (q - pi/4)*(r_q - pi/4)"], "set-points alone"),
        ("x_star", lambda x: ["pi/4 + (r_q - pi/4)/1000", "0"], "what its name says"),
        ("parameters", lambda ps: renamed(ps, 1, name="g"), "what its name says"),
        ("parameters", lambda ps: renamed(ps, 2, name="q"), "what its name says"),
        ("parameters", lambda ps: renamed(ps, 3, nominal="5"), "what its name says"),
        ("parameters", lambda ps: renamed(ps, 3, name="d_u2"), "what its name says"),
        ("H", lambda H: H.replace("g*m", "g").replace("(2*m)", "2"), "what plant.json says"),
    ],
)
def test_a_loop_that_is_not_of_the_plant_is_found_out(entry, change, fault, written, folder):
    import hashlib

    design, family, certificate = written
    data = json.loads(family)
    data[entry] = change(data[entry])
    text = json.dumps(data)
    certificate = json.loads(json.dumps(certificate))
    family_claim(certificate)["data"]["family"] = hashlib.sha256(text.encode()).hexdigest()
    result = checked_family(folder, design, text, certificate)["family"]
    assert not result.holds
    assert fault in result.statement


def test_the_file_must_be_the_one_that_was_claimed_about(written, folder):
    design, family, certificate = written
    result = checked_family(folder, design, family + " ", certificate)["family"]
    assert not result.holds
    assert "family.json" in result.statement


def test_of_unknown_parameters_nothing_holds_without_the_plant(written, tmp_path):
    result = checked_family(tmp_path, *written)["family"]
    assert not result.holds
    assert "plant.json" in result.statement


def test_a_name_that_writes_lines_is_refused(written, folder):
    design, family, certificate = written
    data = json.loads(family)
    data["parameters"] = renamed(data["parameters"], 1, name="m\nglobal holds")
    with pytest.raises(OutputError, match="cannot be shown"):
        checked_family(folder, design, json.dumps(data), certificate)


def test_no_more_of_a_range_is_told_than_is_proved():
    claim = FamilyClaim("", (), (), {"q": (0.0, 0.0)})
    told = words({"q": (-0.49999951, 2 / 3), "m": (0.9, 1.1)}, claim, {"q": 1.0}, False)
    assert told.startswith("for every q in [-0.499999, 0.666666], m in [0.9, 1.1]:")
