"""The independent checker accepts what the maker proved and nothing looser."""

import copy
import dataclasses
import hashlib
import json

import numpy as np
import pytest
from helpers.certificates import altered, claim, verdicts, written
from helpers.constructed import (
    EXAMPLES,
    quadratic_pendulum,
    trained_like_pendulum,
)
from helpers.oscillators import chain as coupled_masses
from helpers.oscillators import double_well, sides, soft_pendulum

from necc_casadi import Options, find_casimirs, judge, load_model
from necc_casadi import design as synthesised
from necc_casadi.certificate.checker.check import check
from necc_casadi.certificate.claims.fields import read_as
from necc_casadi.certificate.claims.regions import Region, packed
from necc_casadi.certificate.prover.certify import certify
from necc_casadi.cli.certify import _certify
from necc_casadi.cli.terminal import run
from necc_casadi.errors import OutputError
from necc_casadi.model.closed_loop import interconnect
from necc_casadi.model.target import target_from_model


@pytest.fixture(scope="module")
def pendulum(tmp_path_factory):
    """A region that ends at a pass; q is kept."""
    return written(soft_pendulum(), tmp_path_factory.mktemp("pendulum"))


@pytest.fixture(scope="module")
def chain(tmp_path_factory):
    """A region that ends at a bound, in four coupled states of which none is kept."""
    design = coupled_masses(sides(q1=1.0, p2=2.0))
    return written(design, tmp_path_factory.mktemp("chain"))


@pytest.fixture(scope="module")
def plane(tmp_path_factory):
    """A region over two kept states."""
    return written(trained_like_pendulum((8,)), tmp_path_factory.mktemp("plane"))


@pytest.fixture(params=["pendulum", "chain", "plane"])
def any_region(request):
    return request.getfixturevalue(request.param)


def test_a_region_is_proved_again(any_region):
    assert all(verdicts(any_region).values())


@pytest.fixture(scope="module")
def coupled(tmp_path_factory):
    """A full damping with a large skew part, and input limits, which see both ports."""
    folder = tmp_path_factory.mktemp("coupled")
    design = quadratic_pendulum()
    plant = dataclasses.replace(design.loop.plant, u_limits=((-6.0, 6.0),))
    design = dataclasses.replace(
        design,
        loop=interconnect(plant, design.loop.controller),
        damping=np.array([[5.0, 7.0], [-5.0, 6.0]]),
    )
    design.save(folder / "design.json")
    (folder / "certificate.json").write_text(certify(design).to_json(), encoding="utf-8")
    return folder


def test_a_full_damping_is_proved_again(coupled):
    result = verdicts(coupled)
    assert all(result.values()), result
    assert {"damping", "decrease", "attraction", "region", "input_limits"} <= set(result)


def test_the_coupling_of_the_damping_counts(coupled, tmp_path):
    """With another coupling V̇ or the rate of the linearisation is another."""
    certificate = json.loads((coupled / "certificate.json").read_text(encoding="utf-8"))
    stored = json.loads((coupled / "design.json").read_text(encoding="utf-8"))
    for upper, lower, refused in [
        (9.0, 9.0, {"damping", "decrease"}),
        (200.0, -200.0, {"attraction"}),
    ]:
        stored["coupling"] = [[[upper.hex()]], [[lower.hex()]]]
        text = json.dumps(stored)
        certificate["design_hash"] = hashlib.sha256(text.encode()).hexdigest()
        (tmp_path / "design.json").write_text(text, encoding="utf-8")
        (tmp_path / "certificate.json").write_text(json.dumps(certificate), encoding="utf-8")
        result = verdicts(tmp_path)
        assert result["design"]
        assert refused <= {name for name, holds in result.items() if not holds}, (upper, result)


def test_everything_that_was_made_is_proved_again(pendulum):
    result = verdicts(pendulum)
    assert all(result.values())
    assert {"design", "equilibrium", "decrease", "attraction", "region"} <= set(result)


def scaled(path, factor):
    """Multiply the number at a path like ``region.level`` or ``claims:slope.data.slope``."""

    def change(data):
        *parents, last = path.split(".")
        at = data
        for key in parents:
            at = claim(data, key.removeprefix("claims:")) if key.startswith("claims:") else at[key]
        at[last] = at[last] * factor

    return change


LOOSENED = {
    "mu": 2.2,
    "bound_rigorous": 1e-6,
    "enclosure": 1e-6,
    "level": 1.005,
    "level_above_minimum": 1.01,
    "obstacle.level_above_minimum": 1.01,
    "obstacle.at.q": 1.01,
    "claims:equilibrium.data.gradient_norm": 1e-6,
    "claims:slope.data.slope": 1.5,
    "claims:attraction.data.rate": 1.05,
}


@pytest.mark.parametrize("path", LOOSENED)
def test_each_loosened_number_is_rejected(pendulum, tmp_path, path):
    assert not all(altered(pendulum, tmp_path, scaled(path, LOOSENED[path])).values())


def raise_level(data):
    """To a little above the obstacle: true regions end below it."""
    height = 1.005 * data["obstacle"]["level_above_minimum"] - data["level_above_minimum"]
    data["level"] = data["level"] + height
    data["region"]["level"] = data["level"]  # in units that are 1 here
    data["level_above_minimum"] += height * (1 - 1e-6)


def raise_obstacle_too(data):
    raise_level(data)
    data["obstacle"]["level_above_minimum"] *= 1.01


def other_kind(data):
    kinds = {"critical_point": "domain", "domain": "critical_point", "arithmetic": "singularity"}
    data["obstacle"]["kind"] = kinds[data["obstacle"]["kind"]]


def place_forgotten(data):
    data["obstacle"]["at"].popitem()


def move_z_bar(data):
    data["z_bar"][0] += 1e-6


def leaves_of(region):
    return read_as(Region, region).leaves


def with_leaves(data, leaves):
    data["region"]["cells"] = packed(leaves)


def drop_a_leaf(data):
    leaves = list(leaves_of(data["region"]))
    del leaves[len(leaves) // 2]
    with_leaves(data, leaves or [(0, tuple(0 for _ in data["region"]["kept"]))])


def drop_the_minimum(data):
    """All cells but those around z̄."""
    region = read_as(Region, data["region"])
    s = [data["z_bar"][region.active[i]] for i in region.kept]
    far = [
        leaf
        for leaf in region.leaves
        if not all(
            lo - 1e-3 <= v <= hi + 1e-3
            for v, (lo, hi) in zip(s, region.box.cell(leaf), strict=True)
        )
    ]
    with_leaves(data, far)


def double_a_leaf(data):
    leaves = list(leaves_of(data["region"]))
    depth, index = leaves[0]
    with_leaves(data, [*leaves, (depth + 1, tuple(2 * k for k in index))])


def stiffer_floor(data):
    data["region"]["floor"] = [[1.1 * v for v in row] for row in data["region"]["floor"]]


def larger_core(data):
    data["region"]["core"] = [
        [lo, lo + side]
        for lo, side in zip(data["region"]["box"]["lo"], data["region"]["box"]["side"], strict=True)
    ]


def core_elsewhere(data):
    data["region"]["core"] = [[hi, hi + 0.1] for _, hi in data["region"]["core"]]


def shorter_reach(state):
    def change(data):
        lo, hi = data["reach"][state]
        data["reach"][state] = [lo, lo + 0.9 * (hi - lo)]

    change.__name__ = f"shorter reach of {state}"
    return change


def other_kept(data):
    region = data["region"]
    rest = [i for i in range(len(region["active"])) if i not in region["kept"]]
    region["kept"] = sorted([*region["kept"][1:], rest[-1]])


def swapped_active(data):
    data["region"]["active"] = data["region"]["active"][::-1]


def stretched_box(data):
    data["region"]["box"]["side"] = [1.1 * v for v in data["region"]["box"]["side"]]


def moved_box(data):
    data["region"]["box"]["lo"] = [v + 0.1 for v in data["region"]["box"]["lo"]]


def invented_bends(data):
    data["region"]["bends"] = [10.0, 10.0]


def change_hash(data):
    data["design_hash"] = "0" * 64


def forget_momentum(data):
    data["region"]["active"] = [0, 1]


CHANGES = [
    raise_level, raise_obstacle_too, other_kind, place_forgotten, move_z_bar, drop_a_leaf,
    drop_the_minimum, double_a_leaf, stiffer_floor, larger_core, core_elsewhere,
    *(shorter_reach(state) for state in ("q", "p", "xi1")), other_kept, swapped_active,
    stretched_box, moved_box, invented_bends, change_hash, forget_momentum,
]  # fmt: skip


def is_rejected(folder, tmp_path, change) -> bool:
    try:
        return not all(altered(folder, tmp_path, change).values())
    except OutputError:  # not even readable
        return True


@pytest.mark.parametrize("change", CHANGES, ids=lambda f: f.__name__)
def test_each_altered_field_is_rejected(pendulum, tmp_path, change):
    assert is_rejected(pendulum, tmp_path, change)


CHAIN_CHANGES = [
    raise_level, other_kind, stiffer_floor, forget_momentum,
    *(shorter_reach(state) for state in ("q1", "q3", "xi1", "p1")),
]  # fmt: skip


@pytest.mark.parametrize("change", CHAIN_CHANGES, ids=lambda f: f.__name__)
def test_each_altered_field_of_a_region_without_cells_is_rejected(chain, tmp_path, change):
    assert is_rejected(chain, tmp_path, change)


PLANE_CHANGES = [raise_level, drop_a_leaf, larger_core, shorter_reach("q"), shorter_reach("p")]


@pytest.mark.parametrize("change", PLANE_CHANGES, ids=lambda f: f.__name__)
def test_each_altered_field_of_a_region_over_a_plane_is_rejected(plane, tmp_path, change):
    assert is_rejected(plane, tmp_path, change)


HOSTILE = {
    "too deep": {"cells": [(41, (0,))]},
    "outside of the box": {"cells": [(0, (128,))]},
    "negative": {"cells": [(0, (-1,))]},
    "twice": {"cells": [(0, (3,)), (0, (3,))]},
    "no cells": {"cells": []},
    "too many": {"cells": [(20, (k,)) for k in range(200_001)]},
    "no base 64": {"cells": "????"},
    "parts": {"box": {"lo": [0.0], "side": [4.0], "parts": 3}},
    "many parts": {"box": {"lo": [0.0], "side": [4.0], "parts": 1 << 20}},
    "no side": {"box": {"lo": [0.0], "side": [0.0], "parts": 32}},
    "floor of another size": {"floor": [[1.0, 0.0], [0.0, 1.0]]},
    "floor that is not symmetric": {"kept": [], "floor": [[1.0, 0.5], [0.0, 1.0]], "core": []},
    "indefinite floor": {"floor": [[-1.0]]},
    "kept twice": {"kept": [0, 0]},
    "kept out of range": {"kept": [2]},
}


@pytest.mark.parametrize("part", HOSTILE)
def test_hostile_regions_are_refused_at_once(pendulum, tmp_path, part):
    def change(data):
        cells = HOSTILE[part].get("cells")
        data["region"] |= HOSTILE[part]
        if isinstance(cells, list):
            with_leaves(data, cells)

    with pytest.raises(OutputError):
        altered(pendulum, tmp_path, change)


def test_cells_of_another_well_and_a_ball_that_reaches_it_are_rejected(tmp_path):
    """A double well: true of one well, false of both together."""
    folder = written(double_well(0.01), tmp_path / "made")
    assert all(verdicts(folder).values())

    def both_wells(data):
        box = data["region"]["box"]
        box["lo"], box["side"] = [-3.0], [6.0]
        with_leaves(data, [(0, (k,)) for k in range(box["parts"])])

    assert not altered(folder, tmp_path, both_wells)["region"]
    assert not altered(folder, tmp_path, scaled("radius", 4.0))["equilibrium"]


def test_a_global_claim_is_proved_again_or_rejected(pendulum, tmp_path):
    stiff = written(quadratic_pendulum(), tmp_path / "stiff")
    assert verdicts(stiff)["global"]
    claimed = json.loads((stiff / "certificate.json").read_text(encoding="utf-8"))
    data = json.loads((pendulum / "certificate.json").read_text(encoding="utf-8"))
    assert not data["is_global"]
    data["claims"] = [c for c in data["claims"] if c["name"] != "global"]
    data["claims"].append(claim(claimed, "global"))
    data["is_global"] = True
    (tmp_path / "certificate.json").write_text(json.dumps(data), encoding="utf-8")
    (tmp_path / "design.json").write_bytes((pendulum / "design.json").read_bytes())
    assert not verdicts(tmp_path)["global"]


def test_a_lowered_level_may_still_be_true(pendulum, tmp_path):
    def lower(data):
        data["level"] = data["region"]["level"] = data["region"]["level"] - 1e-3
        data["level_above_minimum"] -= 1e-3

    assert all(altered(pendulum, tmp_path, lower).values())


def test_a_changed_design_is_detected(pendulum, tmp_path):
    text = (pendulum / "design.json").read_text(encoding="utf-8")
    data = json.loads(text)
    data["weights"][2] = (float.fromhex(data["weights"][2]) * 1.0000001).hex()
    (tmp_path / "design.json").write_text(json.dumps(data, indent=1), encoding="utf-8")
    (tmp_path / "certificate.json").write_bytes((pendulum / "certificate.json").read_bytes())
    assert not verdicts(tmp_path)["design"]


@pytest.mark.parametrize("text", ["", "{}", "[1]", '{"claims": []}'])
def test_unreadable_files_are_input_errors(pendulum, tmp_path, text):
    (tmp_path / "design.json").write_bytes((pendulum / "design.json").read_bytes())
    (tmp_path / "certificate.json").write_text(text, encoding="utf-8")
    with pytest.raises(OutputError):
        check(tmp_path)


def test_command_line(pendulum, tmp_path, capsys):
    assert run(_certify, [str(pendulum)]) == 0
    assert "equilibrium  holds" in capsys.readouterr().out
    assert run(_certify, [str(pendulum), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["status"] == "certified"
    assert run(_certify, [str(tmp_path)]) == 2
    data = json.loads((pendulum / "certificate.json").read_text(encoding="utf-8"))
    change = copy.deepcopy(data)
    raise_level(change)
    (tmp_path / "design.json").write_bytes((pendulum / "design.json").read_bytes())
    (tmp_path / "certificate.json").write_text(json.dumps(change), encoding="utf-8")
    assert run(_certify, [str(tmp_path)]) == 4
    assert "DOES NOT HOLD" in capsys.readouterr().out


def test_a_stiff_design_in_six_states_is_proved_again(tmp_path):
    """Where V is stiff, ∇V(z*) over a box of doubles exceeds the bound that the maker claims."""
    model = load_model(EXAMPLES / "two_link_arm.py")
    target = target_from_model(model.loop.plant, model.target)
    casimirs = find_casimirs(model.loop, model.casimirs, target)
    verdict = judge(model.loop, casimirs, target)
    made = synthesised(model.loop, casimirs, verdict, target, Options(convex=True))
    made.save(tmp_path / "design.json")
    certificate = certify(made, region=False)
    assert certificate.certified
    (tmp_path / "certificate.json").write_text(certificate.to_json(), encoding="utf-8")
    result = verdicts(tmp_path)
    assert all(result.values())
    assert result["attraction"]
