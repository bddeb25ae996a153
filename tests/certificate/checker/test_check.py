"""The independent checker accepts what the maker proved and nothing looser."""

import copy
import dataclasses
import hashlib
import json

import numpy as np
import pytest
from helpers.certificates import altered, claim, verdicts
from helpers.constructed import (
    EXAMPLES,
    make_design,
    mechanical,
    quadratic_pendulum,
)

from necc_casadi import Options, find_casimirs, judge, load_model
from necc_casadi import design as synthesised
from necc_casadi.certificate.checker.check import check
from necc_casadi.certificate.prover.certify import certify
from necc_casadi.cli.certify import _certify
from necc_casadi.cli.terminal import run
from necc_casadi.errors import OutputError
from necc_casadi.lyapunov.networks import Network
from necc_casadi.lyapunov.parameterization import Form
from necc_casadi.model.closed_loop import interconnect
from necc_casadi.model.target import target_from_model


@pytest.fixture(scope="module")
def pendulum(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pendulum")
    design = quadratic_pendulum()
    design.save(folder / "design.json")
    (folder / "certificate.json").write_text(certify(design).to_json(), encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def chain(tmp_path_factory):
    """A design in four coupled states, whose region is an ellipsoid."""
    folder = tmp_path_factory.mktemp("chain")
    plant = mechanical(
        lambda q1, q2, q3, p1, p2, p3: (
            (p1**2 + p2**2 + p3**2 + q1**2 + (q2 - q1) ** 2 + (q3 - q2) ** 2) / 2 + q1**4 / 40
        ),
        3,
        inputs=[0],
    )
    form = Form(Network(1, (), quadratic=True), Network(1, (), quadratic=True))
    design = make_design(plant, [0] * 6, form, [0, 0, 1.0, 0, 0, 0, 1.0, 0], [0.0])
    design.save(folder / "design.json")
    (folder / "certificate.json").write_text(certify(design).to_json(), encoding="utf-8")
    return folder


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
    "domain_share": 1.2,
    "claims:equilibrium.data.gradient_norm": 1e-6,
    "claims:slope.data.slope": 1.5,
    "claims:attraction.data.rate": 1.05,
    "claims:region.data.volume": 1.2,
    "claims:region.data.slice_share": 1.1,
    "claims:region.data.plant_share": 1.1,
    "claims:region.data.reach_q": 1.05,
    "claims:region.data.reach_xi1": 1.05,
}


@pytest.mark.parametrize("path", LOOSENED)
def test_each_loosened_number_is_rejected(pendulum, tmp_path, path):
    assert not all(altered(pendulum, tmp_path, scaled(path, LOOSENED[path])).values())


def raise_level(data):
    data["level"] = data["region"]["level"] = data["region"]["level"] * 1.005 + 1e-3


def move_z_bar(data):
    data["z_bar"][0] += 1e-6


def grow_cells(data):
    import base64
    import zlib

    bits = np.unpackbits(
        np.frombuffer(zlib.decompress(base64.b64decode(data["region"]["cells"])), dtype=np.uint8)
    )
    grid = bits[: np.prod(data["region"]["shape"])].reshape(data["region"]["shape"])
    grid[:] = 1
    packed = zlib.compress(np.packbits(grid.ravel()).tobytes())
    data["region"]["cells"] = base64.b64encode(packed).decode()


def drop_cells(data):
    import base64
    import zlib

    bits = np.frombuffer(zlib.decompress(base64.b64decode(data["region"]["cells"])), dtype=np.uint8)
    bits = bits.copy()
    full = np.flatnonzero(bits == 255)
    bits[full[len(full) // 2]] = 0
    data["region"]["cells"] = base64.b64encode(zlib.compress(bits.tobytes())).decode()


def widen_block(data):
    data["region"]["convex_block"] = [[0, 0], [k - 1 for k in data["region"]["shape"]]]


def shift_block(data):
    data["region"]["convex_block"] = [[1, 1], [2, 2]]


def stretch_grid(data):
    data["region"]["step"] = [2 * h for h in data["region"]["step"]]


def move_grid(data):
    data["region"]["first"][0] += 5


def change_hash(data):
    data["design_hash"] = "0" * 64


def forget_momentum(data):
    data["region"]["active"] = [0, 1]


CHANGES = [
    raise_level, move_z_bar, drop_cells, stretch_grid, move_grid, shift_block,
    change_hash, forget_momentum,
]  # fmt: skip


@pytest.mark.parametrize("change", CHANGES, ids=lambda f: f.__name__)
def test_each_altered_field_is_rejected(pendulum, tmp_path, change):
    try:
        result = altered(pendulum, tmp_path, change)
    except OutputError:
        return
    assert not all(result.values())


def test_cells_of_another_well_and_a_ball_that_reaches_it_are_rejected(tmp_path):
    """A double well: true of one well, false of both together."""
    plant = mechanical(lambda q, p: p**2 / 2 + (q**2 - 1) ** 2 / 4, 1)
    form = Form(Network(1, (), quadratic=True), Network(1, (), quadratic=True))
    design = make_design(plant, (1, 0), form, [0, 0, 1.0, 0, 0, 0, 0.01, 1.0], [0.0])
    folder = tmp_path / "made"
    folder.mkdir()
    design.save(folder / "design.json")
    (folder / "certificate.json").write_text(certify(design).to_json(), encoding="utf-8")
    assert all(verdicts(folder).values())
    assert not altered(folder, tmp_path, grow_cells)["region"]
    assert not altered(folder, tmp_path, scaled("radius", 4.0))["equilibrium"]


def test_a_global_claim_is_proved_again_or_rejected(pendulum, tmp_path):
    assert verdicts(pendulum)["global"]
    design = quadratic_pendulum(k=1.3, h=4)  # convex near z̄ only
    made = certify(design)
    assert made.certified
    assert not made.is_global
    design.save(tmp_path / "design.json")
    data = json.loads(made.to_json()) | {"is_global": True}
    (tmp_path / "certificate.json").write_text(json.dumps(data), encoding="utf-8")
    assert not verdicts(tmp_path)["global"]


def test_a_lowered_level_may_still_be_true(pendulum, tmp_path):
    def lower(data):
        data["level"] = data["region"]["level"] = data["region"]["level"] - 1e-3
        kept = {key: claim(data, "region")["data"][key] for key in ("limit", "follows")}
        claim(data, "region")["data"] = {"domain_share": 0.01, **kept}
        data["domain_share"] = 0.01

    assert all(altered(pendulum, tmp_path, lower).values())


def test_a_changed_design_is_detected(pendulum, tmp_path):
    text = (pendulum / "design.json").read_text(encoding="utf-8")
    data = json.loads(text)
    data["weights"][2] = (float.fromhex(data["weights"][2]) * 1.0000001).hex()
    (tmp_path / "design.json").write_text(json.dumps(data, indent=1), encoding="utf-8")
    (tmp_path / "certificate.json").write_bytes((pendulum / "certificate.json").read_bytes())
    assert not verdicts(tmp_path)["design"]


def more_curvature(data):
    data["region"]["nu"] = [v * 1.5 + 0.1 for v in data["region"]["nu"]]


def larger_ellipsoid(data):
    data["region"]["radii"] = [3 * r for r in data["region"]["radii"]]


def moved_center(data):
    data["region"]["center"][1] += 0.5


def raised_ellipsoid_level(data):
    data["level"] = data["region"]["level"] = data["region"]["level"] + 0.5


def smaller_above(data):
    data["region"]["above"] *= 0.5


def longer_reach(data):
    reach = claim(data, "region")["data"]
    reach.update({key: 1.3 * reach[key] for key in reach if key.startswith("reach_")})


def larger_share(data):
    data["domain_share"] = claim(data, "region")["data"]["domain_share"] = (
        1.3 * data["domain_share"]
    )


def flatter_factor(data):
    data["region"]["L"] = [[0.7 * v for v in row] for row in data["region"]["L"]]


ELLIPSOID_CHANGES = [
    more_curvature, larger_ellipsoid, moved_center, raised_ellipsoid_level, smaller_above,
    longer_reach, larger_share, flatter_factor,
]  # fmt: skip


def test_the_ellipsoid_is_proved_again(chain):
    assert all(verdicts(chain).values())


@pytest.mark.parametrize("change", ELLIPSOID_CHANGES, ids=lambda f: f.__name__)
def test_each_altered_field_of_an_ellipsoid_is_rejected(chain, tmp_path, change):
    assert not all(altered(chain, tmp_path, change).values())


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


@pytest.mark.parametrize(("k", "h"), [(1.1, 1.5), (1.5, 1.5)])
def test_a_region_that_ends_at_a_pass_is_proved_again(k, h, tmp_path):
    """V is weakly curved at z̄, and a second critical point ends the region inside the domain."""
    design = quadratic_pendulum(k, h, target="2*pi/3", xi=0.2)
    certificate = certify(design)
    assert "a possible critical point" in certificate.limited_by
    design.save(tmp_path / "design.json")
    (tmp_path / "certificate.json").write_text(certificate.to_json(), encoding="utf-8")
    assert all(verdicts(tmp_path).values())
