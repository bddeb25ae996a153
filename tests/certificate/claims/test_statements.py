"""A certificate says what was proved and nothing else: every word of it is checked."""

import copy
import dataclasses
import json

import pytest
import sympy as sp
from helpers.certificates import worded
from helpers.constructed import make_design, quadratic_pendulum
from helpers.oscillators import QUADRATIC, double_well, limited, sides
from hypothesis import given
from hypothesis import strategies as st

from necc_casadi.casimirs.casimirs import Casimirs
from necc_casadi.certificate.checker.check import check
from necc_casadi.certificate.claims import statements
from necc_casadi.certificate.prover.certify import certify
from necc_casadi.cli.certify import _certify
from necc_casadi.cli.terminal import run
from necc_casadi.model.closed_loop import interconnect
from necc_casadi.model.controller import default_controller
from necc_casadi.model.plant import make_plant

#: Together longer than the quick suite can afford; CI runs them.
pytestmark = pytest.mark.slow


def limited_pendulum():
    """The whole space, and a region inside bounds that keeps input limits."""
    made = limited(quadratic_pendulum(), (-9.0, 9.0))
    plant = dataclasses.replace(made.loop.plant, domain=sides(p=2))
    return dataclasses.replace(made, loop=interconnect(plant, made.loop.controller))


def frozen_beside():
    """An oscillator beside a coordinate that no input reaches: z̄ is only stable."""
    q, p, a = sp.symbols("q p a", real=True)
    J = sp.zeros(3)
    J[0, 1], J[1, 0] = 1, -1
    H = (p**2 + q**2 + a**2) / 2
    G = sp.Matrix([0, 1, 0])
    plant = make_plant((q, p, a), J, sp.zeros(3), G, H, domain=sides(p=2))
    loop = interconnect(plant, default_controller(plant))
    weights = [0, 0, 1.0, 0, 0, 0, 1.0, 0]
    return make_design(
        plant, (0, 0, 0), QUADRATIC, weights, [0.0], casimirs=Casimirs((a,), 2, 2), loop=loop
    )


DESIGNS = {"limited": limited_pendulum, "well": double_well, "frozen": frozen_beside}


@pytest.fixture(scope="module", params=DESIGNS)
def folder(request, tmp_path_factory):
    folder = tmp_path_factory.mktemp(request.param)
    design = DESIGNS[request.param]()
    design.save(folder / "design.json")
    certificate = certify(design)
    assert certificate.certified
    (folder / "certificate.json").write_text(certificate.to_json(), encoding="utf-8")
    return folder


def content(folder):
    return json.loads((folder / "certificate.json").read_text(encoding="utf-8"))


def held(data):
    return [claim["name"] for claim in data["claims"] if claim["holds"]]


def claim(data, name):
    return next(claim for claim in data["claims"] if claim["name"] == name)


@pytest.fixture
def rejected(folder, tmp_path, capsys):
    """altered certificate -> rows that do not hold; `necc-certify` must answer with 4."""

    def rows(data) -> set[str]:
        (tmp_path / "certificate.json").write_text(json.dumps(data), encoding="utf-8")
        (tmp_path / "design.json").write_bytes((folder / "design.json").read_bytes())
        assert run(_certify, [str(tmp_path), "--json"]) == 4
        claims = json.loads(capsys.readouterr().out)["claims"]
        return {claim["name"] for claim in claims if not claim["holds"]}

    return rows


def test_the_checker_words_each_held_claim_as_the_maker_did(folder, capsys):
    data = content(folder)
    results = {result.name: result for result in check(folder)}
    assert all(result.holds for result in results.values())
    assert set(results) == {"design", "contents", *held(data)}
    for name in held(data):
        assert results[name].statement == claim(data, name)["statement"]
    assert run(_certify, [str(folder)]) == 0
    shown = capsys.readouterr().out
    assert all(claim(data, name)["statement"] in shown for name in held(data))


def test_all_claims_are_among_the_designs():
    names = {
        name for make in DESIGNS.values() for name in held(json.loads(certify(make()).to_json()))
    }
    assert names == {
        "equilibrium", "casimir", "structure", "slope", "damping", "decrease", "attraction",
        "stability", "region", "input_limits", "clipping", "global",
    }  # fmt: skip


def test_a_statement_in_other_words_is_rejected(folder, rejected):
    data = content(folder)
    for change in (lambda s: s + " and more", lambda s: s[:-1], lambda s: ""):
        altered = copy.deepcopy(data)
        for name in held(data):
            claim(altered, name)["statement"] = change(claim(altered, name)["statement"])
        assert rejected(altered) == set(held(data))


def test_one_other_word_is_enough(folder, rejected):
    for name in ("casimir", "decrease"):
        altered = content(folder)
        claim(altered, name)["statement"] += " and more"
        assert rejected(altered) == {name}


def test_a_bolder_region_is_rejected(folder, rejected):
    """A higher level, another obstacle, or more about the solutions than is proved."""
    data = content(folder)
    follows = claim(data, "region")["data"]["follows"]

    def told(change, after=follows):
        altered = copy.deepcopy(data)
        change(altered)
        reworded(altered, after)
        return rejected(altered)

    def higher(altered):
        altered["level_above_minimum"] *= 1.01

    def farther(altered):
        altered["obstacle"]["level_above_minimum"] *= 1.01

    def elsewhere(altered):
        altered["obstacle"]["kind"] = "singularity"

    for change in (higher, farther, elsewhere):
        assert "region" in told(change)
    if follows != "converges":
        assert "region" in told(lambda altered: None, "converges")


def reworded(data, follows):
    """The region's claim with something else about solutions, in data and words."""
    region = claim(data, "region")
    region["data"]["follows"] = follows
    region["statement"] = worded(data, follows)


def test_words_about_solutions_that_the_data_do_not_say_are_rejected(folder, rejected):
    """Neither alone is enough, though the weaker of them is true."""
    data = content(folder)
    truth = claim(data, "region")["data"]["follows"]
    for other in {"converges", "invariant", "stable"} - {truth}:
        in_words, in_data = copy.deepcopy(data), copy.deepcopy(data)
        reworded(in_words, other)
        claim(in_words, "region")["data"]["follows"] = truth
        claim(in_data, "region")["data"]["follows"] = other
        assert rejected(in_words) == {"region"}
        assert rejected(in_data) - {"input_limits", "clipping", "contents"} == {"region"}


def test_a_weaker_true_statement_is_accepted(folder, tmp_path, rejected):
    data = content(folder)
    follows = claim(data, "region")["data"]["follows"]
    reworded(data, "invariant")
    if follows == "converges":
        (tmp_path / "certificate.json").write_text(json.dumps(data), encoding="utf-8")
        (tmp_path / "design.json").write_bytes((folder / "design.json").read_bytes())
        assert all(result.holds for result in check(tmp_path))
    elif follows == "stable":
        assert "region" in rejected(data)


INVENTED = [
    {"name": "robustness", "holds": True, "statement": "any u works", "data": {}},
    {"name": "global", "holds": False, "statement": "z̄ attracts everything", "data": {}},
    {"name": "robustness", "holds": False, "statement": "no global claim: but", "data": {}},
]


@pytest.mark.parametrize("extra", INVENTED, ids=["held", "not held", "unknown"])
def test_an_invented_claim_is_rejected(folder, rejected, extra):
    data = content(folder)
    data["claims"] = [c for c in data["claims"] if c["name"] != extra["name"]] + [extra]
    data["is_global"] = False if extra["name"] == "global" else data["is_global"]
    assert "contents" in rejected(data)


def test_a_claim_that_is_made_twice_is_rejected(folder, rejected):
    data = content(folder)
    for name in ("decrease", "region"):
        altered = copy.deepcopy(data)
        altered["claims"].insert(0, claim(altered, name) | {"statement": "all is well"})
        assert "contents" in rejected(altered)


@pytest.mark.parametrize("path", [(), ("region",), ("claims", 0), ("claims", 0, "data"),
                                  ("claims", 3, "data"), ("claims", 7, "data")])  # fmt: skip
def test_a_field_that_nobody_checks_is_rejected(folder, rejected, path):
    data = content(folder)
    at = data
    for key in path:
        at = at[key]
    at["volume_share"] = 0.9
    assert rejected(data)


def test_an_obstacle_of_no_known_kind_is_unreadable(folder, tmp_path):
    data = content(folder)
    data["obstacle"]["kind"] = "else"
    (tmp_path / "certificate.json").write_text(json.dumps(data), encoding="utf-8")
    (tmp_path / "design.json").write_bytes((folder / "design.json").read_bytes())
    assert run(_certify, [str(tmp_path)]) == 2


def at_odds(data):
    """Fields that no longer agree with the claims, or with each other."""
    yield data | {"format": 2}
    yield data | {"format": data["format"] + 1}
    yield data | {"is_global": not data["is_global"]}
    yield data | {"stability": "stable" if data["stability"] == "asymptotic" else "asymptotic"}
    yield data | {"reach": None}
    yield data | {"level_above_minimum": data["level_above_minimum"] + 1.0}
    yield data | {"claims": [c for c in data["claims"] if c["name"] != "region"]}
    yield data | {"level_u": data["level"] if data["level_u"] is None else None}


def test_fields_at_odds_with_the_claims_are_rejected(folder, tmp_path):
    for altered in at_odds(content(folder)):
        (tmp_path / "certificate.json").write_text(json.dumps(altered), encoding="utf-8")
        (tmp_path / "design.json").write_bytes((folder / "design.json").read_bytes())
        assert run(_certify, [str(tmp_path)]) != 0


@given(value=st.floats(-1e9, 1e9, allow_subnormal=False), digits=st.integers(1, 6))
def test_numbers_are_shown_on_the_safe_side(value, digits):
    low, high = (float(f(value, digits)) for f in (statements.down, statements.up))
    assert low <= value <= high
    assert high - low <= 2 * 10.0 ** (1 - digits) * abs(value)


def test_limits_of_integral_action_are_conditions_rounded_down_and_bounds_rounded_up():
    pushes = [("-1", "1")]
    assert "with ζ* strictly within ±(1.23456)" in statements.local_integral([1.23456789], {})
    assert ", ζ* strictly within ±(1.23457)" in statements.local_integral([1.23456789], {}, pushes)
    assert ", ζ* strictly within ±(1.8)" in statements.local_integral([1.8], {}, pushes)
    assert ", ζ* within ±(1.23457)" in statements.integral(1.0, {}, [1.23456789], {}, pushes)
