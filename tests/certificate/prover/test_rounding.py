"""Bounds of the rounding of the C code: against the compiled code, and against the checker's."""

import numpy as np
import pytest
from flint import arb
from helpers.export_cases import design as drawn
from helpers.export_cases import pendulum_loop
from hypothesis import given, settings
from hypothesis import strategies as st

from necc_casadi.certificate.checker.sampled import rounding as checker
from necc_casadi.certificate.claims.rounding import Program
from necc_casadi.certificate.prover.arithmetic.intervals import Interval
from necc_casadi.certificate.prover.sampled import rounding as prover
from necc_casadi.export.compiled import compile_controller
from necc_casadi.lyapunov.networks import Network
from necc_casadi.lyapunov.parameterization import Form

#: Half the spacing of the numbers next to 1.
U = {"float": 2.0**-24, "double": 2.0**-53}


def seen_and_bound(made, number, box, count):
    """Largest |computed − exact| of (u, ξ̇) at random states of a box, and the bounds of it."""
    bound = np.concatenate(
        prover.Rounding(made, number, *prover.programs(made)).over(Interval(*box))
    )
    code = compile_controller(made, real=number)
    units, n = made.units, made.loop.plant.n
    z = np.random.default_rng(0).uniform(*box, (count, len(box[0]))) * units.state
    z = z.astype(np.float32).astype(float)  # numbers of the type: what is measured is rounded apart
    computed = np.array([np.concatenate(code.control(v[:n], v[n:])) for v in z])
    exact = np.hstack(made.control(z[:, :n], z[:, n:]))
    scale = np.concatenate([units.input, units.state[n:] / units.time])
    return np.abs(computed - exact).max(0) / scale, bound


@pytest.mark.parametrize("width", [0.01, 3.0])
def test_the_bound_holds_and_is_worth_something(default_design, width):
    z = default_design.natural.z_bar
    seen, bound = seen_and_bound(default_design, "float", (z - width, z + width), 1000)
    assert (seen <= bound).all()
    assert (bound <= 30 * seen).all()


@pytest.mark.parametrize("activation", ["tanh", "sin", "squareplus"])
@pytest.mark.parametrize("hidden", [(), (8, 24, 8)])
def test_the_bound_holds_for_networks_of_any_depth(activation, hidden):
    form = Form(*(Network(1, hidden, activation, quadratic=True) for _ in range(2)))
    made = drawn(pendulum_loop(), form, 3)
    z = np.zeros(3)
    seen, bound = seen_and_bound(made, "float", (z - 2, z + 2), 300)
    assert (seen <= bound).all()
    assert np.isfinite(bound).all()


def test_arguments_of_sin_that_were_not_looked_at_have_no_bound():
    network = Network(1, (4,), "sin")
    weights = network.initial(np.random.default_rng(0))
    assert np.isfinite(prover.gradient_rounding(network, weights, np.ones(1), "float")[0]).all()
    assert np.isinf(prover.gradient_rounding(network, weights, np.array([1e3]), "float")[0]).all()


# --- programs -------------------------------------------------------------------------------------

OPERATIONS = ("add", "sub", "mul", "div", "neg", "square", "sqrt", "sin", "cos", "exp", "tanh")


@st.composite
def programs(draw):
    """Three inputs, up to eight operations on what is known."""
    steps = []
    for k in range(3, 3 + draw(st.integers(1, 8))):
        name = draw(st.sampled_from(OPERATIONS))
        count = 2 if name in ("add", "sub", "mul", "div") else 1
        places = draw(st.tuples(*[st.integers(0, k - 1)] * count))
        steps.append((name, places, 0.0))
    return Program(3, tuple(steps), (2 + len(steps),))


NUMPY = {"add": np.add, "sub": np.subtract, "mul": np.multiply, "div": np.divide,
         "neg": np.negative, "square": np.square, "sqrt": np.sqrt, "sin": np.sin, "cos": np.cos,
         "exp": np.exp, "tanh": np.tanh}  # fmt: skip


def run(program, values):
    known = list(values)
    with np.errstate(all="ignore"):
        for name, places, _ in program.steps:
            known.append(NUMPY[name](*(known[k] for k in places)))
    return float(known[program.outputs[0]])


@settings(max_examples=80)
@given(programs(), st.lists(st.floats(0.5, 2.0, width=32), min_size=3, max_size=3))
def test_programs_in_float_are_within_their_bounds(program, values):
    """float32 against double, whose own error is small beside it; both bounds are nearly alike."""
    exact, computed = run(program, values), run(program, np.array(values, np.float32))
    sides = [(v * (1 - 1e-3), v * (1 + 1e-3)) for v in values]
    _, (bound,) = prover.rounded(program, sides, [0.0] * 3, "float")
    given_balls = [arb(lo).union(arb(hi)) for lo, hi in sides]
    ((_, other),) = checker.rounded(program, given_balls, [arb(0)] * 3, "float")
    if np.isfinite(bound) and np.isfinite(exact):
        assert abs(computed - exact) <= bound * (1 + 1e-6)
    if other.is_finite() and np.isfinite(exact):
        assert abs(computed - exact) <= float(other) * (1 + 1e-6)


def test_a_constant_is_rounded_once():
    program = Program(1, (("const", (), 0.1), ("mul", (0, 1), 0.0)), (2,))
    _, (bound,) = prover.rounded(program, [(1.0, 1.0)], [0.0], "float")
    assert 2 * 0.1 * U["float"] <= bound <= 2.01 * 0.1 * U["float"]


def test_the_checker_refuses_programs_that_do_not_fit():
    one = ("add", (0, 1), 0.0)
    assert checker.fits(Program(2, (one,), (2,)), 2, 1)
    assert not checker.fits(Program(2, (one,), (3,)), 2, 1)
    assert not checker.fits(Program(2, (("add", (0,), 0.0),), (2,)), 2, 1)
    assert not checker.fits(Program(2, (("rm", (0,), 0.0),), (2,)), 2, 1)
    assert not checker.fits(Program(2, (("add", (0, 2), 0.0),), (2,)), 2, 1)


@pytest.mark.parametrize("number", ["float", "double"])
@pytest.mark.parametrize("hidden", [(), (7,), (16, 5)])
@pytest.mark.parametrize("activation", ["tanh", "sin", "squareplus"])
def test_both_bound_networks_alike(number, hidden, activation):
    network = Network(2, hidden, activation, quadratic=True)
    weights = network.initial(np.random.default_rng(1))
    shape = {"inputs": 2, "hidden": list(hidden), "activation": activation, "quadratic": True}
    own, _ = prover.gradient_rounding(network, weights, np.array([1.0, 2.0]), number)
    other = checker._Layers(shape, weights.tolist()).rounding([arb(1), arb(2)], number)
    np.testing.assert_allclose([float(v) for v in other], own, rtol=1e-9)
