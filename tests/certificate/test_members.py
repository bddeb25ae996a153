"""Regions of a family's members: proved, checked, attacked from inside, and altered."""

import json

import casadi as ca
import numpy as np
import pytest
import sympy as sp
from helpers.certificates import checked_family
from helpers.models import WEIGHTED
from helpers.problems import problem, solve

from necc_casadi.certificate.claims.members import MembersClaim
from necc_casadi.certificate.claims.regions import CellBox, packed
from necc_casadi.certificate.prover.certify import certify
from necc_casadi.certificate.prover.family import prove_family
from necc_casadi.certificate.prover.members import prove_members
from necc_casadi.designs.family import lift
from necc_casadi.designs.plant_file import plant_text
from necc_casadi.model.model_file import load_model
from necc_casadi.model.ranges import Ranges
from necc_casadi.synthesis.options import Options

S = sp.Rational

PENDULUM = f"""{WEIGHTED}domain = {{q: (-2, 2)}}
"""

RANGES = Ranges(
    {"q": (S(1, 2), S(4, 5))}, {"m": (S(9, 10), S(11, 10)), "g": (S(19, 20), S(21, 20))}
)


@pytest.fixture(scope="module")
def task(tmp_path_factory):
    path = tmp_path_factory.mktemp("members") / "plant.py"
    path.write_text(PENDULUM, encoding="utf-8")
    return problem(load_model(path), "pi/5")


@pytest.fixture(scope="module")
def family(task):
    made = solve(task, Options(convex=True, hidden_k=(6,), hidden_h=(6,)))
    return lift(made, RANGES, task.model.parametric)


@pytest.fixture(scope="module")
def near(family):
    return prove_family(family)


@pytest.fixture(scope="module")
def claim(family, near):
    return prove_members(family, near)


@pytest.fixture(scope="module")
def written(family, near, claim):
    certificate = certify(family.design, region=False).having(near, claim)
    return family.design.text, family.text, json.loads(certificate.to_json())


@pytest.fixture
def folder(family, task, tmp_path):
    text = plant_text(family.design, task.model.parametric)
    (tmp_path / "plant.json").write_text(text, encoding="utf-8")
    return tmp_path


def test_it_is_proved(claim):
    assert claim.holds, claim.statement
    assert not claim.data["left"]
    assert claim.data["share"] > 0.05
    assert claim.data["step"]["q"] > 0.05


def test_it_is_checked(written, folder):
    results = checked_family(folder, *written)
    assert results["members"].holds, results["members"].statement
    assert results["contents"].holds


def starts(family, box, count, seed):
    """Random members of a box of ϑ, and states in its region: ϑ (k, count), z (3, count)."""
    rng = np.random.default_rng(seed)
    units, star = family.design.units, family.design.z_star
    V = family.V_function.map(count)
    theta = np.array([rng.uniform(lo, hi, count) for lo, hi in box["theta"]])
    half = np.array(box["half"]) * units.state[[0, 2]]
    z = np.repeat(star[:, None], count, 1)
    rest = np.asarray(V(z, theta), float)[0]
    away = rng.uniform(-1, 1, (2, count)) * half[:, None]
    for _ in range(60):  # towards z* until below the level
        z[[0, 2]] = star[[0, 2], None] + away
        high = np.asarray(V(z, theta), float)[0] - rest
        away[:, high > box["level"] * units.energy] *= 0.9
    left = box["level"] * units.energy - (np.asarray(V(z, theta), float)[0] - rest)
    mass = theta[1]
    z[1] = rng.choice([-1, 0, 1], count) * np.sqrt(np.maximum(2 * mass * left, 0)) * 0.999
    return theta, z, rest, half


def attack(family, claim, near, count, seconds, step=0.05):
    """Whether solutions from the regions stay there and end where the family rests."""
    star, level_unit = family.design.z_star, family.design.units.energy
    lo, hi = near.data["error"]["q"]
    for seed, box in enumerate(claim.data["boxes"]):
        theta, z, rest, half = starts(family, box, count, seed)
        r, m, g = theta
        law, V = family.control_law_function.map(count), family.V_function.map(count)
        shift = r - float(family.parameters[0].nominal)

        def flow(z):
            q, rate = z[0] + shift, z[1] / m  # noqa: B023
            u, xi_dot = law(np.stack([q, rate]), z[2][None], r[None])  # noqa: B023
            return np.stack(
                [rate, np.asarray(u)[0] - m * g * np.sin(q), np.asarray(xi_dot)[0]]  # noqa: B023
            )

        for k in range(round(seconds / step)):
            a = flow(z)
            b = flow(z + step / 2 * a)
            c = flow(z + step / 2 * b)
            z = z + step / 6 * (a + 2 * b + 2 * c + flow(z + step * c))
            if k % 10 == 0:
                above = np.asarray(V(z, theta), float)[0] - rest
                assert above.max() <= box["level"] * level_unit * (1 + 1e-6)
                assert (np.abs(z[[0, 2]] - star[[0, 2], None]) <= half[:, None]).all()
        assert lo - 1e-3 <= (z[0] - star[0]).min()
        assert (z[0] - star[0]).max() <= hi + 1e-3
        assert np.abs(z[1]).max() < 1e-2


def test_solutions_from_the_regions_stay_and_come_to_rest(family, claim, near):
    attack(family, claim, near, 40, 40)


@pytest.mark.slow
def test_thousands_of_solutions_stay(family, claim, near):
    attack(family, claim, near, 2000, 60)


def test_marked_cells_are_in_every_region(family, claim):
    """By values of V at corners of cells, for random members."""
    rng = np.random.default_rng(5)
    found = MembersClaim.read(json.loads(json.dumps(claim.data)))
    cells = marked(found)
    rows = rng.choice(len(cells), 40)
    star, energy = family.design.z_star, family.design.units.energy
    z, theta = ca.MX.sym("z", 3), ca.MX.sym("theta", 3)
    E = ca.Function("E", [z, theta], [family.V_function(z, theta) - family.V_function(star, theta)])
    for box in found.boxes:
        for row in rows:
            at = star.copy()
            at[[0, 2]] = [rng.choice(side) for side in cells[row]]
            values = [rng.choice(side) for side in box.theta]
            assert float(E(at, values)) <= box.level * energy


def marked(found):
    from necc_casadi.certificate.claims.regions import Region

    region = Region(0.0, found.active, (0, 1), (), (None, None), (), found.grid, (), found.cells)
    return [found.grid.cell(leaf) for leaf in region.leaves]


def _higher(data):
    data["boxes"][0]["level"] *= 1.5


def _wider(data):
    data["boxes"][0]["half"] = [4 * v for v in data["boxes"][0]["half"]]


def _dropped(data):
    data["boxes"].pop()


def _farther(data):
    data["step"]["q"] = 3.0


def _fuller(data):
    parts = data["grid"]["parts"]
    data["cells"] = packed((0, (i, j)) for i in range(parts) for j in range(parts))


def _larger(data):
    data["share"] *= 1.2


@pytest.mark.parametrize("alter", [_higher, _wider, _dropped, _farther, _fuller, _larger])
@pytest.mark.slow
def test_an_altered_claim_does_not_hold(alter, written, folder):
    design, family, certificate = written
    certificate = json.loads(json.dumps(certificate))
    alter(next(c for c in certificate["claims"] if c["name"] == "members")["data"])
    assert not checked_family(folder, design, family, certificate)["members"].holds


def test_a_grid_is_what_it_says():
    assert CellBox((0.0,), (1.0,), 4).cell((0, (3,))) == ((0.75, 1.0),)
