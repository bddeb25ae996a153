"""Dissipation that vanishes at the target: which motions it reaches, and which it does not."""

import numpy as np
import pytest
import sympy as sp
from helpers.dragged import ATTRACT, SWING, UNDECIDED, UNKNOWN, chain, on_momenta, p1, q1
from helpers.symbolic_plants import verdict_of
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from necc_casadi.model.closed_loop import interconnect
from necc_casadi.model.controller import default_controller
from necc_casadi.model.plant import make_plant
from necc_casadi.verdict.vanishing_damping import vanishing_damping_attracts


def judged(R, target=(0, 0, 0, 0, 0, 0)):
    plant = chain(R)
    return verdict_of(interconnect(plant, default_controller(plant)), target)


@pytest.mark.parametrize("R", ATTRACT.values(), ids=ATTRACT)
def test_it_may_reach_every_motion(R):
    verdict = judged(R)
    assert verdict.stability == "asymptotic"
    assert not verdict.exponential
    assert "slower than exponential" in verdict.explanation


@pytest.mark.parametrize("R", SWING.values(), ids=SWING)
def test_motions_that_it_never_touches_are_a_witness(R):
    verdict = judged(R)
    assert verdict.stability == "stable"
    assert "p1, p3" in verdict.witness


@pytest.mark.parametrize("R", UNDECIDED.values(), ids=UNDECIDED)
def test_what_is_not_proved_is_not_decided(R):
    verdict = judged(R)
    assert verdict.stability is None
    assert "not decided" in verdict.explanation


def test_displaced_targets():
    half = sp.Rational(1, 2)
    at = (half, 1, half, 0, 0, 0)
    assert judged(on_momenta((q1 - half) ** 2 * p1**2), at).stability == "asymptotic"
    assert judged(on_momenta(q1**2), at).exponential  # φ(z*) > 0
    assert judged(on_momenta(0), at).stability == "stable"


HIDDEN = [(p1 + UNKNOWN) ** 2, p1**2 + UNKNOWN**2, (q1 + UNKNOWN) ** 2 * p1**2]


@pytest.mark.parametrize("phi", HIDDEN, ids=["momentum", "sum", "product"])
def test_a_zero_that_is_not_decided_hides_nothing(phi):
    """Whether φ vanishes at the target or not, z* attracts."""
    assert judged(on_momenta(phi)).stability == "asymptotic"


def test_every_gain_counts():
    """One that reaches nothing besides one that reaches everything; choices beyond count for no."""
    assert judged(on_momenta(p1**2, (p1**2 + q1**3) ** 2)).stability == "asymptotic"
    many = on_momenta(sp.Mul(*[(p1 + k * q1**2 + q1**3) ** 2 for k in range(1, 5)]))
    assert judged(many).stability == "asymptotic"


FUNCTIONS = {
    "itself": lambda v: v, "sin": sp.sin, "tanh": sp.tanh, "asinh": sp.asinh,
    "exp": lambda v: sp.exp(v) - 1,
}  # fmt: skip
FORMS = st.lists(st.integers(-2, 2), min_size=4, max_size=4).filter(any)
FACTORS = st.lists(st.tuples(st.sampled_from(sorted(FUNCTIONS)), FORMS), min_size=1, max_size=2)
z = sp.symbols("a b p_a p_b", real=True)


def silent_motions(A, outputs, choices):
    """A motion of ż = Az that one choice leaves unobserved, or None: ranks in floating point."""
    if not choices:
        rows = [outputs]
        for _ in range(len(A) - 1):
            rows.append(rows[-1] @ A)
        _, sizes, V = np.linalg.svd(np.vstack(rows))
        return None if sizes[-1] > 1e-8 * sizes[0] else V[-1]
    found = (silent_motions(A, np.vstack([outputs, c]), choices[1:]) for c in choices[0])
    return next((motion for motion in found if motion is not None), None)


def is_what_ranks_and_motions_say(coupling, stiffness, first, second):
    """The verdict is what ranks say, and what simulated motions of the damped loop do.

    Two masses, neither driven, beside a driven pendulum. The factors of both gains are functions
    of linear forms that vanish with them, so that along linear motions LaSalle's set is exact.
    """
    a, b, pa, pb = z
    q, p = sp.symbols("q p", real=True)
    phis = [
        sp.Mul(*[FUNCTIONS[f](sum(c * v for c, v in zip(form, z, strict=True))) ** 2
                 for f, form in factors])
        for factors in (first, second)
    ]  # fmt: skip
    K = sp.Matrix([[stiffness + 4, coupling], [coupling, 5]])
    y = sp.Matrix([a, b])
    H = (pa**2 + pb**2 + p**2) / 2 + (y.T * K * y)[0] / 2 + 1 - sp.cos(q)
    J = sp.zeros(6)
    J[:3, 3:], J[3:, :3] = sp.eye(3), -sp.eye(3)
    R = sp.diag(0, 0, 0, *phis, 0)
    plant = make_plant((a, b, q, pa, pb, p), J, R, sp.Matrix([0, 0, 0, 0, 0, 1]), H)
    verdict = verdict_of(interconnect(plant, default_controller(plant)), (0,) * 6)

    A = np.block([[np.zeros((2, 2)), np.eye(2)], [-np.array(K, float), np.zeros((2, 2))]])
    choices = [
        [np.eye(4)[[2 + i]], *[np.array([form], float) for _, form in factors]]
        for i, factors in enumerate((first, second))
    ]
    silent = silent_motions(A, np.zeros((0, 4)), choices)
    assert (verdict.stability == "asymptotic") == (silent is None)

    drag = sp.lambdify(z, phis)
    matrix = np.array(K, float)

    def flow(_, state):
        friction = np.array(drag(*state), float)
        return [*state[2:], *(-matrix @ state[:2] - friction * state[2:])]

    def energy(state):
        return (state[:2] @ matrix @ state[:2] + state[2:] @ state[2:]) / 2

    starts = np.random.default_rng(0).normal(size=(3, 4)) if silent is None else [silent]
    for start in starts:
        end = solve_ivp(flow, (0, 60), 0.7 * start, rtol=1e-9, atol=1e-12).y[:, -1]
        lost = 1 - energy(end) / energy(0.7 * start)
        assert (lost > 1e-5) if silent is None else (abs(lost) < 1e-6)


PLANTS = (st.integers(-2, 2), st.sampled_from([1, 4]), FACTORS, FACTORS)


@settings(max_examples=3, deadline=None)
@given(*PLANTS)
@example(0, 1, [("itself", [0, 0, 1, 0])], [("sin", [0, 0, 0, 1])])  # p_b² on b
@example(0, 1, [("itself", [0, 0, 1, 0])], [("itself", [0, 0, 1, 0])])  # a rests, b swings
@example(0, 4, [("tanh", [1, 0, 0, 0])], [("exp", [0, 1, 0, 0])])
def test_a_few_plants(coupling, stiffness, first, second):
    is_what_ranks_and_motions_say(coupling, stiffness, first, second)


@pytest.mark.slow
@settings(max_examples=60, deadline=None)
@given(*PLANTS)
def test_random_plants(coupling, stiffness, first, second):
    is_what_ranks_and_motions_say(coupling, stiffness, first, second)


def test_without_gains_that_vanish_nothing_is_looked_at():
    plant = chain(on_momenta(1))
    loop = interconnect(plant, default_controller(plant))
    at = dict.fromkeys(loop.z, sp.Integer(0))
    assert not vanishing_damping_attracts(loop, (), at, sp.eye(loop.n))
