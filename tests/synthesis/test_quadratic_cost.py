"""Designs of least quadratic cost: against matrix equations for the loop as it is built."""

import numpy as np
import pytest
from helpers.problems import CART_AND_CRANE, PENDULUM, problem, solve
from scipy.linalg import solve_continuous_lyapunov

from necc_casadi.certificate.prover.certify import certify
from necc_casadi.designs.error_bound import natural_loss
from necc_casadi.model.cost import QuadraticCost, bryson
from necc_casadi.model.model_file import load_model
from necc_casadi.performance.plant_model import plant_model
from necc_casadi.synthesis.options import Options


def linear_cost(design, cost: QuadraticCost) -> float:
    """tr(P Σ) of the loop opened and closed again, over LQR's, Σ of starts uniform in the box."""
    A, B, C, _ = design.loop_transfer()
    n = design.loop.plant.n
    W = C.T @ cost.R @ C
    W[:n, :n] += cost.Q
    P = solve_continuous_lyapunov((A - B @ C).T, -W)
    spread = np.diag((design.domain.hi - design.domain.lo)[:n] ** 2 / 12)
    model, units = plant_model(design, cost), design.units
    natural = spread / np.outer(units.state[:n], units.state[:n])
    best = np.trace(model.linear.P @ natural) * units.time
    return float(np.trace(P[:n, :n] @ spread) / best)


def of(task, **options):
    return solve(task, Options(least_cost=True, **options))


@pytest.fixture(scope="module")
def upright():
    return problem(load_model(PENDULUM), "pi")


@pytest.fixture(scope="module")
def crane_task(tmp_path_factory):
    path = tmp_path_factory.mktemp("models") / "crane.py"
    path.write_text(CART_AND_CRANE, encoding="utf-8")
    return problem(load_model(path), "q1=pi/3,q2=-0.5")


@pytest.mark.parametrize("name", ["pendulum", "upright", "crane_task"])
def test_the_linearised_loop_costs_little_more_than_lqr(request, name):
    task = request.getfixturevalue(name)
    made, plain = of(task), solve(task)
    cost = bryson(made.sizes, made.loop.plant.n)
    assert 0.999 < linear_cost(made, cost) < 1.03
    assert linear_cost(made, cost) < linear_cost(plain, cost)
    assert natural_loss(made) <= 1e-9
    assert made.starts[-1].mode == "cost"
    certificate = certify(made, region=False)
    assert certificate.certified
    assert certificate.stability == "asymptotic"


def test_the_loop_is_no_faster_than_allowed(upright):
    made = of(upright)
    plant = plant_model(made, bryson(made.sizes, 2))
    natural, size = made.natural, made.natural.sizes.state
    A = natural.lyapunov.linearisation(natural.z_bar) * size / size[:, None]
    allowed = 6 * np.abs(plant.linear.spectrum).max()
    assert np.linalg.norm(A) <= np.sqrt(3) * allowed * 1.02  # the damping is rounded


def test_other_weights_make_another_loop(pendulum):
    """Inputs that cost a hundred times as much are used less."""
    cheap = of(pendulum)
    dear = of(pendulum, input_cost=100 * bryson(cheap.sizes, 2).R)
    cost = QuadraticCost(bryson(dear.sizes, 2).Q, 100 * bryson(dear.sizes, 2).R)
    assert linear_cost(dear, cost) < linear_cost(cheap, cost)
    gain = [np.linalg.norm(made.loop_transfer()[2]) for made in (cheap, dear)]
    assert gain[1] < gain[0]


def test_a_form_without_quadratic_program_is_kept(pendulum):
    options = {"phi": "neural", "hidden_k": (8,), "hidden_h": (6,)}
    plain = solve(pendulum, Options(**options))
    assert of(pendulum, **options).weights.tolist() == plain.weights.tolist()
