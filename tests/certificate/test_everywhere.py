"""Families in the whole space: proved, checked, attacked by random members and altered claims."""

import dataclasses
import json

import casadi as ca
import numpy as np
import pytest
import sympy as sp
from helpers.certificates import checked_family
from helpers.models import WEIGHTED
from helpers.problems import problem, solve
from helpers.velocity import arm_with_payload

from necc_casadi.certificate.prover.certify import certify
from necc_casadi.certificate.prover.everywhere import prove_everywhere
from necc_casadi.designs.family import lift
from necc_casadi.designs.plant_file import plant_text
from necc_casadi.methods.method import Method
from necc_casadi.model.model_file import load_model
from necc_casadi.model.ranges import Ranges
from necc_casadi.pipeline.families import family_of
from necc_casadi.synthesis.options import Options
from necc_casadi.synthesis.synthesis import design

S = sp.Rational

ARM = """
import sympy as sp
q1, q2, p1, p2, load = sp.symbols("q1 q2 p1 p2 load")
g = sp.Rational("9.81")
a1, a2, b = sp.Rational(5, 3) + 2 * load, sp.Rational(1, 3) + load, sp.Rational(1, 2) + load
M = sp.Matrix([[a1 + 2 * b * sp.cos(q2), a2 + b * sp.cos(q2)], [a2 + b * sp.cos(q2), a2]])
p = sp.Matrix([p1, p2])
T = (M[1, 1] * p1**2 - 2 * M[0, 1] * p1 * p2 + M[0, 0] * p2**2) / (2 * sp.expand(M.det()))
V = g * ((sp.Rational(3, 2) + load) * (1 - sp.cos(q1)) + b * (1 - sp.cos(q1 + q2)))
x = (q1, q2, p1, p2)
J = sp.Matrix([[0, 0, 1, 0], [0, 0, 0, 1], [-1, 0, 0, 0], [0, -1, 0, 0]])
R = sp.zeros(4, 4)
G = sp.Matrix([[0, 0], [0, 0], [1, 0], [0, 1]])
H = T + V
params = {load: sp.Rational(1, 2)}
"""

TWO_MASSES = """
import sympy as sp
q1, q2, p1, p2, k = sp.symbols("q1 q2 p1 p2 k")
x = (q1, q2, p1, p2)
J = sp.Matrix([[0, 0, 1, 0], [0, 0, 0, 1], [-1, 0, 0, 0], [0, -1, 0, 0]])
R = sp.zeros(4, 4)
G = sp.Matrix([0, 0, 1, 0])
H = (p1**2 + p2**2) / 2 + k * (q1 - q2)**2 / 2
params = {k: 1}
"""

RANGES = Ranges(
    {"q": (S(-5, 2), S(5, 2))},
    {"m": (S(9, 10), S(11, 10)), "g": (S(19, 20), S(21, 20))},
    ((S(-1, 20), S(1, 20)),),
)


def loaded(folder, text, target):
    path = folder / "plant.py"
    path.write_text(text, encoding="utf-8")
    return problem(load_model(path), target)


@pytest.fixture(scope="module")
def task(tmp_path_factory):
    return loaded(tmp_path_factory.mktemp("everywhere"), WEIGHTED, "0")


@pytest.fixture(scope="module")
def family(task):
    made = solve(task, Options(convex=True, hidden_k=(16,), hidden_h=(16,)))
    return lift(made, RANGES, task.model.parametric)


@pytest.fixture(scope="module")
def claim(family):
    return prove_everywhere(family)


@pytest.fixture(scope="module")
def written(family, claim):
    """What stands in the three files."""
    certificate = certify(family.design, region=False).having(claim)
    return family.design.text, family.text, json.loads(certificate.to_json())


@pytest.fixture
def folder(family, task, tmp_path):
    text = plant_text(family.design, task.model.parametric)
    (tmp_path / "plant.json").write_text(text, encoding="utf-8")
    return tmp_path


def test_it_is_proved_and_checked(claim, written, folder):
    assert claim.holds, claim.statement
    assert claim.data["follows"] == "converges"
    results = checked_family(folder, *written)
    assert all(result.holds for result in results.values()), results


@pytest.mark.slow
def test_any_payload_of_an_arm_is_checked(tmp_path):
    """A floor close to the least curvature, from 0 to 1 kg at once."""
    made, many = arm_with_payload()
    family = lift(made, Ranges(uncertain=many.ranges), many.parametric)
    found = prove_everywhere(family)
    assert found.holds, found.statement
    (tmp_path / "plant.json").write_text(plant_text(made, many.parametric), encoding="utf-8")
    certificate = json.loads(certify(made, region=False).having(found).to_json())
    results = checked_family(tmp_path, made.text, family.text, certificate)
    assert results["everywhere"].holds, results["everywhere"].statement


def test_the_floor_is_below_every_curvature(family, claim):
    """By second derivatives of V at random states of random members."""
    rng = np.random.default_rng(0)
    z, theta = ca.MX.sym("z", 3), ca.MX.sym("theta", len(family.parameters))
    V = family.V_function(z, theta)
    bends = ca.Function("bends", [z, theta], [ca.hessian(V, z)[0]])
    units = family.design.units
    y, F = list(claim.data["active"]), np.array(claim.data["floor"])
    size = np.outer(units.state[y], units.state[y]) / units.energy
    least = []
    for _ in range(300):
        at = np.array([rng.uniform(-20, 20), 0.0, rng.uniform(-20, 20)])
        values = [rng.uniform(*map(float, p.range)) for p in family.parameters]
        A = np.asarray(bends(at, values), float)[np.ix_(y, y)] * size
        least.append(np.linalg.eigvalsh(A - F)[0])
    assert min(least) > 0
    assert np.linalg.eigvalsh(F)[0] > 0


def test_members_rest_where_it_says(family, claim):
    rng = np.random.default_rng(1)
    most = claim.data["error"]["q"]
    for _ in range(20):
        values = {p.name: rng.uniform(*map(float, p.range)) for p in family.parameters}
        member = family.member(values)
        assert abs(member.z_bar[0] - member.z_star[0]) <= most


def settled(family, count, seconds, seed, step=0.04):
    """|q − q̄| at the end and q̇ of random members from random starts, (count,) each.

    The plant is written anew here, with its own mass, weight and disturbance.
    """
    rng = np.random.default_rng(seed)
    values = {p.name: rng.uniform(*map(float, p.range), count) for p in family.parameters}
    r, m, g, d = (values[name] for name in ("q", "m", "g", "d_u"))
    law = family.control_law_function.map(count)
    z = np.stack([rng.uniform(-6, 6, count), rng.uniform(-4, 4, count), rng.uniform(-6, 6, count)])

    def flow(z):
        q, rate, xi = z
        u, xi_dot = law(np.stack([q, rate]), xi[None], r[None])  # p = M₀q̇ with M₀ = 1
        force = np.asarray(u)[0] + d - m * g * np.sin(q)
        return np.stack([rate, force / m, np.asarray(xi_dot)[0]])

    for _ in range(round(seconds / step)):
        a = flow(z)
        b = flow(z + step / 2 * a)
        c = flow(z + step / 2 * b)
        z = z + step / 6 * (a + 2 * b + 2 * c + flow(z + step * c))
    return z[0] - r, z[1], flow(z)


def test_random_members_come_to_rest_within_the_error(family, claim):
    off, rate, left = settled(family, 60, 60, 2)
    assert np.abs(off).max() <= claim.data["error"]["q"] + 1e-3
    assert np.abs(rate).max() < 1e-2
    assert np.abs(left).max() < 1e-2


@pytest.mark.slow
def test_thousands_of_members_come_to_rest_within_the_error(family, claim):
    off, rate, left = settled(family, 2000, 120, 3)
    assert np.abs(off).max() <= claim.data["error"]["q"] + 1e-6
    assert np.abs(rate).max() < 1e-5
    assert np.abs(left).max() < 1e-5


def _steeper(data):
    data["floor"] = [[1.3 * v for v in row] for row in data["floor"]]


def _flatter(data):
    """A floor that holds, but not the error that it leads to."""
    data["floor"] = [[0.5 * v for v in row] for row in data["floor"]]


def _nearer(data):
    data["error"]["q"] /= 2


def _fewer(data):
    """A floor of ξ alone, the coordinate among the momenta."""
    data["active"], data["floor"] = data["active"][1:], [[data["floor"][1][1]]]


def _indefinite(data):
    data["floor"] = [[-1e3, 0.0], [0.0, -1e3]]


def _unseen(data):
    data["error"]["p"] = 1.0


@pytest.mark.parametrize("alter", [_steeper, _flatter, _nearer, _fewer, _indefinite, _unseen])
def test_an_altered_claim_does_not_hold(alter, written, folder):
    design, family, certificate = written
    certificate = json.loads(json.dumps(certificate))
    alter(next(c for c in certificate["claims"] if c["name"] == "everywhere")["data"])
    assert not checked_family(folder, design, family, certificate)["everywhere"].holds


def test_it_is_of_the_family_that_is_named(written, folder):
    design, family, certificate = written
    result = checked_family(folder, design, family + " ", certificate)["everywhere"]
    assert not result.holds
    assert "claimed about" in result.statement


def test_a_soft_design_claims_nothing_of_all_set_points(task):
    """One critical point at one set-point is none at another: V is not convex."""
    soft = solve(task)
    claim = prove_everywhere(lift(soft, RANGES, task.model.parametric))
    assert not claim.holds
    assert "convex" in claim.statement


def test_where_solutions_go_is_not_claimed_without_a_proof(tmp_path):
    """Two masses and a spring, one driven: they come to rest, but this is not derived."""
    task = loaded(tmp_path, TWO_MASSES, "q2=0")
    made = solve(task, Options(convex=True, hidden_k=(8,), hidden_h=(8,)))
    ranges = Ranges(uncertain={"k": (S(1, 2), S(2))})
    family = lift(made, ranges, task.model.parametric)
    claim = prove_everywhere(family)
    assert claim.holds
    assert claim.data["follows"] == "stable"
    assert "converges" not in claim.statement
    certificate = json.loads(certify(made, region=False).having(claim).to_json())
    text = plant_text(made, task.model.parametric)
    (tmp_path / "plant.json").write_text(text, encoding="utf-8")
    assert checked_family(tmp_path, made.text, family.text, certificate)["everywhere"].holds
    certificate["claims"][-1]["data"]["follows"] = "converges"
    assert not checked_family(tmp_path, made.text, family.text, certificate)["everywhere"].holds


@pytest.mark.slow
def test_an_arm_holds_every_target_with_every_load(tmp_path):
    """Designed for the ends of the load's range; for the middle alone V is not convex."""
    task = loaded(tmp_path, ARM, "q1=pi/4,q2=-pi/3")
    uncertain = {"load": (S(0), S(1))}
    turns = {"q1": (-sp.pi, sp.pi), "q2": (-sp.pi, sp.pi)}
    ranges = Ranges(turns, uncertain)
    model = dataclasses.replace(task.model, ranges=Ranges(uncertain=uncertain))
    convex, at = Options(convex=True), (task.loop, task.casimirs, task.verdict, task.x_star)
    method = Method("interconnection", *at[:3])
    members = family_of(model, method, task.x_star, convex)
    designs = [design(*at, convex, family=family) for family in (None, members)]
    held = [prove_everywhere(lift(made, ranges, model.parametric)) for made in designs]
    assert [claim.holds for claim in held] == [False, True]
    assert held[1].data["follows"] == "converges"
