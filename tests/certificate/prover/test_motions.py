"""Motions without loss: derived to be none where there are none, and nowhere else."""

import dataclasses
import json
from itertools import combinations, pairwise, product

import numpy as np
import pytest
import sympy as sp
from helpers.constructed import EXAMPLES, make_design, mechanical, two_link_arm
from scipy.integrate import solve_ivp

from necc_casadi.certificate.checker import motions as checked
from necc_casadi.certificate.checker.arithmetic.potential import Energy
from necc_casadi.certificate.checker.model import StoredDesign
from necc_casadi.certificate.claims.fields import read_as
from necc_casadi.certificate.claims.motions import Solutions, Step
from necc_casadi.certificate.prover.arithmetic.intervals import Interval
from necc_casadi.certificate.prover.motions import no_motion_without_loss
from necc_casadi.lyapunov.networks import Network
from necc_casadi.lyapunov.parameterization import Form
from necc_casadi.model.closed_loop import interconnect
from necc_casadi.model.controller import default_controller, make_controller
from necc_casadi.model.model_file import load_model
from necc_casadi.model.plant import make_plant

QUADRATIC = Form(Network(1, (), quadratic=True), Network(1, (), quadratic=True))
HALF = 3.0


def quadratic(kappa, middle) -> list[float]:
    """½ Σ κᵢ(vᵢ − oᵢ)²: the affine part is zero."""
    return [*np.zeros(len(middle) + 1), *kappa, *middle]


def held(loop, target, xi, h=2.0, k=1.5):
    """K and Hc quadratic with their slopes at the target balancing the plant's."""
    nc = loop.controller.nc
    made = make_design(
        loop.plant, target, Form(Network(nc, (), quadratic=True), Network(1, (), quadratic=True)),
        [*quadratic([h] * nc, xi), *quadratic([k], [0.0])], xi, loop=loop,
    )  # fmt: skip
    (c,) = made.casimirs.functions
    at = dict(zip(loop.z, [*target, *xi], strict=True))
    slopes = [sp.diff(c, s) for s in loop.z]
    seen = next(i for i, s in enumerate(slopes[: loop.plant.n]) if s != 0)
    pull = float(sp.diff(loop.plant.H, loop.z[seen]).subs(at) / slopes[seen])  # −K′
    centre = float(c.subs(at)) + pull / k
    shift = [
        float(x) - pull * float(s) / h for x, s in zip(xi, slopes[loop.plant.n :], strict=True)
    ]
    weights = [*quadratic([h] * nc, shift), *quadratic([k], [centre])]
    return dataclasses.replace(made, weights=np.array(weights))


def example(name, target, xi=None):
    loop = load_model(EXAMPLES / f"{name}.py").loop
    return held(loop, target, [0.3] * loop.controller.nc if xi is None else xi)


def dc_motor():
    return example("dc_motor", (sp.sin(sp.pi / 4), 0, sp.pi / 4))


def cart_pole():
    return example("cart_pole", (1, sp.pi, 0, 0))


def tora(theta=0):
    return example("tora", (0, theta, 0, 0))


def both(design, box=True, resting=None):
    """The derivation, which the checker must confirm; None where there is none."""
    resting = design.momenta if resting is None else resting
    z, half = design.z_bar, 1e-9
    lo, hi = z - HALF, z + HALF
    steps = no_motion_without_loss(
        design, resting, Interval(z - half, z + half), Interval(lo, hi) if box else None
    )
    if steps is not None:
        assert replayed(design, steps, box, resting)
    return steps


def replayed(design, steps, box=True, resting=None) -> bool:
    model = StoredDesign(json.loads(design.text))
    z = design.z_bar
    sides = tuple((float(v - HALF), float(v + HALF)) for v in z) if box else None
    place = tuple((float(v - 1e-9), float(v + 1e-9)) for v in z)
    resting = design.momenta if resting is None else resting
    energy = Energy(model, range(len(model.z)))
    return checked.no_motion_without_loss(energy, resting, steps, place, sides)


@pytest.mark.parametrize("box", [True, False])
@pytest.mark.parametrize("make", [dc_motor, cart_pole, tora])
def test_plants_whose_unactuated_states_the_casimirs_give_away(make, box):
    design = make()
    assert np.abs(np.asarray(design.lyapunov.gradient(design.z_bar), float)).max() < 1e-9
    steps = both(design, box)
    assert steps is not None
    claim = Solutions("converges", steps)
    assert read_as(Solutions, json.loads(json.dumps(claim.data))) == claim


def test_the_class_of_full_dissipation_is_covered():
    arm = make_design(
        two_link_arm(), (0, 0, 0, 0),
        Form(Network(2, (), quadratic=True), Network(2, (), quadratic=True)),
        [*quadratic([3, 3], [0, 0]), *quadratic([3, 3], [0, 0])], [0, 0],
    )  # fmt: skip
    assert both(arm) is not None
    assert both(arm, box=False) is not None


def test_a_rotor_that_does_not_feel_the_cart_is_not_claimed():
    """At θ = 90° the coupling m e cos θ vanishes: the cart swings for ever, and V stays."""
    design = tora(sp.pi / 2)
    assert both(design) is None
    start = design.z_bar + np.array([0.3, 0, 0, 0, 0])
    start = np.asarray(start, float)
    end = simulated(design, start, 50.0)
    assert design.V(end) > design.V(design.z_bar) + 0.5 * (design.V(start) - design.V(design.z_bar))
    assert not replayed(design, both(tora()))


def random_chain(seed):
    """Two coupled oscillators with one input, some of them damped."""
    rng = np.random.default_rng(seed)
    a, b, c = map(int, rng.integers(1, 4, 3))
    damped = [int(d) for d in rng.integers(0, 2, 2) * rng.integers(0, 2, 2)]
    same, apart = rng.integers(0, 2, 2)
    coupling = 0 if apart else c
    plant = mechanical(
        lambda q1, q2, p1, p2: (
            (p1**2 + p2**2 + a * q1**2 + (a if same else b) * q2**2 + coupling * (q1 - q2) ** 2) / 2
        ),
        2,
        inputs=[0],
        R=sp.diag(0, 0, *damped),
    )
    return held(interconnect(plant, default_controller(plant)), (0, 0, 0, 0), [0.0])


@pytest.mark.parametrize("seed", range(12))
def test_of_linear_plants_it_is_the_test_of_observability(seed):
    """Where a motion without loss is left, an eigenvalue of the loop is on the axis."""
    design = random_chain(seed)
    steps = both(design, box=False)
    decays = np.linalg.eigvals(design.lyapunov.linearisation(design.z_bar)).real.max() < -1e-9
    assert (steps is not None) == decays


def test_both_kinds_of_linear_plants_are_among_those():
    decay = [both(random_chain(seed), box=False) is not None for seed in range(12)]
    assert 2 < sum(decay) < 11


def test_a_rate_is_taken_of_linear_entries_alone():
    """H of the hanging cart-pole is no quadratic of θ, nor of its momenta."""
    design = cart_pole()
    x, theta, p_x, p_theta, xi = range(5)
    for states in [(theta,), (p_x,), (p_theta,), (xi,), (x, theta)]:
        assert not replayed(design, [Step("linear", states), *both(design)])
    assert replayed(design, [Step("linear", (x,)), *both(design)])


def test_a_state_is_placed_only_where_its_value_follows():
    """Without the step that says where θ is, its coupling need not differ from 0."""
    steps = both(tora())
    assert not replayed(tora(), [s for s in steps if s.rule != "placed"])


@pytest.mark.parametrize("make", [dc_motor, cart_pole, tora])
def test_no_needed_step_can_be_left_out_or_put_first(make):
    design = make()
    steps = both(design)
    last = steps[-1]
    assert not replayed(design, steps[:-1])
    assert not replayed(design, [last, *steps[:-1]])
    other = dataclasses.replace(last, states=tuple((i + 1) % design.loop.n for i in last.states))
    assert not replayed(design, [*steps[:-1], other])
    assert not replayed(design, [*steps[:-1], Step(last.rule, (99,))])
    assert not replayed(design, [*steps[:-1], Step(last.rule, ())])


def springs(*x):
    """Unit masses on unit springs, to the ground and to their neighbours."""
    count = len(x) // 2
    return (sum(v**2 for v in x) + sum((a - b) ** 2 for a, b in pairwise(x[:count]))) / 2


def chain(masses, actuated, H=springs):
    plant = mechanical(H, masses, inputs=[actuated])
    weights = [*quadratic([2], [0]), *quadratic([2], [0])]
    return make_design(plant, [0] * (2 * masses), QUADRATIC, weights, [0])


def test_an_end_of_a_chain_sees_all_of_it_and_its_middle_does_not():
    assert both(chain(3, 0)) is not None
    assert both(chain(4, 3)) is not None
    assert both(chain(3, 1)) is None


def test_a_mode_that_nothing_damps_is_seen():
    uncoupled = chain(2, 0, lambda q1, q2, p1, p2: (q1**2 + q2**2 + p1**2 + p2**2) / 2)
    assert both(uncoupled) is None


def test_a_periodic_orbit_within_a_sublevel_set():
    """One critical point, ∇²V ≻ 0, and orbits of the unactuated pair on which V stays constant.

    ẋ₁ = w₂, ẋ₂ = −w₁ + w₃ with damping through x₃ alone, which sees the pair not at all.
    """
    x = sp.symbols("x1:5", real=True)
    J = sp.Matrix([[0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 0, 1], [0, 0, -1, 0]])
    H = sum(v**2 for v in x) / 2 + x[0] ** 4
    plant = make_plant(x, J, sp.zeros(4), sp.Matrix([0, 0, 0, 1]), H, name="pair")
    weights = [*quadratic([2], [0]), *quadratic([2], [0])]
    design = make_design(plant, [0] * 4, QUADRATIC, weights, [0])
    assert both(design) is None


def sloping(g, coupled=0):
    """Two masses, the first driven, with ∂U/∂q1 = g(q2) + a multiple of q1."""

    def H(q1, q2, p1, p2):
        return (p1**2 + p2**2) / 2 + q2**2 + q1 * g(q2) + coupled * q1**2 / 2

    return chain(2, 0, H)


def test_a_slope_that_is_analytic_tells_the_far_state():
    assert both(sloping(sp.sin), resting=(2, 3)) is not None


def test_a_slope_that_is_flat_over_a_range_tells_nothing():
    """The arc sine of sin q2 is q2 up to ±π/2: their difference is 0 there, but not everywhere."""
    assert both(sloping(lambda q: sp.asin(sp.sin(q)) - q), resting=(2, 3)) is None


def test_a_slope_in_two_states_tells_the_far_one_where_it_is_monotone():
    design = sloping(sp.sin, coupled=1)
    assert both(design, resting=(2, 3)) is None  # cos q2 changes its sign within ±3
    half = np.full(5, 1.0)
    at = Interval(-1e-9 * half, 1e-9 * half)
    assert no_motion_without_loss(design, (2, 3), at, Interval(-half, half)) is not None


def test_two_inputs_and_a_controller_with_own_dynamics():
    """A controller state that no port sees, and that its energy does not determine: not claimed."""
    q, p = sp.symbols("q p", real=True)
    plant = make_plant(
        (q, p), sp.Matrix([[0, 1], [-1, 0]]), sp.zeros(2), sp.Matrix([0, 1]), (p**2 + q**2) / 2
    )
    xi = sp.symbols("xi1 xi2", real=True)
    idle = make_controller(plant, xi, sp.zeros(2), sp.zeros(2), sp.Matrix([1, 0]))
    loop = interconnect(plant, idle)
    form = Form(Network(2, (), quadratic=True), Network(2, (), quadratic=True))
    weights = [*quadratic([2, 2], [0, 0]), *quadratic([2, 2], [0, 0])]
    design = make_design(plant, [0, 0], form, weights, [0, 0], loop=loop)
    assert both(design) is None  # ξ2 rests wherever it is, and C may hold any function of it


def simulated(design, start, horizon):
    field = design.lyapunov.vector_field
    found = solve_ivp(
        lambda t, z: np.asarray(field(z), float).ravel(),
        (0, horizon), start, method="LSODA", rtol=1e-9, atol=1e-11,
    )  # fmt: skip
    assert found.success
    return found.y[:, -1]


@pytest.mark.slow
@pytest.mark.parametrize("make", [dc_motor, cart_pole, tora])
def test_solutions_from_far_away_lose_all_their_slope(make):
    """24 random starts up to ±6 away in each state, by an outside integrator: all go to ∇V = 0."""
    design = make()
    rng = np.random.default_rng(7)
    for _ in range(24):
        end = simulated(design, design.z_bar + rng.uniform(-6, 6, design.loop.n), 4000.0)
        assert np.abs(np.asarray(design.lyapunov.gradient(end), float)).max() < 2e-2


def all_steps(count, plant_states):
    """Every step that can be written down about so many states."""
    sizes = {1: ("rate", "steady", "momentum"), 2: ("level", "inertia"), 3: ("swing",)}
    for size, rules in sizes.items():
        yield from (Step(r, t) for t in product(range(count), repeat=size) for r in rules)
    for size in range(1, count + 1):
        for states in combinations(range(count), size):
            yield from (Step(rule, states) for rule in ("convex", "placed"))
            if max(states) < plant_states:
                yield Step("linear", states)


def most_that_a_forger_can_derive(design, box):
    """How many forms vanish after every step that the checker follows, again and again."""
    model, z = StoredDesign(json.loads(design.text)), design.z_bar
    sides = tuple((float(v - HALF), float(v + HALF)) for v in z) if box else None
    place = tuple((float(v - 1e-9), float(v + 1e-9)) for v in z)
    energy = Energy(model, range(len(z)))
    known = checked._Solution(energy, tuple(design.momenta), place, sides)
    assert known.inertia_is_finite()
    steps, before = list(all_steps(len(z), model.n)), -1
    while (found := known.forms.rank + sum(map(len, (known.constant, known.steady)))) != before:
        before = found
        for step in steps:
            known.follow(step)
    return known.forms.rank


@pytest.mark.slow
@pytest.mark.parametrize("box", [True, False])
def test_no_choice_of_steps_proves_what_is_false(box):
    """Plants with motions that V does not see, and one that has none, for the contrary."""
    uncoupled = chain(2, 0, lambda q1, q2, p1, p2: (q1**2 + q2**2 + p1**2 + p2**2) / 2)
    for design in (tora(sp.pi / 2), chain(3, 1), uncoupled):
        assert most_that_a_forger_can_derive(design, box) < design.loop.n
    design = tora()
    assert most_that_a_forger_can_derive(design, box) == design.loop.n
