"""Designs that are improved on responses: slopes, what is kept exactly, and what is gained."""

from copy import copy
from dataclasses import replace

import numpy as np
import pytest
from helpers.problems import solve

from necc_casadi.certificate.prover.certify import certify
from necc_casadi.choice.choose import choose
from necc_casadi.designs.error_bound import natural_loss
from necc_casadi.errors import OptionError
from necc_casadi.model.cost import bryson
from necc_casadi.performance.saturated import saturated
from necc_casadi.synthesis import polish
from necc_casadi.synthesis.options import Options
from necc_casadi.synthesis.plan import make_plan
from necc_casadi.synthesis.polish import _Search
from necc_casadi.synthesis.responsive import LeastCost
from necc_casadi.synthesis.training import train

SMALL = {"hidden_k": (8,), "hidden_h": (6,)}


@pytest.fixture(scope="module")
def search(pendulum):
    """From a trained V of small networks."""
    task = pendulum
    options = Options(polish=True, **SMALL)
    plan = make_plan(task.loop, task.casimirs, task.verdict, task.x_star, options)
    solution = train(
        plan.terms,
        plan.form,
        plan.x,
        a=plan.curvature,
        scales=plan.scales,
        anchor=plan.anchor,
    )
    program = LeastCost(plan, options, solution, np.eye(2 * plan.terms.m))
    return _Search(program, program.begin(None))


@pytest.fixture(scope="module")
def polished(pendulum):
    return solve(pendulum, Options(whole=True, least_cost=True, polish=True))


def test_the_slopes_of_the_costs_are_those_of_differences(search):
    rng = np.random.default_rng(0)
    theta = search.theta + 0.01 * rng.normal(size=search.theta.size)
    weights = rng.uniform(0.5, 1.0, len(search.best))
    sums = search.rollouts.sums(theta, weights)
    np.testing.assert_allclose(sums.costs, search.rollouts.costs(theta), rtol=1e-12)
    for _ in range(5):
        way = rng.normal(size=theta.size)
        ends = [weights @ search.rollouts.costs(theta + h * way) for h in (1e-5, -1e-5)]
        assert (ends[0] - ends[1]) / 2e-5 == pytest.approx(sums.gradient @ way, rel=1e-5)


def test_inputs_are_clipped_in_the_responses(search, pendulum):
    """Where the law asks for more, the plant gets the limit."""
    narrow = copy(search.rollouts)
    narrow.plant = replace(narrow.plant, u_low=np.array([-0.8]), u_high=np.array([0.8]))
    narrow._one_plain, narrow._one = narrow._stages()
    narrow._maps()
    z = np.tile(search.z_star, (len(narrow.starts), 1)) + 3.0
    u = np.asarray(narrow.plain(z.T, np.repeat(search.theta[:, None], len(z), axis=1)))[-1]
    wide = np.asarray(search.rollouts.plain(z.T, np.repeat(search.theta[:, None], len(z), axis=1)))
    assert np.abs(wide[-1]).max() > 0.8
    np.testing.assert_allclose(u, np.clip(wide[-1], -0.8, 0.8))


def test_steps_leave_the_gradient_at_the_target_alone(search):
    now = search.at(search.theta)
    found, _ = search.step(now, 1e-2)
    assert found is not None
    assert found.value < now.value
    weights = search.moving.weights_at(found.theta)
    moved = np.abs(weights - search.moving.weights_at(search.theta)).max()
    g, _ = search.program.lifting.at(search.program.lifting.jets_at(weights, search.moving.xi_star))
    assert moved > 1e-3
    assert np.abs(g).max() < 1e-12


def test_no_step_is_taken_to_too_little_curvature(search):
    """Against the slope of the least eigenvalue of ∇²V(z*) − aI, as far as it takes."""
    gap = np.asarray(search.gap(search.theta), float)
    rows = np.asarray(search.slopes.call([search.theta])[1], float)
    _, vectors = np.linalg.eigh(gap)
    way = np.outer(vectors[:, 0], vectors[:, 0]).ravel() @ rows
    way[search.moving.size - search.moving.eta.numel() :] = 0.0
    far = search.theta - 3.0 * np.linalg.eigvalsh(gap)[0] * way / (way @ way)
    assert np.linalg.eigvalsh(np.asarray(search.gap(far), float))[0] < 0
    assert search.at(far).value == np.inf


def test_networks_stay_where_responses_are_long(search, monkeypatch):
    """More points than networks may move for: quadratic parts and damping alone, still cheaper."""
    monkeypatch.setattr(polish, "_MOST_POINTS", 1)
    begin = search.program.begin(None)
    assert _Search(search.program, begin).is_long
    found = polish.polished(search.program, None)
    assert found is not None
    assert found.after < found.before
    first = search.moving.weights_at(search.moving.first(begin.eta))
    np.testing.assert_allclose(
        found.weights[search.moving.affine], first[search.moving.affine], rtol=1e-12
    )
    assert not np.allclose(found.weights[search.moving.kappa], first[search.moving.kappa])


@pytest.mark.slow
def test_the_worst_start_costs_clearly_less(pendulum, polished):
    before = solve(pendulum, Options(whole=True, least_cost=True))
    cost = bryson(before.sizes, 2)
    first, then = saturated(before, cost), saturated(polished, cost)
    assert polished.starts[-1].mode == "polished"
    assert then.arrived.all()
    ratio = then.cost / first.cost
    assert np.exp(np.log(ratio).mean()) < 0.99
    assert ratio.min() < 0.75  # the start that was worst
    assert ratio.max() < 1.1


@pytest.mark.slow
def test_everything_is_certified_as_usual(polished):
    assert natural_loss(polished) <= 1e-9
    certificate = certify(polished)
    assert certificate.certified
    assert certificate.stability == "asymptotic"
    assert certificate.is_global


def test_the_polished_design_is_one_more_candidate(pendulum):
    options = Options(polish=True, **SMALL)
    choice = choose(pendulum.loop, pendulum.casimirs, pendulum.verdict, pendulum.x_star, options)
    assert choice.kept.name == "polished"
    assert choice.others[-1].name == "whole space"
    assert choice.kept.whole
    assert "instead of least cost and default" in choice.reason
    assert "whole space, because it costs" in choice.reason


def test_what_is_given_stays(pendulum):
    made = solve(pendulum, Options(polish=True, D=np.array([[2.0]]), Dc=np.array([[3.0]]), **SMALL))
    assert made.starts[-1].mode == "polished"
    np.testing.assert_allclose(made.damping, np.diag([2.0, 3.0]), rtol=1e-12)


@pytest.mark.parametrize(
    "clash", [{"rate": 1.0}, {"phi": "neural"}, {"quadratic": False}, {"learn_casimir": True}]
)
def test_what_it_does_not_go_with_is_refused(pendulum, clash):
    with pytest.raises(OptionError, match="exclude each other"):
        solve(pendulum, Options(polish=True, **clash))
