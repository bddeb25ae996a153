"""Models and trained designs that many tests share; each is made once per session."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from necc_casadi.casimirs.find import find_casimirs
from necc_casadi.designs.design import Design
from necc_casadi.model.model_file import load_model
from necc_casadi.model.target import parse_target
from necc_casadi.synthesis.options import Options, paper_options
from necc_casadi.synthesis.synthesis import design
from necc_casadi.verdict.judge import judge

PENDULUM = Path(__file__).parents[1] / "examples" / "pendulum.py"

#: A plant with two inputs, an inertia that depends on the position, friction and two Casimirs.
CART_AND_CRANE = """
import sympy as sp
q1, q2, p1, p2, k = sp.symbols("q1 q2 p1 p2 k")
x = (q1, q2, p1, p2)
J = sp.Matrix([[0, 0, 1, 0], [0, 0, 0, 1], [-1, 0, 0, 0], [0, -1, 0, 0]])
R = sp.diag(0, 0, 0.1, sp.exp(-q1**2) / 5)
G = sp.Matrix([[0, 0], [0, 0], [1, 0], [0, 1]])
H = p1**2 / (2 * (2 + sp.cos(q2))) + p2**2 / 2 + k * (1 - sp.cos(q1)) + q2**2 / 4
params = {k: 0.5}
name = "Cart and crane"
"""


def problem(model, target):
    x_star = parse_target(model.loop.plant, target)
    casimirs = find_casimirs(model.loop, model.casimirs, x_star)
    verdict = judge(model.loop, casimirs, x_star)
    return SimpleNamespace(
        model=model, loop=model.loop, casimirs=casimirs, verdict=verdict, x_star=x_star
    )


def solve(task, options: Options | None = None) -> Design:
    return design(task.loop, task.casimirs, task.verdict, task.x_star, options)


@pytest.fixture(scope="session")
def pendulum():
    """The paper's pendulum at q* = π/4, judged."""
    return problem(load_model(PENDULUM), "pi/4")


@pytest.fixture(scope="session")
def crane(tmp_path_factory):
    """Two inputs, two Casimirs."""
    path = tmp_path_factory.mktemp("models") / "crane.py"
    path.write_text(CART_AND_CRANE, encoding="utf-8")
    return problem(load_model(path), "q1=pi/3,q2=-0.5")


@pytest.fixture(scope="session")
def default_design(pendulum) -> Design:
    return solve(pendulum)


@pytest.fixture(scope="session")
def paper_design(pendulum) -> Design:
    return solve(pendulum, paper_options(1))


@pytest.fixture(scope="session")
def designs(pendulum, crane, default_design, paper_design) -> dict[str, Design]:
    """One design per form: published, default, β-sum, joint, neural Φ, other activations."""
    small = {"hidden_k": (8,), "hidden_h": (6,)}
    return {
        "paper": paper_design,
        "default": default_design,
        "neural": solve(pendulum, Options(phi="neural", **small)),
        "joint": solve(crane, Options(activation="squareplus", **small)),
        "beta-sum": solve(
            crane, Options(casimir_form="sum", activation="sin", hidden_k=(8, 5), hidden_h=(6, 4))
        ),
        "beta-sum neural": solve(
            crane, Options(casimir_form="sum", phi="neural", quadratic=False, **small)
        ),
    }


FORMS = ("paper", "default", "neural", "joint", "beta-sum", "beta-sum neural")


@pytest.fixture(params=FORMS)
def any_design(request, designs) -> Design:
    return designs[request.param]


@pytest.fixture
def points():
    """Random states around a design's target, (count, n + nc)."""

    def draw(made: Design, count: int = 5, spread: float = 1.0, seed: int = 0) -> np.ndarray:
        rng = np.random.default_rng(seed)
        return made.z_star + rng.uniform(-spread, spread, (count, made.loop.n))

    return draw
