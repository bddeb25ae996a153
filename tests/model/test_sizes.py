"""Natural sizes: what they are by hand, in any unit, and whatever the model."""

import numpy as np
import pytest
import sympy as sp
from helpers.models import BASE
from helpers.units import Change, converted, converted_target
from hypothesis import given, settings
from hypothesis import strategies as st

from necc_casadi.casimirs.find import find_casimirs
from necc_casadi.errors import ModelError
from necc_casadi.model.domain import domain_of, exact_bounds
from necc_casadi.model.model_file import load_model
from necc_casadi.model.sizes import Sizes, geometric_mean, natural_sizes, power_of_two
from necc_casadi.model.target import parse_target

SPRING = BASE + "H = p**2 / 600 + 200000 * q**2 / 2\n"
LIGHT = BASE + 'H = p**2 * 5000 + sp.Rational("0.015") * (1 - sp.cos(q))\n'
BARGE = BASE + "H = p**2 / 4000000\n"
RLC = BASE + "H = q**2 / (2 * sp.Rational('1e-6')) + p**2 / (2 * sp.Rational('1e-3'))\n"
BOUNDED = BARGE + "domain = {q: (0, 60), p: (-6000, 3000)}\n"
TWO = """
import sympy as sp
q1, q2, p1, p2 = sp.symbols("q1 q2 p1 p2")
x = (q1, q2, p1, p2)
J = sp.Matrix([[0, 0, 1, 0], [0, 0, 0, 1], [-1, 0, 0, 0], [0, -1, 0, 0]])
R = sp.diag(0, 0, 0.1, 0.2)
G = sp.Matrix([[0, 0], [0, 0], [1, 0], [0, 1]])
H = p1**2 / 4 + p2**2 / 2 + (1 - sp.cos(q1)) / 2 + q2**2 / 4
"""


SHAFT = """
import sympy as sp
th1, th2, th3, p1, p2, p3 = x = sp.symbols("th1:4 p1:4")
J = sp.Matrix(6, 6, lambda i, j: (j == i + 3) - (i == j + 3))
R = sp.diag(0, 0, 0, 0.01, 0.02, 0.05)
G = sp.Matrix([0, 0, 0, 1, 0, 0])
H = (
    p1**2 / 0.0126 + p2**2 / 0.0022 + p3**2 / 0.056
    + 210 * (th1 - th2) ** 2 + 130 * (th2 - th3) ** 2 + 1.4 * sp.sin(th3)
)
"""


@pytest.fixture
def read(tmp_path):
    def load(text, target):
        path = tmp_path / "model.py"
        path.write_text(text, encoding="utf-8")
        model = load_model(path)
        return model, parse_target(model.loop.plant, target)

    return load


def sizes_of(model, x_star) -> Sizes:
    casimirs = find_casimirs(model.loop, (), x_star)
    return natural_sizes(model.loop, casimirs.functions, x_star)


def test_a_spring_is_as_large_as_its_displacement(read):
    """q* = 0.05 m: E = k q*², p = √(mk) q*, one radian of the motion lasts √(m/k)."""
    found = sizes_of(*read(SPRING, "q=0.05"))
    E = 2e5 * 0.05**2
    assert found.energy == pytest.approx(E)
    assert found.state == pytest.approx([0.05, np.sqrt(300 * E), 0.05])
    assert found.time == pytest.approx(np.sqrt(300 / 2e5))
    assert found.input == pytest.approx([2e5 * 0.05])
    assert found.output == pytest.approx([E / found.time / (2e5 * 0.05)])
    assert found.guessed == ("q", "p", "xi1", "u")


def test_an_angle_is_one_radian_and_its_momentum_follows(read):
    found = sizes_of(*read(LIGHT, "pi/4"))
    E = 0.015 * np.cos(np.pi / 4)
    assert found.state == pytest.approx([1, np.sqrt(1e-4 * E), 1])
    assert found.time == pytest.approx(np.sqrt(1e-4 / E))


def test_what_a_stiff_shaft_ties_to_an_angle_goes_along_with_it(read):
    """Not the few milliradians of preload: 420 (th1 − th2) and 260 (th2 − th3) are at rest so."""
    model, target = read(SHAFT, "th3=0.8")
    found = natural_sizes(model.loop, find_casimirs(model.loop).functions, target)
    assert found.state[:3] == pytest.approx([260 / 680, 260 / 680, 1])
    assert found.state[6] == pytest.approx(found.state[0])  # ξ, by th1 − ξ
    assert found.energy < 10  # what goes along stores nothing


def test_half_turns_make_an_angle_half_a_radian(read):
    found = sizes_of(*read(BASE + "H = p**2 / 2 + 1 - sp.cos(2 * q)\n", "q=0.1"))
    assert found.state[0] == 0.5


def test_a_free_state_is_as_large_as_its_target(read):
    """Nothing in the plant sets a time: one unit of it is taken."""
    found = sizes_of(*read(BARGE, "q=30"))
    assert found.state == pytest.approx([30, 2e6 * 30, 30])
    assert found.time == pytest.approx(1)


def test_limits_of_the_input_say_what_force_there_is(read):
    found = sizes_of(*read(BARGE + "u_limits = [(-1000, 1000)]\n", "q=30"))
    assert found.input.tolist() == [1000]
    assert found.energy == pytest.approx(30 * 1000)
    assert found.state[1] == pytest.approx(np.sqrt(2e6 * 30 * 1000))


def test_domains_and_sizes_of_the_file_are_taken(read):
    text = SPRING + "domain = {p: (-800, 400)}\nsizes = {q: 2, 'u': 7, 'xi1': sp.Rational(1, 3)}\n"
    found = sizes_of(*read(text, "q=0.05"))
    assert found.state == pytest.approx([2, 300, 1 / 3])
    assert found.input.tolist() == [7]
    assert found.guessed == ()


@pytest.mark.parametrize(
    ("line", "piece"),
    [("sizes = {'w': 1}", "w"), ("sizes = {q: 0}", "0"), ("sizes = {q: -1}", "-1"),
     ("sizes = {q: sp.oo}", "oo"), ("sizes = {q: 'large'}", "large"), ("sizes = 3", "wrong kind")],
)  # fmt: skip
def test_sizes_that_are_none_are_refused(read, line, piece):
    with pytest.raises(ModelError, match=piece) as caught:
        read(SPRING + line, "q=0.05")
    assert caught.value.code == "model_file"


def test_without_bounds_the_domain_is_two_sizes_wide(read):
    model, x_star = read(SPRING, "q=0.05")
    found = sizes_of(model, x_star)
    domain = domain_of(model.loop, np.array([0.05, 0, 0.01]), found.state)
    assert domain.hi - domain.lo == pytest.approx(4 * found.state)
    bounds = exact_bounds(model.loop, x_star)
    q = model.loop.plant.x[0]
    assert bounds[q] == (x_star[q] - sp.Rational(1, 8), x_star[q] + sp.Rational(1, 8))


EXPONENTS = st.integers(-40, 40)


@given(
    case=st.sampled_from([(SPRING, "q=0.05"), (LIGHT, "pi/4"), (RLC, "q=2e-6,p=0"),
                          (TWO, "q1=1,q2=-0.5"), (BOUNDED, "q=30")]),
    q=EXPONENTS, p=EXPONENTS, time=EXPONENTS, energy=EXPONENTS,
)  # fmt: skip
@settings(max_examples=40, deadline=None)
def test_other_units_of_powers_of_two_give_the_same_sizes_to_the_bit(
    tmp_path_factory, case, q, p, time, energy
):
    path = tmp_path_factory.mktemp("m") / "model.py"
    path.write_text(case[0], encoding="utf-8")
    model = load_model(path)
    x_star = parse_target(model.loop.plant, case[1])
    names = model.loop.plant.states
    two = sp.Integer(2)
    factors = [two**q if name.startswith("q") else two**p for name in names]
    change = Change(dict(zip(names, factors, strict=True)), two**time, two**energy)
    plain = sizes_of(model, x_star)
    other = sizes_of(converted(model, change), converted_target(x_star, change))
    n = len(names)
    assert other.state[:n].tolist() == (plain.state[:n] * np.array(factors, float)).tolist()
    assert other.energy == plain.energy * 2.0**energy
    assert other.time == plain.time * 2.0**time
    assert other.output.tolist() == pytest.approx(plain.output.tolist(), rel=1e-14)


@pytest.mark.parametrize("target", ["0", "1e-12", "1e9"])
@pytest.mark.parametrize(
    "H",
    ["p**2 / 2", "p**2 / 2 + q**4", "p**4 + q**4", "q * p", "q", "p**2 / 2 + q**2 / 2",
     "sp.exp(q) + p**2", "p**2 / 2 + sp.Rational('1e-300') * q**2", "sp.Rational('1e300') * p**2"],
)  # fmt: skip
def test_degenerate_plants_have_positive_finite_sizes(read, H, target):
    model, x_star = read(BASE + f"H = {H}\n", f"q={target},p=0")
    for functions in ((), find_casimirs(model.loop, (), x_star).functions):
        found = natural_sizes(model.loop, functions, x_star)
        for sizes in (found, found.units):
            numbers = [*sizes.state, *sizes.input, sizes.energy, sizes.time, *sizes.casimir]
            assert np.all(np.isfinite(numbers))
            assert np.min(numbers) > 0


@given(st.floats(1e-300, 1e300))
def test_the_nearest_power_of_two_is_within_a_root_of_two(value):
    unit = power_of_two(value)
    assert np.frexp(unit)[0] == 0.5
    assert 0.7071 <= value / unit <= 1.4143


@given(st.lists(st.floats(1e-100, 1e100), min_size=1, max_size=6), st.integers(-300, 300))
def test_a_geometric_mean_scales_exactly(values, k):
    mean = geometric_mean(values)
    assert mean == pytest.approx(np.exp(np.mean(np.log(values))), rel=1e-12)
    assert geometric_mean([v * 2.0**k for v in values]) == mean * 2.0**k
    assert geometric_mean([0.0, -1.0, np.inf]) is None
