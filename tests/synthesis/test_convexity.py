"""Quadratic parts that make V convex: checked with sympy's own Hessian at samples of our own."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import sympy as sp
from helpers.problems import problem, solve

from necc_casadi.designs.error_bound import loss
from necc_casadi.lyapunov.lyapunov import make_terms
from necc_casadi.lyapunov.networks import KAPPA_MIN
from necc_casadi.model.model_file import load_model
from necc_casadi.model.sizes import natural_sizes
from necc_casadi.synthesis.convexity import least_kappa
from necc_casadi.synthesis.options import Options

EXAMPLES = Path(__file__).parents[2] / "examples"
TARGETS = {
    "pendulum": "pi/4",
    "two_link_arm": "q1=pi/4,q2=-pi/3",
    "cart_pole": "x=1,theta=pi,p_x=0,p_theta=0",
}
SAMPLES = 600


def task_of(name: str) -> SimpleNamespace:
    task = problem(load_model(EXAMPLES / f"{name}.py"), TARGETS[name])
    task.x = np.array([float(task.x_star[s]) for s in task.loop.plant.x])
    task.xi = np.zeros(task.loop.controller.nc)
    task.scales = natural_sizes(task.loop, task.casimirs.functions, task.x_star)
    return task


def kappa_of(task, a: float, momenta=()) -> float:
    terms = make_terms(task.loop, task.casimirs)
    return least_kappa(terms, task.scales, task.verdict, task.x, task.xi, a, momenta)


def hessians(task, kappa: float):
    """z ↦ ∇²V of V = H + λᵀc + ½κE(Σ(ξ/size)² + Σ((c − c*)/reach)²), differentiated by sympy."""
    loop, E = task.loop, task.scales.energy
    point = dict(zip(loop.z, [*task.x, *task.xi], strict=True))
    size = dict(zip(loop.z, task.scales.state, strict=True))
    V = loop.plant.H + sum((xi / size[xi]) ** 2 for xi in loop.controller.xi) * kappa * E / 2
    for weight, c in zip(task.verdict.lam, task.casimirs.functions, strict=True):
        reach = max(abs(float(sp.diff(c, s).subs(point))) * size[s] for s in loop.z)
        V += float(weight) * c + kappa * E / 2 * ((c - float(c.subs(point))) / reach) ** 2
    return sp.lambdify([loop.z], sp.hessian(V, loop.z), "numpy", cse=True)


def lowest_at_samples(task, kappa: float, seed: int = 7, resting=()) -> float:
    """Least eigenvalue at random points within twice the natural domain."""
    rng = np.random.default_rng(seed)
    hessian, z_star = hessians(task, kappa), np.concatenate([task.x, task.xi])
    points = z_star + rng.uniform(-4, 4, (SAMPLES, len(z_star))) * task.scales.state
    points[:, list(resting)] = 0.0
    return min(float(np.linalg.eigvalsh(np.array(hessian(z), float))[0]) for z in points)


@pytest.mark.parametrize("name", ["pendulum", "two_link_arm"])
def test_the_stiffness_makes_v_convex_and_a_fraction_of_it_does_not(name):
    task = task_of(name)
    a = 0.25 * task.verdict.a_max
    kappa = kappa_of(task, a)
    assert kappa > 1.5
    z_star = np.concatenate([task.x, task.xi])
    assert lowest_at_samples(task, kappa) > 0
    assert np.linalg.eigvalsh(np.array(hessians(task, kappa)(z_star), float))[0] > a
    assert lowest_at_samples(task, 0.2 * kappa) < 0


def test_momenta_at_rest_take_a_fraction_of_the_stiffness():
    """The kinetic energy of the arm bends V down where it moves fast."""
    task = task_of("two_link_arm")
    a, momenta = 0.25 * task.verdict.a_max, (2, 3)
    kappa = kappa_of(task, a, momenta)
    assert kappa < 0.1 * kappa_of(task, a)
    assert lowest_at_samples(task, kappa, resting=momenta) > 0
    assert lowest_at_samples(task, 0.2 * kappa, resting=momenta) < 0


def test_the_pendulum_needs_what_the_algebra_says():
    """∇²V ≻ 0 for every q iff k > 1 and (k − 1)(h − 1) > 1, so with k = h iff k > 2."""
    task = task_of("pendulum")
    kappa = kappa_of(task, 0.1)
    assert 2 < kappa * task.scales.energy < 3


def test_a_stiffer_target_asks_for_more():
    task = task_of("pendulum")
    soft, stiff = kappa_of(task, 0.1), kappa_of(task, 0.95)
    assert stiff >= soft
    top = np.linalg.eigvalsh(np.array(hessians(task, stiff)(np.array([*task.x, *task.xi])), float))
    assert top[0] > 0.95


@pytest.mark.parametrize("a", [0.05, 0.2])
def test_the_default_bound_is_kept_where_no_stiffness_helps(a):
    """Cart-pole, hanging: H curves downwards along θ, which is invisible, once it is upright."""
    task = task_of("cart_pole")
    assert task.verdict.assignable
    assert lowest_at_samples(task, 1e5) < 0
    assert kappa_of(task, a) == KAPPA_MIN


def test_a_ceiling_below_a_keeps_the_default_bound():
    task = task_of("pendulum")
    assert kappa_of(task, 1.01 * task.verdict.a_max) == KAPPA_MIN


def test_a_convex_design_stays_convex(pendulum):
    """The networks, trained on top of the quadratic parts, do not bend V down again."""
    made = solve(pendulum, Options(convex=True))
    assert loss(made) <= 1e-9
    points = made.z_star + np.random.default_rng(3).uniform(-4, 4, (200, 3))
    lowest = [np.linalg.eigvalsh(np.asarray(made.lyapunov.hessian(z)))[0] for z in points]
    assert min(lowest) > 0
