"""A refused claim says what was not proved."""

import json

import pytest
from helpers.certificates import claim, reword
from helpers.constructed import quadratic_pendulum

from necc_casadi.certificate.checker.check import check
from necc_casadi.certificate.checker.evidence import Checked
from necc_casadi.certificate.prover.certify import certify


def test_the_first_obligation_that_fails_is_named_and_none_after_it_is_tried():
    tried = []

    def proof(name, outcome):
        return name, lambda: tried.append(name) or outcome

    obligations = [proof("one", True), proof("two", False), proof("three", False)]
    refused = Checked.by("name", "all is well", obligations)
    assert refused == Checked("name", False, "all is well; not proved: two")
    assert tried == ["one", "two"]
    assert Checked.by("name", "all is well", obligations[:1]) == Checked(
        "name", True, "all is well"
    )


@pytest.fixture(scope="module")
def made():
    design = quadratic_pendulum()
    return design, certify(design).to_json()


def scaled(path, factor):
    def change(data):
        *parents, last = path.split(".")
        at = data
        for key in parents:
            at = at[key]
        at[last] *= factor

    return change


def raised(data):
    data["level"] = data["region"]["level"] = data["region"]["level"] + 0.5


def low(data):
    data["level"] = data["region"]["level"] = -100.0


def without_momentum(data):
    data["region"]["active"] = [0, 1]


def other_block(data):
    data["region"]["convex_block"] = [[1, 1], [2, 2]]


def moved_grid(data):
    data["region"]["first"][0] += 50


def odd_step(data):
    data["region"]["step"] = [1.01 * h for h in data["region"]["step"]]


def larger_slice(data):
    claim(data, "region")["data"]["slice_share"] *= 1.5


def other_limit(data):
    claim(data, "region")["data"]["limit"] = {"kind": "border", "at": [0, 0]}


def negative_rate(data):
    claim(data, "attraction")["data"]["rate"] = -1.0


def quicker(data):
    claim(data, "attraction")["data"]["rate"] *= 1.5


def steeper(data):
    claim(data, "slope")["data"]["slope"] = 1.5


def momentum_forgotten(data):
    claim(data, "global")["data"]["resting"] = [0, 1]


REFUSALS = [
    (scaled("mu", -1), "equilibrium", "μ and the radius are positive"),
    (scaled("radius", 1e-20), "equilibrium", "‖∇V(z*)‖ is less than μ times the radius"),
    (scaled("bound_rigorous", 1e-6), "equilibrium", "at most the distance claimed"),
    (scaled("enclosure", 1e-9), "equilibrium", "z̄ is as near to the claimed point as is claimed"),
    (scaled("mu", 2.2), "equilibrium", "∇²V ⪰ μI on the cube around the ball"),
    (steeper, "slope", "the form has Φ₁ ≥ 1.5"),
    (steeper, "decrease", "slope"),
    (negative_rate, "attraction", "the rate is not negative"),
    (quicker, "attraction", "the Lyapunov inequality at z̄"),
    (steeper, "attraction", "z̄ is an equilibrium of a loop along which V decreases"),
    (quicker, "region", "no region is proved, for want of the stability of z̄"),
    (scaled("region.level", 1.1), "region", "the level is that of the region"),
    (low, "region", "V(z̄) < c"),
    (raised, "region", "p stays in the domain"),
    (without_momentum, "region", "the resting states are momenta"),
    (odd_step, "region", "the cells are exact"),
    (moved_grid, "region", "the cells lie in the domain"),
    (other_block, "region", "∇²V ≻ 0 on the cells around z̄"),
    (larger_slice, "region", "the sizes claimed"),
    (other_limit, "region", "it ends where it is said to"),
    (quicker, "global", "z̄ attracts"),
    (momentum_forgotten, "global", "the resting states are momenta"),
]


@pytest.mark.parametrize(
    ("change", "name", "words"), REFUSALS, ids=lambda v: getattr(v, "__name__", v)
)
def test_a_refused_claim_says_what_was_not_proved(made, tmp_path, change, name, words):
    design, text = made
    data = json.loads(text)
    change(data)
    reword(data)
    design.save(tmp_path / "design.json")
    (tmp_path / "certificate.json").write_text(json.dumps(data), encoding="utf-8")
    refused = {result.name: result for result in check(tmp_path)}[name]
    assert not refused.holds
    assert refused.statement.endswith(words)


def test_a_loop_that_is_none_is_refused_by_what_it_lacks(made, tmp_path):
    """The certificate of a design whose matrices, Casimir or damping are other ones."""
    design, text = made
    (tmp_path / "certificate.json").write_text(text, encoding="utf-8")
    stored = json.loads(design.text)
    for entry, value, name, words in [
        ("J", [["0", "1"], ["1", "0"]], "structure", "J = −Jᵀ"),
        ("R", [["0", "0"], ["0", "-1"]], "structure", "R = Rᵀ ⪰ 0"),
        ("R", [["0", "1"], ["0", "1"]], "structure", "R = Rᵀ ⪰ 0"),
        ("G", [["0"], ["2"]], "casimir", "the condition for q - xi1"),
        ("D", [["-0x1.0p+0"]], "damping", "the symmetric part is ≻ 0"),
    ]:
        part = stored if entry == "D" else stored["model"]
        changed = stored | ({"D": value} if part is stored else {"model": part | {entry: value}})
        (tmp_path / "design.json").write_text(json.dumps(changed), encoding="utf-8")
        refused = {result.name: result for result in check(tmp_path)}[name]
        assert not refused.holds
        assert refused.statement.endswith(f"; not proved: {words}")
