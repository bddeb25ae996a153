"""Least cost by descent: slopes against differences, what moves, and what ξ(0) is worth."""

from pathlib import Path

import numpy as np
import pytest
from helpers.problems import problem, solve
from scipy.linalg import solve_continuous_lyapunov

from necc_casadi.model.cost import bryson
from necc_casadi.model.model_file import load_model
from necc_casadi.performance.initial_xi import start_gain, with_start
from necc_casadi.performance.margins import margins
from necc_casadi.performance.measure import measure
from necc_casadi.synthesis.descent import _Objective
from necc_casadi.synthesis.options import Options
from necc_casadi.synthesis.plan import make_plan
from necc_casadi.synthesis.responsive import LeastCost
from necc_casadi.synthesis.rollouts import Moving
from necc_casadi.synthesis.training import train

EXAMPLES = Path(__file__).parents[2] / "examples"
SMALL = {"hidden_k": (8,), "hidden_h": (6,)}


@pytest.fixture(scope="module")
def tora():
    return problem(load_model(EXAMPLES / "tora.py"), "q=0,theta=0,p_q=0,p_theta=0")


@pytest.fixture(scope="module")
def cart():
    return problem(load_model(EXAMPLES / "cart_pole.py"), "x=1,theta=pi,p_x=0,p_theta=0")


def program_of(task, **options):
    asked = Options(least_cost=True, **SMALL, **options)
    plan = make_plan(task.loop, task.casimirs, task.verdict, task.x_star, asked)
    solution = train(
        plan.terms,
        plan.form,
        plan.x,
        a=plan.curvature,
        scales=plan.scales,
        anchor=plan.anchor,
        extra=plan.extra,
    )
    return LeastCost(plan, asked, solution, np.diag([1.0, 2.0]))


@pytest.fixture(scope="module", params=[0, 2])
def objective(tora, request):
    """Of the nominal loop, and with two members of a family beside it."""
    rng = np.random.default_rng(5)
    roots = rng.normal(0, 0.1, (request.param, tora.loop.n, tora.loop.n))
    bends = [root @ root.T for root in roots]
    program = program_of(tora)
    solution, plan = program.solution, program.plan
    moving = Moving(
        program.lifting,
        plan.anchor.kappa_min,
        solution.weights,
        solution.xi_star,
        program.damping,
        networks=False,
    )
    aim = program._aim(0.0, 1.0, 0.0)
    asked = np.diag(plan.curvature)
    return _Objective(program.lifting, aim, asked, moving, solution.weights, True, bends)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_slopes_are_those_of_differences(objective, seed):
    """Where the margin counts and where it does not, inside the bounds of η and outside."""
    rng = np.random.default_rng(seed)
    theta = objective.first + rng.normal(0, 0.3, objective.first.size)
    theta[-1] = [0.1, 3.2, -3.2][seed]
    found = objective.at(theta)
    assert found is not None
    steps = 1e-6 * np.eye(theta.size)
    ahead, behind = ([objective.at(theta + s * e).value for e in steps] for s in (1, -1))
    differences = (np.array(ahead) - behind) / 2e-6
    np.testing.assert_allclose(objective.slope(found), differences, rtol=1e-4, atol=1e-6)


def test_the_damping_alone_leaves_v_as_it_is(cart):
    plain = solve(cart, Options(**SMALL))
    made = solve(cart, Options(least_cost=True, damping_alone=True, **SMALL))
    assert np.array_equal(made.weights, plain.weights)
    assert not np.array_equal(made.damping, plain.damping)
    linear = [measure(d, optimum=False).cost_to_lqr for d in (made, plain)]
    assert linear[0] < linear[1]


def test_the_least_cost_keeps_a_disk_margin(tora):
    A, B, C, _ = solve(tora, Options(least_cost=True, **SMALL)).loop_transfer()
    assert margins(A, B, C).disk > 0.8


def test_the_best_gain_is_the_least_of_the_quadratic_form():
    rng = np.random.default_rng(0)
    root = rng.normal(size=(6, 6))
    P, n = root @ root.T, 4
    T = start_gain(P, n)
    for x in rng.normal(size=(5, n)):
        least = np.concatenate([x, T @ x])
        slope = (P @ least)[n:]
        np.testing.assert_allclose(slope, 0, atol=1e-10)


def test_a_gain_leaves_directions_alone_that_cost_nothing():
    assert not start_gain(np.diag([1.0, 1.0, 0.0]), 2).any()


def test_xi_along_with_x_makes_the_cart_and_pole_cost_little_more_than_lqr(cart):
    """More than any ξ(0) = ξ* can: u sees y and c alone."""
    made = solve(cart, Options(least_cost=True, **SMALL))
    assert made.initial_xi == "linear"
    cost = bryson(made.sizes, 4)
    at_target = with_start(made, cost, "target")
    A, B, C, _ = made.loop_transfer()
    W = C.T @ cost.R @ C
    W[:4, :4] += cost.Q
    P = solve_continuous_lyapunov((A - B @ C).T, -W)
    away = np.diag((made.domain.hi - made.domain.lo)[:4])

    def paid(design):
        z = np.array([np.concatenate([x, design.xi_at_start(design.z_star[:4] + x)]) for x in away])
        z[:, 4:] -= design.xi_star
        return float(np.einsum("si,ij,sj->", z, P, z))

    assert paid(made) < 0.85 * paid(at_target)
    assert measure(made, optimum=False).cost_to_lqr < 1.1
