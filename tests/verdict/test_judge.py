"""Verdicts: against a numerical search, in any coordinates, at any size."""

import numpy as np
import pytest
import sympy as sp
from helpers.linear_problems import default_loop, judged, linear_problems
from helpers.symbolic_plants import (
    best_hessian_eigenvalue,
    body_and_wheel,
    canonical,
    curved,
    load,
    predator_prey,
    transformed,
    verdict_of,
)
from hypothesis import given, settings
from hypothesis import strategies as st

from necc_casadi.casimirs.casimirs import Casimirs
from necc_casadi.model.closed_loop import interconnect
from necc_casadi.model.plant import make_plant
from necc_casadi.verdict.controller_structures import (
    complete_controller,
    kinematic_copy,
)
from necc_casadi.verdict.judge import judge


@given(linear_problems())
@settings(max_examples=60, deadline=None)
def test_verdict_agrees_with_a_numerical_search(problem):
    plant, target = problem
    loop = default_loop(plant)
    casimirs, verdict = judged(loop, target)
    assert verdict.assignable is not None
    best = best_hessian_eigenvalue(loop, casimirs, target)
    assert (best > 1e-7) == verdict.assignable
    if verdict.assignable and verdict.a_max is not None:
        assert best <= verdict.a_max + 1e-6
        assert best >= 0.9 * verdict.a_max - 1e-3


@given(linear_problems(), st.integers(0, 10**6))
@settings(max_examples=40, deadline=None)
def test_verdict_does_not_depend_on_coordinates(problem, seed):
    plant, target = problem
    rng = np.random.default_rng(seed)
    T = sp.eye(plant.n)
    for _ in range(4):
        i, j = rng.choice(plant.n, 2, replace=False)
        shear = sp.eye(plant.n)
        shear[int(i), int(j)] = int(rng.integers(-1, 2))
        T = T * shear
    other = transformed(plant, T)
    moved = dict(zip(other.x, T.inv() * sp.Matrix(list(target.values())), strict=True))
    _, here = judged(default_loop(plant), target)
    _, there = judged(default_loop(other), moved)
    assert (here.assignable, here.reason) == (there.assignable, there.reason)
    assert here.stability == there.stability
    assert here.invisible.cols == there.invisible.cols


@pytest.mark.parametrize(("angle", "expected"), [("pi", True), ("0", False)])
def test_nonlinear_coordinates_of_the_cart_pole(angle, expected):
    plant, _, _ = load("cart_pole")
    T = sp.Matrix([[1, 1, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 2, 0, 1]])
    other = transformed(plant, T)
    x_star = T.inv() * sp.Matrix([1, sp.sympify(angle), 0, 0])
    verdict = verdict_of(default_loop(other), list(x_star))
    assert verdict.assignable is expected


@pytest.mark.parametrize(
    ("name", "curve", "target", "reason"),
    [
        ("pendulum", lambda y: (y[0] + y[1] ** 2, y[1]), (1, 0), "ok"),
        ("pendulum", lambda y: (y[0] + y[0] ** 3, y[1]), (1, 0), "ok"),
        ("pendulum", lambda y: (sp.sinh(y[0]), y[1]), (1, 0), "ok"),
        ("parallel_rlc", lambda y: (y[0] + y[1] ** 2, y[1]), ("3/4", "1/2"), "invisible_gradient"),
        (
            "cart_pole",
            lambda y: (y[0] + y[1] ** 2, y[1], y[2], y[3] + y[0] * y[2]),
            (1, 0, 0, 0),
            "invisible_negative_curvature",
        ),
        ("cart_pole", lambda y: (y[0] + y[1] ** 2, *y[1:]), (1, sp.pi, 0, 0), "ok"),
    ],
)
def test_verdict_does_not_depend_on_curved_coordinates(name, curve, target, reason):
    """J, R and G become functions of the state, the Casimirs nonlinear, the verdict stays."""
    plant, _, _ = load(name)
    y = sp.symbols(f"y1:{plant.n + 1}", real=True)
    other = curved(plant, y, curve(y))
    loop = default_loop(other)
    casimirs, verdict = judged(loop, dict(zip(y, map(sp.sympify, target), strict=True)))
    assert casimirs.complete
    assert verdict.reason == reason


@pytest.mark.parametrize(
    ("inertia", "reason"),
    [
        ((3, 2, 1), "ok"),
        ((2, 3, 1), "invisible_negative_curvature"),
        ((1, 2, 3), "invisible_negative_curvature"),
    ],
)
def test_spin_about_the_principal_axes(inertia, reason):
    """A classical result: ‖p‖² makes spin about the major axis a minimum, about no other."""
    loop = default_loop(body_and_wheel(inertia))
    casimirs, verdict = judged(loop, dict(zip(loop.plant.x, (2, 0, 0, 0), strict=True)))
    assert verdict.reason == reason
    assert (
        best_hessian_eigenvalue(
            loop, casimirs, {**dict(zip(loop.plant.x, (2, 0, 0, 0), strict=True))}
        )
        > 0
    ) == (reason == "ok")
    if reason == "ok":
        assert verdict.stability == "stable"
        assert verdict.lam[0] == -sp.Rational(1, 2 * inertia[0])


def test_a_maximum_needs_a_decreasing_phi():
    loop = default_loop(body_and_wheel((1, 2, 3), wheel=-1))
    verdict = verdict_of(loop, (2, 0, 0, 0))
    assert (verdict.assignable, verdict.reason) == (False, "needs_decreasing_phi")


def test_multipliers_that_the_gradient_leaves_free():
    """At p* = 0 the gradient of ‖p‖² vanishes, its curvature does not: λ is found by the LMI."""
    loop = default_loop(body_and_wheel((-3, -2, -1)))
    verdict = verdict_of(loop, (0, 0, 0, 0))
    assert verdict.reason == "ok"
    assert verdict.lam[0] > sp.Rational(1, 2)
    assert verdict.a_max == pytest.approx(1.0, abs=1e-5)


def test_exactly_flat_curvature_of_an_algebraic_constant():
    x, theta, p1, p2 = sp.symbols("x theta p1 p2", real=True)
    angle = sp.pi / 5
    flat = sp.cos(theta) + theta * sp.sin(angle) + sp.cos(angle) * (theta - angle) ** 2 / 2
    for extra, reason in (
        (0, "invisible_flat_curvature"),
        (sp.Rational(1, 10**30), "ok"),
        (-sp.Rational(1, 10**30), "invisible_negative_curvature"),
    ):
        H = (p1**2 + p2**2) / 2 + flat + extra * (theta - angle) ** 2
        G = sp.Matrix([0, 0, 1, 0])
        loop = default_loop(make_plant((x, theta, p1, p2), canonical(2), sp.zeros(4, 4), G, H))
        assert verdict_of(loop, (1, angle, 0, 0)).reason == reason


def test_degenerate_forms_never_refuse():
    """(q − ξ)³ has no gradient at q* = ξ*: it must not be taken for a proof."""
    _, loop, _ = load("pendulum")
    q, p, xi1 = loop.z
    weak = Casimirs(((q - xi1) ** 3,), 1, 1)
    verdict = judge(loop, weak, {q: sp.pi, p: sp.Integer(0)})
    assert verdict.assignable is True
    assert verdict.xi_star is not None
    nothing = Casimirs((), 1, 1)
    verdict = judge(loop, nothing, {q: sp.pi / 4, p: sp.Integer(0)})
    assert (verdict.assignable, verdict.reason) == (None, "undecided")
    assert "casimirs = [" in verdict.explanation


def test_refusal_needs_a_proved_count():
    _, loop, _ = load("parallel_rlc")
    q, phi, _ = loop.z
    target = {q: sp.Integer(1), phi: sp.Rational(1, 2)}
    unproved = Casimirs((), 0, 0, (), count_proved=False)
    assert judge(loop, unproved, target).reason == "undecided"
    assert judge(loop, Casimirs((), 0, 0), target).reason == "invisible_gradient"


def test_targets_that_no_input_holds():
    _, loop, _ = load("pendulum")
    verdict = verdict_of(loop, (sp.pi / 4, 1))
    assert (verdict.assignable, verdict.reason) == (False, "not_an_equilibrium")
    assert "p = 1" in verdict.explanation


def test_ceiling_is_approached_and_not_exceeded():
    _, loop, target = load("two_link_arm")
    casimirs, verdict = judged(loop, target)
    assert verdict.a_max == pytest.approx(0.428, abs=1e-3)
    best = best_hessian_eigenvalue(loop, casimirs, target)
    assert 0.99 * verdict.a_max < best < verdict.a_max + 1e-9


def test_no_ceiling_where_nothing_is_invisible():
    x = sp.symbols("x1", real=True)
    plant = make_plant([x], sp.zeros(1, 1), sp.zeros(1, 1), sp.eye(1), -(x**2))
    verdict = verdict_of(interconnect(plant, complete_controller(plant)), (3,))
    assert (verdict.reason, verdict.a_max, verdict.invisible.cols) == ("ok", None, 0)


def test_a_refusal_that_holds_for_every_xi():
    """The copied unicycle sees x, y and θ; an oscillator beside it stays invisible."""
    x, y, theta, a, b, v, w = sp.symbols("x y theta a b v w", real=True)
    J = sp.zeros(7, 7)
    J[0, 5], J[1, 5], J[2, 6], J[3, 4] = sp.cos(theta), sp.sin(theta), 1, 1
    G = sp.Matrix.vstack(sp.zeros(5, 2), sp.eye(2))
    H = (v**2 + w**2 + x**2 + y**2) / 2
    for sign, reason in ((1, "ok"), (-1, "invisible_negative_curvature")):
        energy = H + sign * (a**2 + b**2)
        plant = make_plant((x, y, theta, a, b, v, w), J - J.T, sp.zeros(7, 7), G, energy)
        loop = interconnect(plant, kinematic_copy(plant))
        verdict = verdict_of(loop, (1, 0, sp.pi / 2, 0, 0, 0, 0))
        assert verdict.reason == reason
        assert (verdict.xi_star is None) == (reason != "ok")


@pytest.mark.parametrize("ends", [(0,), (0, 49)])
def test_a_chain_of_fifty_masses_is_judged(ends):
    n = 50
    q, p = sp.symbols(f"q1:{n + 1}", real=True), sp.symbols(f"p1:{n + 1}", real=True)
    G = sp.zeros(2 * n, len(ends))
    for k, i in enumerate(ends):
        G[n + i, k] = 1
    H = sum(v**2 for v in p) / 2 + (q[0] ** 2 + q[-1] ** 2) / 2
    H += sum(1 - sp.cos(q[i + 1] - q[i]) for i in range(n - 1))
    R = sp.diag(sp.zeros(n, n), sp.eye(n) / 10)
    loop = default_loop(make_plant((*q, *p), canonical(n), R, G, H))
    verdict = verdict_of(loop, (0,) * (2 * n))
    assert (verdict.reason, verdict.stability) == ("ok", "asymptotic")
    assert verdict.invisible.cols == 2 * n - len(ends)


def test_a_ladder_of_forty_states_is_judged():
    n = 40
    x = sp.symbols(f"x1:{n + 1}", real=True)
    J = sp.zeros(n, n)
    for i in range(n - 1):
        J[i, i + 1], J[i + 1, i] = -1, 1
    G = sp.Matrix([1] + [0] * (n - 1))
    loop = default_loop(make_plant(x, J, sp.zeros(n, n), G, sum(s**2 for s in x) / 2))
    assert verdict_of(loop, [i % 2 for i in range(n)]).reason == "ok"
    assert verdict_of(loop, [0] * n).stability == "asymptotic"


def test_populations_in_balance():
    loop = default_loop(predator_prey())
    verdict = verdict_of(loop, (1, 2))
    assert (verdict.reason, verdict.stability) == ("ok", "asymptotic")
    assert verdict_of(loop, (2, 1)).reason == "not_an_equilibrium"
