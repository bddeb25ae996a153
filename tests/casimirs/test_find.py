import numpy as np
import pytest
import sympy as sp
from helpers.symbolic_plants import (
    body_and_wheel,
    canonical,
    load,
    numeric,
    predator_prey,
    rolling_coin,
    transformed,
)
from hypothesis import given, settings
from hypothesis import strategies as st

from necc_casadi.casimirs.find import find_casimirs
from necc_casadi.errors import ModelError
from necc_casadi.model.closed_loop import interconnect
from necc_casadi.model.controller import default_controller
from necc_casadi.model.plant import make_plant
from necc_casadi.verdict.controller_structures import kinematic_copy


def default_loop(plant):
    return interconnect(plant, default_controller(plant))


def conserved(loop, functions, seed=0, start=None):
    """Largest drift of the functions along ż = (Jcl − Rcl)∇F for a random F, by RK4."""
    rng = np.random.default_rng(seed)
    M = sp.lambdify(loop.z, loop.M, "numpy")
    c = sp.lambdify(loop.z, list(functions), "numpy")
    A, b = rng.normal(size=(loop.n, loop.n)), rng.normal(size=loop.n)
    z = rng.uniform(0.4, 0.9, loop.n) if start is None else np.array(start)
    first = np.array(c(*z), dtype=float)

    def rate(z):
        return np.array(M(*z), dtype=float) @ (np.tanh(A @ z) + b)

    for _ in range(400):
        h = 2e-4
        k1 = rate(z)
        k2 = rate(z + h / 2 * k1)
        k3 = rate(z + h / 2 * k2)
        k4 = rate(z + h * k3)
        z = z + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    assert np.linalg.norm(z - rng.uniform(0.4, 0.9, loop.n)) > 1e-3
    return float(np.abs(np.array(c(*z), dtype=float) - first).max(initial=0.0))


def jacobian_rank(loop, functions):
    """Rank of finite-difference gradients at a random point."""
    c = sp.lambdify(loop.z, list(functions), "numpy")
    z = np.random.default_rng(3).uniform(0.4, 0.9, loop.n)
    rows = []
    for i in range(loop.n):
        step = np.zeros(loop.n)
        step[i] = 1e-6
        rows.append((np.array(c(*(z + step))) - np.array(c(*(z - step)))) / 2e-6)
    return np.linalg.matrix_rank(np.array(rows), tol=1e-6)


LOOPS = {
    "pendulum": lambda: load("pendulum")[1],
    "maglev": lambda: load("maglev")[1],
    "dc motor": lambda: load("dc_motor")[1],
    "coin": lambda: default_loop(rolling_coin()),
    "coin, copied": lambda: interconnect(rolling_coin(), kinematic_copy(rolling_coin())),
    "body": lambda: default_loop(body_and_wheel()),
    "predator": lambda: default_loop(predator_prey()),
}


@pytest.mark.parametrize(
    ("name", "rank", "count"),
    [
        ("pendulum", 1, 1),
        ("maglev", 1, 1),
        ("dc motor", 1, 1),
        ("coin", 4, 2),
        ("coin, copied", 6, 4),
        ("body", 1, 1),
        ("predator", 1, 1),
    ],
)
def test_every_casimir_is_found_and_stays_constant(name, rank, count):
    loop = LOOPS[name]()
    found = find_casimirs(loop)
    assert (found.kernel_rank, found.generic_count, len(found.functions)) == (rank, count, count)
    assert found.count_proved
    assert found.complete
    assert found.note is None
    assert jacobian_rank(loop, found.functions) == count
    assert conserved(loop, found.functions) < 1e-9


@pytest.mark.slow
def test_satellite_attitude_error_is_found():
    loop = load("satellite")[1]
    found = find_casimirs(loop)
    assert (found.kernel_rank, found.generic_count, len(found.functions)) == (3, 3, 3)
    assert jacobian_rank(loop, found.functions) == 3
    assert conserved(loop, found.functions) < 1e-9


def test_pointwise_kernel_without_casimirs():
    loop = load("satellite", integrators=True)[1]
    found = find_casimirs(loop)
    assert (found.kernel_rank, found.generic_count, found.functions) == (3, 0, ())


def test_one_torque_on_a_rigid_body_leaves_nothing():
    p = sp.symbols("p1:4", real=True)
    J = sp.Matrix([[0, -p[2], p[1]], [p[2], 0, -p[0]], [-p[1], p[0], 0]])
    H = p[0] ** 2 + p[1] ** 2 + p[2] ** 2 / 2
    plant = make_plant(p, J, sp.zeros(3, 3), sp.Matrix([1, 0, 0]), H)
    found = find_casimirs(default_loop(plant))
    assert (found.kernel_rank, found.generic_count) == (0, 0)


def test_constant_form_is_the_documented_basis():
    q1, q2, p1, p2 = sp.symbols("q1 q2 p1 p2", real=True)
    G = sp.Matrix([0, 0, sp.Rational(2, 3), sp.Rational(1, 3)])
    plant = make_plant((q1, q2, p1, p2), canonical(2), sp.zeros(4, 4), G, p1**2 + p2**2 + q1**2)
    xi1 = sp.Symbol("xi1", real=True)
    assert find_casimirs(default_loop(plant)).functions == (2 * q1 + q2 - 3 * xi1,)


def test_supplied_casimirs_are_proved():
    loop = load("maglev")[1]
    q, _p, xi1 = loop.z
    (form,) = find_casimirs(loop).functions
    assert find_casimirs(loop, [sp.exp(form)]).functions == (sp.exp(form),)
    with pytest.raises(ModelError) as caught:
        find_casimirs(loop, [q - xi1])
    assert caught.value.code == "casimir_disproved"
    with pytest.raises(ModelError) as caught:
        find_casimirs(loop, [sp.Integer(3)])
    assert caught.value.code == "casimir_disproved"
    with pytest.raises(ModelError) as caught:
        find_casimirs(loop, [q - sp.Symbol("other")])
    assert caught.value.code == "undefined_symbol"


def test_a_function_of_known_casimirs_is_not_listed_again():
    loop = load("pendulum")[1]
    q, _p, xi1 = loop.z
    assert find_casimirs(loop, [(q - xi1) ** 3]).functions == (q - xi1,)


def test_missing_closed_forms_are_reported():
    """∇C ∝ exp(x²): the Casimir exists, its closed form does not."""
    x, y = sp.symbols("x y", real=True)
    J = sp.Matrix([[0, 1], [-1, 0]])
    plant = make_plant((x, y), J, sp.zeros(2, 2), sp.Matrix([0, sp.exp(x**2)]), x**2 + y**2)
    found = find_casimirs(default_loop(plant))
    assert (found.generic_count, found.functions) == (1, ())
    assert not found.complete
    assert "casimirs = [" in found.note


def test_forms_without_poles_at_the_target_are_preferred():
    plant = predator_prey()
    x1, x2 = plant.x
    found = find_casimirs(default_loop(plant), (), {x1: sp.Integer(1), x2: sp.Integer(2)})
    assert not found.functions[0].subs({x1: 1, x2: 2}).has(sp.zoo, sp.nan)


@pytest.mark.parametrize(
    ("G", "form"),
    [
        (lambda q: sp.Matrix([0, sp.cos(q)]), lambda q, xi: sp.sin(q) - xi),
        (lambda q: sp.Matrix([0, sp.exp(q)]), lambda q, xi: sp.exp(q) - xi),
        (lambda q: sp.Matrix([0, 1 + q**2]), lambda q, xi: q + q**3 / 3 - xi),
        (lambda q: sp.Matrix([0, 1 / (1 + q**2)]), lambda q, xi: sp.atan(q) - xi),
        (lambda q: sp.Matrix([0, 1 / sp.sqrt(1 + q**2)]), lambda q, xi: sp.asinh(q) - xi),
        (lambda q: sp.Matrix([0, sp.sqrt(2)]), lambda q, xi: sp.sqrt(2) * q - xi),
        (lambda q: sp.Matrix([0, sp.tan(q)]), lambda q, xi: sp.log(sp.cos(q)) + xi),
        (lambda q: sp.Matrix([0, sp.sqrt(1 + q)]), lambda q, xi: (1 + q) ** sp.Rational(3, 2) - xi),
    ],
)
def test_state_dependent_inputs(G, form):
    """ξ̇ = g(q)q̇, so the Casimir is the antiderivative of g, less ξ."""
    q, p = sp.symbols("q p", real=True)
    plant = make_plant((q, p), sp.Matrix([[0, 1], [-1, 0]]), sp.zeros(2, 2), G(q), p**2 / 2 + q**2)
    loop = default_loop(plant)
    found = find_casimirs(loop)
    assert len(found.functions) == found.generic_count == 1
    assert conserved(loop, found.functions) < 1e-9
    assert not jacobian_rank(loop, [*found.functions, found.functions[0] ** 2]) > 1
    assert form(q, loop.z[2]).free_symbols == found.functions[0].free_symbols


def test_the_separable_form():
    """α(x1) = 1/cos x1 separates: C = ∫dx1/cos x1 − ∫(x2 + 3)dx2."""
    x1, x2 = sp.symbols("x1 x2", real=True)
    G = sp.Matrix([sp.cos(x1), 1 / (x2 + 3)])
    plant = make_plant((x1, x2), sp.zeros(2, 2), sp.zeros(2, 2), G, x1**2 + x2**2)
    loop = default_loop(plant)
    found = find_casimirs(loop)
    assert found.origins == ("integrated one-form",)
    assert conserved(loop, found.functions) < 1e-9


integers = st.integers(-2, 2)


@st.composite
def constant_plants(draw):
    n, m = draw(st.integers(2, 5)), draw(st.integers(1, 2))
    upper = draw(st.lists(integers, min_size=n * n, max_size=n * n))
    A = sp.Matrix(n, n, upper)
    b = sp.Matrix(draw(st.lists(integers, min_size=n, max_size=n)))
    G = sp.Matrix(n, m, draw(st.lists(integers, min_size=n * m, max_size=n * m)))
    if np.linalg.matrix_rank(numeric(G)) < m:
        G = sp.eye(n)[:, :m]
    R = b * b.T if draw(st.booleans()) else sp.zeros(n, n)
    x = sp.symbols(f"x1:{n + 1}", real=True)
    return make_plant(x, A - A.T, R, G, sum(s**2 for s in x))


@given(constant_plants())
@settings(max_examples=40, deadline=None)
def test_constant_structures_have_as_many_casimirs_as_the_kernel_is_wide(plant):
    loop = default_loop(plant)
    found = find_casimirs(loop)
    stacked = np.vstack([numeric(loop.J), numeric(loop.R)])
    assert len(found.functions) == loop.n - np.linalg.matrix_rank(stacked)
    for c in found.functions:
        v = np.array([float(sp.diff(c, s)) for s in loop.z])
        assert np.abs(v @ numeric(loop.M)).max() < 1e-12


@pytest.mark.parametrize("plant", [rolling_coin(), body_and_wheel()], ids=["coin", "body"])
def test_counts_do_not_depend_on_coordinates(plant):
    n = plant.n
    T = sp.eye(n)
    for i in range(n - 1):
        T[i, i + 1] = (-1) ** i
    here, there = default_loop(plant), default_loop(transformed(plant, T))
    first, second = find_casimirs(here), find_casimirs(there)
    assert (first.kernel_rank, first.generic_count) == (second.kernel_rank, second.generic_count)
    assert second.complete
    assert conserved(there, second.functions) < 1e-8
