"""eq. Loss: lifted jets, hard and soft form, known minima; nothing is taken from IPOPT's word."""

import numpy as np
import pytest
from helpers import reference
from helpers.lifted import build
from hypothesis import given, settings
from hypothesis import strategies as st

from necc_casadi.designs.outcome import STATUS, Start
from necc_casadi.lyapunov.lyapunov import make_terms
from necc_casadi.lyapunov.networks import MonotonePhi, Network
from necc_casadi.lyapunov.parameterization import Form
from necc_casadi.model.sizes import Sizes
from necc_casadi.synthesis.lifting import Lifting, _jet_function
from necc_casadi.synthesis.training import SOLVED, train

PLAIN = Sizes.ones(3, 1, 1)
PAPER = Form(Network(1, (32,)), Network(1, (64,)))
QUADRATIC = Form(Network(1, (8,), quadratic=True), Network(1, (8,), quadratic=True))
Q = np.pi / 4


@pytest.fixture(scope="module")
def terms(pendulum):
    return make_terms(pendulum.loop, pendulum.casimirs)


@pytest.fixture(scope="module")
def crane_terms(crane):
    return make_terms(crane.loop, crane.casimirs)


def epsilon(made, a) -> float:
    """ε of eq. Loss from numpy and finite differences alone."""
    V = reference.lyapunov(made)
    gradient = reference.jacobian(V, made.z_star).ravel()
    lowest = np.linalg.eigvalsh(reference.hessian(V, made.z_star))[0]
    return float(np.linalg.norm(gradient) + max(0.0, a - lowest))


@given(
    inputs=st.integers(1, 3),
    hidden=st.lists(st.integers(1, 5), max_size=2).map(tuple),
    activation=st.sampled_from(["tanh", "sin", "squareplus"]),
    quadratic=st.booleans(),
    seed=st.integers(0, 2**32 - 1),
)
@settings(max_examples=25, deadline=None)
def test_jets_are_value_gradient_and_upper_hessian(inputs, hidden, activation, quadratic, seed):
    net = Network(inputs, hidden, activation, quadratic)
    rng = np.random.default_rng(seed)
    w, v = net.initial(rng), rng.normal(size=inputs)
    jet = np.asarray(_jet_function(net)(w, v)).ravel()

    def f(s):
        return reference.network(net, w, s)

    assert jet[0] == pytest.approx(f(v), rel=1e-12, abs=1e-12)
    np.testing.assert_allclose(jet[1 : 1 + inputs], reference.jacobian(f, v).ravel(), atol=1e-9)
    upper = reference.hessian(f, v)[np.triu_indices(inputs)]
    np.testing.assert_allclose(jet[1 + inputs :], upper, atol=1e-6)


@pytest.mark.parametrize("form", [
    Form(Network(2, (5,)), Network(2, (5,), quadratic=True)),
    Form(Network(2, (4,)), Network(1, (4,)), betas=(Network(1, (3,)), Network(1, (3,)))),
    Form(Network(2, (4,)), Network(1, (4,)), betas=(Network(1, (3,)),) * 2, phi=MonotonePhi(3)),
])  # fmt: skip
def test_lifted_derivatives_are_those_of_V(crane, crane_terms, form):
    """g and N from the jets equal ∇V and ∇²V of the networks themselves, for random weights."""
    rng = np.random.default_rng(4)
    xi = rng.normal(size=2)
    x = np.array([float(crane.x_star[s]) for s in crane.loop.plant.x])
    lifting = Lifting(crane_terms, form, x, Sizes.ones(6, 1, 1), xi)
    weights = form.initial(rng)
    g, N = lifting.at(lifting.jets_at(weights, xi))
    made = build(crane, form, weights, xi)
    np.testing.assert_allclose(
        np.asarray(g).ravel(), np.asarray(made.lyapunov.gradient(made.z_star)).ravel(), atol=1e-12
    )
    np.testing.assert_allclose(
        np.asarray(N), np.asarray(made.lyapunov.hessian(made.z_star)), atol=1e-11
    )
    assert lifting.loss(weights, xi, 0.5) == pytest.approx(epsilon(made, 0.5), abs=1e-5)


@pytest.mark.parametrize("seed", range(20))
def test_hard_form_assigns_the_target_for_every_seed(pendulum, terms, seed):
    """The paper's one-layer networks: ∇V(z*) = 0 and ∇²V(z*) ⪰ aI; K'(s*) = Hc'(ξ*) = −sin q*."""
    solution = train(terms, PAPER, np.array([Q, 0.0]), a=0.5, scales=PLAIN, seed=seed)
    assert solution.loss <= SOLVED
    made = build(pendulum, PAPER, solution.weights, solution.xi_star)
    hessian = np.asarray(made.lyapunov.hessian(made.z_star))
    assert np.linalg.norm(np.asarray(made.lyapunov.gradient(made.z_star))) <= 1e-9
    assert np.linalg.eigvalsh(hessian)[0] >= 0.5 - 1e-9
    assert np.linalg.norm(made.z_bar - made.z_star) <= 1e-8
    theta_h, theta_k = PAPER.split(solution.weights)
    xi = float(solution.xi_star[0])
    slopes = [
        reference.jacobian(lambda v: reference.network(PAPER.k, theta_k, v), np.array([Q - xi])),
        reference.jacobian(lambda v: reference.network(PAPER.hc, theta_h, v), np.array([xi])),
    ]
    np.testing.assert_allclose(np.ravel(slopes), -np.sin(Q), atol=1e-8)


@pytest.mark.parametrize("seed", range(20))
def test_two_layers_of_the_published_code(terms, seed):
    form = Form(Network(1, (32, 32)), Network(1, (64, 64)))
    assert form.size == 5506
    solution = train(terms, form, np.array([Q, 0.0]), a=0.5, scales=PLAIN, seed=seed)
    assert solution.loss <= 1e-9


@pytest.mark.parametrize("seed", range(20))
def test_default_form_for_every_seed(terms, seed):
    form = Form(Network(1, (32,), quadratic=True), Network(1, (64,), quadratic=True))
    solution = train(terms, form, np.array([Q, 0.0]), a=0.427, scales=PLAIN, seed=seed)
    assert solution.loss <= 1e-9
    for network, part in zip(form.networks, form.split(solution.weights), strict=True):
        assert np.all(network.quadratic_part(part)[0] > 0)


@pytest.mark.parametrize(("a", "minimum"), [(1.5, 0.5), (1.1, 0.1), (3.0, 2.0)])
def test_soft_form_reaches_the_known_minimum(pendulum, terms, a, minimum):
    """Row p of ∇²V is fixed at 1, so λ_min ≤ 1 and ε ≥ a − 1; equality is reachable."""
    solution = train(terms, PAPER, np.array([Q, 0.0]), a=a, scales=PLAIN, seed=0)
    assert {start.mode for start in solution.starts} == {"soft"}
    assert solution.loss == pytest.approx(minimum, abs=1e-6)
    made = build(pendulum, PAPER, solution.weights, solution.xi_star, a)
    assert epsilon(made, a) == pytest.approx(minimum, abs=1e-5)


@pytest.mark.parametrize("a", [0.999, 0.5, 1e-3])
def test_just_within_reach_is_still_exact(terms, a):
    solution = train(terms, PAPER, np.array([Q, 0.0]), a=a, scales=PLAIN, seed=0)
    assert solution.loss <= SOLVED
    assert solution.starts[-1].mode == "hard"


@pytest.mark.parametrize("p", [0.3, -2.0])
def test_off_the_equilibrium_set_the_gradient_stays(terms, p):
    """∂V/∂p = p whatever the weights: ε ≥ |p|, and the soft form reaches it."""
    solution = train(terms, PAPER, np.array([Q, p]), a=0.5, scales=PLAIN, seed=0)
    assert solution.loss == pytest.approx(abs(p), abs=1e-6)


@given(q=st.floats(-3.1, 3.1), seed=st.integers(0, 1000))
@settings(max_examples=15, deadline=None)
def test_every_angle_is_reached(terms, q, seed):
    solution = train(terms, QUADRATIC, np.array([q, 0.0]), a=0.4, scales=PLAIN, seed=seed)
    assert solution.loss <= SOLVED


def test_every_start_is_reported_and_the_best_is_kept(terms):
    seen: list[Start] = []
    solution = train(
        terms, PAPER, np.array([Q, 0.0]), a=1.5, scales=PLAIN, seed=3, starts=3, report=seen.append
    )
    assert tuple(seen) == solution.starts
    assert [start.seed for start in seen] == [3, 4, 5]
    assert solution.loss == min(start.loss for start in seen)
    assert solution.seconds == pytest.approx(sum(start.seconds for start in seen))


def test_training_is_reproducible(terms):
    runs = [train(terms, PAPER, np.array([Q, 0.0]), a=0.5, scales=PLAIN, seed=7) for _ in range(2)]
    assert np.array_equal(runs[0].weights, runs[1].weights)
    assert np.array_equal(runs[0].xi_star, runs[1].xi_star)


def test_statuses_say_what_to_try_next():
    for name, status in STATUS.items():
        assert name.isidentifier()
        assert status.meaning
        assert status.usable or status.remedy
    unknown = Start(0, "hard", "A_New_Status", 1, 0.0, 1.0)
    assert not unknown.explained.usable
    assert unknown.explained.remedy
