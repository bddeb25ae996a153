"""A refused claim says what was not proved."""

import json

import pytest
from helpers.certificates import claim, reword
from helpers.constructed import quadratic_pendulum
from helpers.oscillators import soft_pendulum

from necc_casadi.certificate.checker.check import check
from necc_casadi.certificate.checker.evidence import Checked
from necc_casadi.certificate.claims.fields import read_as
from necc_casadi.certificate.claims.regions import Region, packed
from necc_casadi.certificate.prover.certify import certify
from necc_casadi.errors import OutputError


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
    """A region below a pass, and another design of the whole space."""
    designs = {"region": soft_pendulum(), "global": quadratic_pendulum()}
    return {name: (design, certify(design).to_json()) for name, design in designs.items()}


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


def lower(data):
    data["level"] = data["region"]["level"] = data["region"]["level"] - 1e-3


def without_momentum(data):
    data["region"]["active"] = [0, 1]
    data["region"]["kept"] = [0]


def stiffer(data):
    data["region"]["floor"] = [[1.1 * v for v in row] for row in data["region"]["floor"]]


def other_core(data):
    data["region"]["core"] = [[hi, hi + 0.1] for _, hi in data["region"]["core"]]


def wide_core(data):
    box = data["region"]["box"]
    data["region"]["core"] = [[box["lo"][0], box["lo"][0] + box["side"][0]]]


def fewer_cells(data):
    leaves = read_as(Region, data["region"]).leaves
    data["region"]["cells"] = packed(leaves[: len(leaves) // 2 + 4])


def short_reach(data):
    data["reach"]["p"] = [0.9 * v for v in data["reach"]["p"]]


def nowhere(data):
    data["obstacle"]["at"] = {}


def moved_obstacle(data):
    data["obstacle"]["at"]["xi1"] += 0.1


def other_obstacle(data):
    data["obstacle"]["kind"] = "domain"


def negative_rate(data):
    claim(data, "attraction")["data"]["rate"] = -1.0


def quicker(data):
    claim(data, "attraction")["data"]["rate"] *= 1.5


def steeper(data):
    claim(data, "slope")["data"]["slope"] = 1.5


def momentum_forgotten(data):
    entry = claim(data, "global")["data"]
    entry["active"] = [0, 1]


def turned_floor(data):
    entry = claim(data, "global")["data"]
    entry["floor"] = [[-v for v in row] for row in entry["floor"]]


def steeper_floor(data):
    entry = claim(data, "global")["data"]
    entry["floor"] = [[1.5 * v for v in row] for row in entry["floor"]]


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
    (low, "region", "the level is as high above V(z̄)"),
    (lower, "region", "the level is as high above V(z̄)"),
    (raised, "region", "w > c around the marked cells"),
    (without_momentum, "region", "the resting states are momenta"),
    (stiffer, "region", "V_ee ⪰ F for every e"),
    (other_core, "region", "z̄ is over the core, in marked cells"),
    (wide_core, "region", "∇²w ≻ 0 on the core"),
    (fewer_cells, "region", "w > c around the marked cells"),
    (short_reach, "region", "every state is within its reach"),
    (nowhere, "region", "the obstacle has a place"),
    (moved_obstacle, "region", "the obstacle is at that height"),
    (other_obstacle, "region", "the obstacle is what it is said to be"),
    (quicker, "global", "z̄ is stable"),
    (momentum_forgotten, "global", "the resting states are momenta"),
    (steeper_floor, "global", "V is radially unbounded with one critical point"),
]


@pytest.mark.parametrize(
    ("change", "name", "words"), REFUSALS, ids=lambda v: getattr(v, "__name__", v)
)
def test_a_refused_claim_says_what_was_not_proved(made, tmp_path, change, name, words):
    design, text = made["global" if name == "global" else "region"]
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
    design, text = made["region"]
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


def test_a_floor_that_is_not_positive_is_unreadable(made, tmp_path):
    """V_ee ⪰ F alone says nothing: F must be ≻ 0."""
    design, text = made["global"]
    data = json.loads(text)
    turned_floor(data)
    design.save(tmp_path / "design.json")
    (tmp_path / "certificate.json").write_text(json.dumps(data), encoding="utf-8")
    with pytest.raises(OutputError):
        check(tmp_path)
