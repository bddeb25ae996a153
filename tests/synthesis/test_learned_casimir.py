"""The non-parameterised mode: a network C(z) that is a Casimir approximately, and nothing proved.

eq. NonParameterizedCostMinimization. The residual is computed here again from the stored weights
with plain numpy and finite differences, on points of our own.
"""

import json
from pathlib import Path

import numpy as np
import pytest
import sympy as sp
from helpers import reference
from helpers.commands import design
from helpers.models import BASE
from helpers.problems import PENDULUM

from necc_casadi.certificate.prover.certify import certify
from necc_casadi.designs.design import Design
from necc_casadi.designs.error_bound import loss

#: Together longer than the quick suite can afford; CI runs them.
pytestmark = pytest.mark.slow

#: ∇C ∝ (exp(−sin(q)/4), 0, −1): the Casimir exists, and has no closed form.
WARPED = BASE + "\nJ = sp.exp(sp.sin(q) / 4) * J\n"
POINTS = 400


def learn(model: Path, target: str, out: Path, *options: str) -> tuple[int, str, str]:
    return design(
        model, "--target", target, "--learn-casimir", "--no-plots", "--out", out, *options
    )


@pytest.fixture(scope="module")
def pendulum_run(tmp_path_factory):
    """The command on the pendulum: (exit code, JSON, design that was written)."""
    out = tmp_path_factory.mktemp("learned") / "pendulum"
    code, text, _ = learn(PENDULUM, "pi/4", out, "--json")
    return code, json.loads(text), Design.load(out)


@pytest.fixture(scope="module")
def warped_run(tmp_path_factory):
    """The command where the closed form is missing: (exit code, summary, design)."""
    folder = tmp_path_factory.mktemp("warped")
    (folder / "warped.py").write_text(WARPED)
    code, text, _ = learn(folder / "warped.py", "q=pi/4", folder / "out", "--hidden-h", "8")
    return code, " ".join(text.split()), Design.load(folder / "out")


@pytest.fixture(params=["pendulum_run", "warped_run"])
def learned(request) -> Design:
    return request.getfixturevalue(request.param)[2]


def residuals(made: Design, seed: int) -> np.ndarray:
    """‖∇Cᵀ(Jcl − Rcl)‖/(‖∇C‖‖Jcl − Rcl‖) at fresh points, C by its documented formula."""
    weights = made.form.split(made.weights)[1]
    M = sp.lambdify([made.loop.z], made.loop.M, "numpy")
    rng = np.random.default_rng(seed)
    shares = []
    for z in made.z_star + rng.uniform(-2, 2, (POINTS, made.loop.n)) * made.sizes.state:
        slope = reference.jacobian(lambda s: reference.network(made.form.k, weights, s), z)[0]
        structure = np.asarray(M(z), float)
        size = np.linalg.norm(slope) * np.linalg.norm(structure, 2)
        shares.append(np.linalg.norm(structure.T @ slope) / size)
    return np.array(shares)


def test_the_local_conditions_hold(learned):
    """ε = 0 by sixth-order differences of V in plain numpy, not only by our own derivatives."""
    assert loss(learned) <= 1e-9
    V = reference.lyapunov(learned)
    gradient = reference.jacobian(V, learned.z_star)[0]
    lowest = np.linalg.eigvalsh(reference.hessian(V, learned.z_star))[0]
    assert np.linalg.norm(gradient) <= 1e-8
    assert lowest >= learned.a - 1e-5


def test_the_residual_is_small_on_points_that_were_not_trained_on(learned):
    shares = residuals(learned, seed=20)
    assert shares.mean() < 0.05
    assert shares.mean() > 1e-6  # a network: small, never zero
    assert learned.learned.points >= 1000
    assert learned.learned.mean == pytest.approx(shares.mean(), rel=0.3)
    assert learned.learned.worst >= np.quantile(shares, 0.9)


def test_nothing_is_certified(learned):
    certificate = certify(learned)
    claims = {claim.name: claim.holds for claim in certificate.claims}
    for name in ("casimir", "decrease", "attraction", "region"):
        assert claims[name] is False, name
    assert certificate.stability is None
    assert not certificate.certified
    assert certificate.level is None


def test_the_linearised_loop_is_not_the_gradient_form(learned):
    """Why attraction may not be claimed: (M/Φ₁ − 𝒢𝒟𝒢ᵀ)∇V is another field than the loop's."""
    V, loop, away = learned.lyapunov, learned.loop, learned.z_star.copy()
    away += (0.7, -0.6, 0.5)
    ports = np.array(loop.ports.tolist(), float)
    damping = learned.damping
    structure = np.asarray(V.terms.M(away), float) - ports @ damping @ ports.T
    gradient_form = structure @ np.asarray(V.gradient(away), float).ravel()
    built = np.asarray(V.vector_field(away), float).ravel()
    assert np.linalg.norm(built - gradient_form) > 1e-6


def test_the_command_falls_short_and_says_why(pendulum_run):
    code, data, made = pendulum_run
    assert (code, data["status"]) == (4, "fell_short")
    assert data["design"]["stability"] is None
    assert data["design"]["casimir_residual"]["mean"] == pytest.approx(made.learned.mean)
    assert data["design"]["casimir_residual"]["worst"] == pytest.approx(made.learned.worst)
    assert {"design.json", "certificate.json"} <= set(data["files"])


def test_an_undecided_verdict_may_be_learned(warped_run, tmp_path):
    code, text, _ = warped_run
    assert code == 4
    assert "fell short" in text
    assert "the Casimir is a network and holds only approximately" in text
    assert "nothing is certified" in text
    (tmp_path / "warped.py").write_text(WARPED)
    code, text, _ = design(
        tmp_path / "warped.py", "--target", "q=pi/4", "--json", "--no-plots",
        "--method=interconnection", "--out", tmp_path / "plain",
    )  # fmt: skip
    data = json.loads(text)
    assert (code, data["status"], data["verdict"]["reason"]) == (4, "undecided", "undecided")
    assert data["verdict"]["casimir_count"] < data["verdict"]["casimir_count_generic"]
    assert data["design"] is None
    assert not (tmp_path / "plain").exists()


def test_a_refused_target_is_not_learned(tmp_path):
    path = tmp_path / "refused.py"
    path.write_text(BASE + "\nR = sp.diag(sp.Rational(1, 2), 0)\nH = (q**2 + p**2) / 2\n")
    code, text, _ = learn(path, "q=1,p=1/2", tmp_path / "out", "--json")
    data = json.loads(text)
    assert (code, data["status"]) == (3, "refused")
    assert data["design"] is None
    assert not (tmp_path / "out").exists()


def test_a_casimir_is_learned_for_the_published_loop_alone(tmp_path):
    code, _, said = learn(PENDULUM, "pi/4", tmp_path / "out", "--method=shaping")
    assert code == 2
    assert "--learn-casimir is about the published loop" in said
    assert not (tmp_path / "out").exists()
