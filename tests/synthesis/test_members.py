"""What a design asks for all members of a family: bounds, curvature, stiffness, damping, proof."""

from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest
import sympy as sp
from helpers.models import WEIGHTED
from helpers.problems import problem
from hypothesis import given
from hypothesis import strategies as st

from necc_casadi.certificate.prover.family import prove_family
from necc_casadi.designs.family import lift
from necc_casadi.lyapunov.damping import uncoupled
from necc_casadi.model.build_family import family_loop
from necc_casadi.model.model_file import load_model
from necc_casadi.model.ranges import Ranges
from necc_casadi.synthesis.damping import choose_damping
from necc_casadi.synthesis.members import Members
from necc_casadi.synthesis.options import Level, Options
from necc_casadi.synthesis.plan import make_plan, whole_space_stiffness
from necc_casadi.synthesis.synthesis import design

S = sp.Rational

#: A mass that no input sees, held by a spring, with a weight that may turn it over.
UNSEEN = """
import sympy as sp
q1, q2, p1, p2, g = sp.symbols("q1 q2 p1 p2 g")
x = (q1, q2, p1, p2)
J = sp.Matrix([[0, 0, 1, 0], [0, 0, 0, 1], [-1, 0, 0, 0], [0, -1, 0, 0]])
R = sp.diag(0, 0, 0, 1)
G = sp.Matrix([0, 0, 1, 0])
H = (p1**2 + p2**2) / 2 + q1**2 / 8 + q2**2 / 8 + g * (1 - sp.cos(q2))
params = {g: 0}
"""
WEIGHTS = {"m": (S(9, 10), S(11, 10)), "g": (S(19, 20), S(21, 20))}
RANGES = Ranges({"q": (S(-5, 2), S(5, 2))}, WEIGHTS)
HEAVIEST = 1.1 * 1.05
GROWTH = 0.05


@pytest.fixture(scope="module")
def own(tmp_path_factory):
    path = tmp_path_factory.mktemp("members") / "plant.py"
    path.write_text(WEIGHTED, encoding="utf-8")
    return load_model(path)


def family_at(model, target, ranges=RANGES):
    """The task at a target, and its loop for all ranges."""
    task = problem(model, target)
    star = [task.x_star[s] for s in task.loop.plant.x]
    moved = family_loop(task.loop, task.casimirs.functions, star, ranges, model.parametric)
    return SimpleNamespace(**vars(task), moved=moved)


def plan_of(task, options=None, family=None):
    at = (task.loop, task.casimirs, task.verdict, task.x_star)
    return make_plan(*at, options or Options(), family)


def made(task, options, family=None):
    at = (task.loop, task.casimirs, task.verdict, task.x_star)
    return design(*at, options, family=family)


# --- bounds over members -------------------------------------------------------------------------


@given(st.integers(0, 10**6), st.integers(1, 5), st.integers(1, 4))
def test_the_least_bend_is_below_every_members(seed, count, n):
    rng = np.random.default_rng(seed)
    x, size = ca.SX.sym("x", n), 10.0 ** rng.integers(-3, 4, n + 1)
    found = rng.normal(size=(count, n, n))
    bends = (found + found.transpose(0, 2, 1)) / np.outer(size[:n], size[:n])
    energies = [ca.Function("H", [x], [ca.bilin(ca.DM(B), x, x) / 2]) for B in bends]
    least = Members(ca.Function("H", [x], [0]), energies, n).least_bend(np.zeros(n), size)
    units = np.outer(size, size)
    for bend in (np.zeros((n, n)), *bends):
        more = np.zeros((n + 1, n + 1))
        more[:n, :n] = bend
        assert np.linalg.eigvalsh((more - least) * units)[0] >= -1e-12 * (1 + abs(found).max())


def test_what_commutes_is_bounded_by_the_least_of_each_eigenvalue():
    x = ca.SX.sym("x", 2)
    energies = [ca.Function("H", [x], [ca.dot(ca.DM(d), x**2) / 2]) for d in ([1, -2], [-3, 4])]
    least = Members(ca.Function("H", [x], [0]), energies, 2).least_bend(np.zeros(2), np.ones(2))
    np.testing.assert_allclose(least, np.diag([-3.0, -2.0]), atol=1e-12)


@pytest.mark.parametrize("unit", [1.0, 2.0**-60, 2.0**60])
def test_equal_bends_are_one_in_any_unit(unit):
    x = ca.SX.sym("x", 1)
    energies = [ca.Function("H", [x], [unit * b * x**2 / 2]) for b in (1, 2, 1, 2, 3)]
    found = Members(ca.Function("H", [x], [0]), energies, 1).bends(np.zeros(1), 1)
    assert [float(b[0, 0]) / unit for b in found] == [1, 2, 3]


def test_rise_and_slope_are_those_of_the_energies(own):
    """By hand: the weights of a pendulum, seen from the set-point that each member holds."""
    task = family_at(own, "pi/4", Ranges(uncertain={"g": (S(1, 2), S(3, 2))}))
    plan = plan_of(task, family=task.moved)
    star, rng = np.pi / 4, np.random.default_rng(0)
    q_unit, energy = plan.units.state[0], plan.units.energy
    q = rng.uniform(-3, 3, 50)
    offsets = np.zeros((50, 3))
    offsets[:, 0] = q / q_unit
    rise = -(np.cos(star + q) - np.cos(star))  # of 1 − cos q, for each unit of weight more
    turn = (np.sin(star + q) - np.sin(star)) * q
    members, x = plan.members, plan.x
    found = members.least_rise(x, offsets) * energy
    np.testing.assert_allclose(found, -abs(rise) / 2, atol=1e-12)
    found = members.least_slope(x, offsets, offsets) * energy
    np.testing.assert_allclose(found, -abs(turn) / 2, atol=1e-12)


# --- what is asked of V --------------------------------------------------------------------------


def test_the_stiffness_is_that_of_the_heaviest_member(own):
    """The closed form of a pendulum that hangs: its weight scales what springs must overcome."""
    task = family_at(own, "0", Ranges(uncertain=WEIGHTS))
    plan = plan_of(task, family=task.moved)
    kappa = whole_space_stiffness(plan) * plan.sizes.energy / plan.sizes.state[0] ** 2
    q = np.linspace(-9, 9, 20001)
    q = q[q != 0]
    least = np.max(2 * (GROWTH * plan.sizes.energy - HEAVIEST * np.sin(q) / q))
    nominal = whole_space_stiffness(plan_of(task)) * plan.sizes.energy / plan.sizes.state[0] ** 2
    assert nominal < kappa
    assert kappa == pytest.approx(least, rel=0.02)


@pytest.mark.parametrize("target", [0.5, 2.0])
def test_each_member_has_one_critical_point_with_it(own, target):
    """Zeros of w′ for corners of the plant, at set-points along the range."""
    task = family_at(own, f"{target!r}")
    plan = plan_of(task, family=task.moved)
    unit = plan.sizes.energy / plan.sizes.state[0] ** 2
    shared, nominal = (whole_space_stiffness(p) * unit for p in (plan, plan_of(task)))
    q = np.linspace(target - 20, target + 20, 40000)

    def zeros(kappa):
        counts = []
        for weight in (0.9 * 0.95, 1.0, HEAVIEST):
            for r in np.linspace(-2.5, 2.5, 11):
                seen = q - target + r
                slope = weight * np.sin(seen) - np.sin(r) + kappa / 2 * (q - target)
                counts.append(np.count_nonzero(np.diff(np.sign(slope))))
        return counts

    assert set(zeros(shared)) == {1}
    assert max(zeros(nominal / 2)) > 1


def test_every_corner_has_the_curvature_that_is_asked_for(own):
    task = family_at(own, "pi/4")
    options = Options(quadratic=False, hidden_k=(8,), hidden_h=(6,))
    robust, plain = (made(task, options, family) for family in (task.moved, None))
    for found in (robust, plain):
        assert abs(found.lyapunov.gradient(found.z_star)).max() < 1e-9

    def least(design):
        """Over the members, at the target of each: λ_min(∇²V) − a."""
        x, bend = design.z_star, []
        for weight in (0.9 * 0.95, HEAVIEST):
            for r in np.linspace(-2.5, 2.5, 21):
                hessian = design.lyapunov.hessian(x)
                hessian[0, 0] += weight * np.cos(r) - np.cos(x[0])
                bend.append(np.linalg.eigvalsh(hessian - design.a * np.eye(3))[0])
        return min(bend)

    assert least(robust) > -1e-3
    assert least(plain) < -0.1


def test_curvature_out_of_reach_is_asked_of_the_nominal_plant_alone(tmp_path):
    """Of an angle that no Casimir sees a member may lack the curvature that the plant has."""
    path = tmp_path / "plant.py"
    path.write_text(UNSEEN, encoding="utf-8")
    task = family_at(
        load_model(path), "q1=0,q2=0,p1=0,p2=0", Ranges(uncertain={"g": (S(-1), S(1))})
    )
    plan = plan_of(task, family=task.moved)
    assert min(bend[1, 1] for bend in plan.bends) < 0
    assert np.array_equal(plan.asked, np.diag(plan.curvature))


def test_rows_of_a_level_are_those_of_the_worst_member(own):
    task = family_at(own, "pi/4", Ranges(uncertain={"g": (S(1), S(3, 2))}))
    options = Options(shape="level", hidden_k=(8,), hidden_h=(6,), quadratic=False)
    assert isinstance(options.shaping, Level)
    plan, alone = (plan_of(task, options, family) for family in (task.moved, None))
    rng, z = np.random.default_rng(0), plan.z
    weights = plan.form.initial(rng)
    (A, b), (A0, b0) = (p.extra.rows(p.terms, p.form, weights, z) for p in (plan, alone))
    assert np.array_equal(A, A0)
    q = np.concatenate([alone.extra.rays, alone.extra.boundary])[:, 0]
    M, star = len(alone.extra.rays), np.pi / 4
    seen = star + q * plan.units.state[0]
    rise = -(np.cos(seen) - np.cos(star)) / 2
    np.testing.assert_allclose(
        (b - b0)[M:] * plan.extra.energy * plan.units.energy, np.minimum(rise, 0)[M:], atol=1e-9
    )
    assert (b <= b0 + 1e-12).all()
    assert (b < b0 - 1e-3).any()


def test_damping_is_chosen_for_the_slowest_member(own):
    task = family_at(own, "0", Ranges(uncertain={"g": (S(1, 2), S(3))}))
    plain = made(task, Options(hidden_k=(8,), hidden_h=(6,)))
    bends = [np.diag([more, 0.0, 0.0]) for more in (-0.5, 2.0)]
    V, loop, z = plain.lyapunov, plain.loop, plain.z_star
    M = np.array(loop.M, float)
    ports = np.array(loop.ports, float)

    def slowest(D, Dc):
        A = M - ports @ uncoupled(D, Dc) @ ports.T
        every = (np.zeros((3, 3)), *bends)
        return min(-np.linalg.eigvals(A @ (V.hessian(z) + b)).real.max() for b in every)

    shared, alone = choose_damping(V, loop, z, bends=bends), choose_damping(V, loop, z)
    assert slowest(*shared) > slowest(*alone)


# --- what it is for ------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_whole_family_is_proved_of_which_the_nominal_design_holds_a_part(own):
    task = family_at(own, "0")
    options = Options(whole=True, least_cost=True)
    robust, plain = (made(task, options, family) for family in (task.moved, None))
    claims = [prove_family(lift(d, RANGES, own.parametric)) for d in (robust, plain)]
    assert [bool(claim.data["left"]) for claim in claims] == [False, True]
