"""Models and trained designs that many tests share; each is made once per session."""

import dataclasses
import gc
import os

import numpy as np
import pytest
from helpers.constructed import full_damping
from helpers.problems import CART_AND_CRANE, PENDULUM, problem, solve

from necc_casadi.designs.design import Design
from necc_casadi.model.model_file import load_model
from necc_casadi.synthesis.options import Options, paper_options

# There is a worker for each core, and some tests start commands of their own: further threads for
# small matrices only wait for each other. Read by workers and commands as they start.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


def pytest_collection_finish():
    """What was imported and collected lives to the end: no need to look through it again."""
    gc.collect()
    gc.freeze()


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
    """One design per form: published, default, β-sum, joint, neural Φ, activations, damping."""
    small = {"hidden_k": (8,), "hidden_h": (6,)}
    joint = solve(crane, Options(activation="squareplus", **small))
    return {
        "paper": paper_design,
        "default": default_design,
        "neural": solve(pendulum, Options(phi="neural", **small)),
        "joint": joint,
        "coupled": dataclasses.replace(joint, damping=full_damping(joint.damping)),
        "beta-sum": solve(
            crane, Options(casimir_form="sum", activation="sin", hidden_k=(8, 5), hidden_h=(6, 4))
        ),
        "beta-sum neural": solve(
            crane, Options(casimir_form="sum", phi="neural", quadratic=False, **small)
        ),
    }


FORMS = ("paper", "default", "neural", "joint", "coupled", "beta-sum", "beta-sum neural")


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
