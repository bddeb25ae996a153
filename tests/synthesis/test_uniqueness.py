"""The least stiffness for one critical point: against closed forms, and by counting zeros."""

from pathlib import Path

import numpy as np
import pytest
from helpers.problems import problem

from necc_casadi.model.model_file import load_model
from necc_casadi.synthesis.options import Options
from necc_casadi.synthesis.plan import make_plan, whole_space_stiffness

EXAMPLES = Path(__file__).parents[2] / "examples"
GROWTH = 0.05


def plan_of(name: str, target: str, options: Options | None = None):
    task = problem(load_model(EXAMPLES / f"{name}.py"), target)
    plan = make_plan(task.loop, task.casimirs, task.verdict, task.x_star, options or Options())
    return task, plan


def pendulum_slope(kappa: float, target: float):
    """∇w of P = 1 − cos q with springs K″ = Hc″ = κ in series and the slope that holds q*."""
    return lambda q: np.sin(q) - np.sin(target) + kappa / 2 * (q - target)


@pytest.mark.parametrize("target", [0.3, np.pi / 4, 2.0])
def test_it_is_the_pendulums_closed_form(target):
    _, plan = plan_of("pendulum", f"{target!r}")
    found = whole_space_stiffness(plan)
    energy, size = plan.sizes.energy, plan.sizes.state[0]
    kappa = found * energy / size**2  # in the units of the model; ξ and c have q's size
    q = np.linspace(target - 9, target + 9, 20001)
    away = q - target
    q, away = q[away != 0], away[away != 0]
    least = np.max(2 * (GROWTH * energy - (np.sin(q) - np.sin(target)) / away))
    assert kappa == pytest.approx(max(least, 0), rel=5e-3)


@pytest.mark.parametrize("target", [np.pi / 4, 2.0, np.pi])
def test_there_is_one_critical_point_with_it_and_more_with_half_of_it(target):
    _, plan = plan_of("pendulum", f"{target!r}")
    kappa = whole_space_stiffness(plan) * plan.sizes.energy / plan.sizes.state[0] ** 2
    q = np.linspace(target - 20, target + 20, 40000)
    zeros = [
        np.count_nonzero(np.diff(np.sign(pendulum_slope(share * kappa, target)(q))))
        for share in (1.0, 0.5)
    ]
    assert zeros[0] == 1 < zeros[1]


def test_springs_in_series_limit_what_stiffness_can_do():
    """The motor's flux is one of them, ρ < 1 for every K and Hc, and yet some κ is enough."""
    _, plan = plan_of("dc_motor", "phi=sqrt(2)/2,p=0,theta=pi/4")
    kappa = whole_space_stiffness(plan) * plan.sizes.energy / plan.sizes.state[2] ** 2
    assert 1.5 < kappa < 3


@pytest.mark.parametrize(
    ("name", "target"),
    [
        ("cart_pole", "x=1,theta=pi,p_x=0,p_theta=0"),  # nothing sees the angle
        ("maglev", "q=0.1,p=0"),  # the input acts through a pole
    ],
)
def test_there_is_none_where_no_stiffness_is_enough_or_no_proof_could_follow(name, target):
    _, plan = plan_of(name, target)
    assert whole_space_stiffness(plan) is None


def test_it_is_the_lower_bound_of_the_quadratic_parts():
    task, plan = plan_of("pendulum", "pi/4", Options(whole=True))
    assert plan.anchor.kappa_min == whole_space_stiffness(plan)
    from helpers.problems import solve

    made = solve(task, Options(whole=True, least_cost=True))
    parts = zip(made.form.networks, made.form.split(made.natural.weights), strict=True)
    kappas = np.concatenate([network.quadratic_part(w)[0] for network, w in parts])
    scale = made.natural.sizes.energy / made.natural.sizes.state[[0, 2]] ** 2
    assert (kappas >= 0.99 * plan.anchor.kappa_min * scale[::-1]).all()


def test_a_plant_without_such_a_stiffness_gets_the_usual_bound():
    from necc_casadi.lyapunov.networks import KAPPA_MIN

    _, plan = plan_of("cart_pole", "x=1,theta=pi,p_x=0,p_theta=0", Options(whole=True))
    assert plan.anchor.kappa_min == KAPPA_MIN
