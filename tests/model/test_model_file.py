"""Model files: every structural fault by its code word, exact numbers, parameters, overrides."""

import contextlib
import io

import numpy as np
import pytest
import sympy as sp
from helpers.models import BASE, FAULTS
from helpers.problems import PENDULUM

from necc_casadi.errors import InputError, ModelError, OptionError
from necc_casadi.model.file_entries import damping_matrix
from necc_casadi.model.model_file import load_model

IDS = [f"{code}: {text[:40]}" for code, text, *_ in FAULTS]


def model(tmp_path, text):
    path = tmp_path / "model.py"
    path.write_text(BASE + text + "\n", encoding="utf-8")
    return path


@pytest.mark.parametrize(("code", "text", "piece"), FAULTS, ids=IDS)
def test_each_fault_has_its_code_and_two_lines(tmp_path, code, text, piece):
    from necc_casadi.casimirs.find import find_casimirs

    def read():
        made = load_model(model(tmp_path, text))
        find_casimirs(made.loop, made.casimirs)

    with pytest.raises(InputError) as caught:
        read()
    assert caught.value.code == code
    assert piece in caught.value.fault
    assert "\n" not in caught.value.fault
    assert caught.value.remedy
    assert "\n" not in caught.value.remedy


def test_the_good_model_is_good(tmp_path):
    assert load_model(model(tmp_path, "")).loop.plant.states == ("q", "p")


def test_decimals_in_the_file_are_exact(tmp_path):
    text = "H = 0.1 * p**2 + 2.5e-3 * (1 - sp.cos(0.3 * q))"
    H = load_model(model(tmp_path, text)).loop.plant.H
    q, p = sp.symbols("q p", real=True)
    assert not H.atoms(sp.Float)
    expected = p**2 / 10 + sp.Rational(1, 400) * (1 - sp.cos(sp.Rational(3, 10) * q))
    assert sp.expand(H - expected) == 0


def test_symbols_need_no_assumptions_and_may_be_given_in_many_ways(tmp_path):
    """Positive, plain or real symbols; lists, arrays and one-column matrices: the same plant."""
    reference = load_model(PENDULUM).loop
    text = """
import numpy as np
q, p = sp.Symbol("q", positive=True), sp.Symbol("p")
x = [q, p]
J = np.array([[0, 1], [-1, 0]])
R = [[0, 0], [0, 0]]
G = [0, 1]
H = p**2 / 2 + 1 - sp.cos(q)
"""
    loop = load_model(model(tmp_path, text)).loop
    assert loop.z == reference.z
    assert (loop.M, loop.ports, loop.plant.H) == (reference.M, reference.ports, reference.plant.H)


def test_parameters_and_overrides_are_exact(tmp_path):
    path = model(tmp_path, 'k = sp.Symbol("k"); H = p**2 / 2 + k * q**2; params = {k: 0.1}')
    q, p = sp.symbols("q p", real=True)
    cases = [({}, "1/10"), ({"k": "pi/4"}, "pi/4"), ({"k": "0.3"}, "3/10")]
    for override, stiffness in cases:
        H = load_model(path, override).loop.plant.H
        assert p**2 / 2 + sp.sympify(stiffness) * q**2 == H


@pytest.mark.parametrize(
    "override", [{"b": "1"}, {"k": ""}, {"k": "q"}, {"k": "1e400"}, {"k": "x"}]
)
def test_bad_overrides(tmp_path, override):
    path = model(tmp_path, 'k = sp.Symbol("k"); H = p**2 / 2 + k * q**2; params = {k: 1}')
    with pytest.raises(ModelError) as caught:
        load_model(path, override)
    assert caught.value.code == "param"


def test_what_the_file_prints_does_not_reach_stdout(tmp_path):
    path = model(tmp_path, 'print("hello")')
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        load_model(path)
    assert (out.getvalue(), err.getvalue()) == ("", "hello\n")


def test_a_file_may_import_its_neighbour(tmp_path):
    (tmp_path / "neighbour_of_the_model.py").write_text("stiffness = 3\n")
    path = model(tmp_path, "from neighbour_of_the_model import stiffness; H = H + stiffness * q**2")
    q = sp.Symbol("q", real=True)
    assert load_model(path).loop.plant.H.coeff(q, 2) == 3


def test_optional_names(tmp_path):
    text = """
xi = sp.symbols("a b")
Jc = [[0, 1], [-1, 0]]
Gc = [1, 0]
D, Dc = 2, [[3]]
u_limits = [(-1, 2.5)]
domain = {q: (-1, 2), "a": (-3, 3)}
units = {q: "rad"}
name = "Mine"
target = {q: sp.pi / 3}
"""
    made = load_model(model(tmp_path, text))
    plant, controller = made.loop.plant, made.loop.controller
    assert controller.states == ("a", "b")
    assert controller.Rc.is_zero_matrix
    assert np.array_equal(made.D, [[2.0]])
    assert np.array_equal(made.Dc, [[3.0]])
    assert plant.u_limits == ((-1.0, 2.5),)
    assert plant.domain == {"q": (-1, 2), "a": (-3, 3)}
    assert (plant.units, plant.name) == ({"q": "rad"}, "Mine")
    assert made.target == {"q": sp.pi / 3}


@pytest.mark.parametrize("content", [b"\xff\xfe", b"x = 1\0", b""])
def test_files_that_are_no_model(tmp_path, content):
    path = tmp_path / "model.py"
    path.write_bytes(content)
    with pytest.raises(ModelError) as caught:
        load_model(path)
    assert caught.value.code == "model_file"


@pytest.mark.parametrize("name", ["missing.py", "."])
def test_paths_that_are_no_file(tmp_path, name):
    with pytest.raises(ModelError) as caught:
        load_model(tmp_path / name)
    assert caught.value.code == "model_file"


def test_damping_in_its_three_forms():
    assert np.array_equal(damping_matrix(2.0, 2, "D"), 2 * np.eye(2))
    assert np.array_equal(damping_matrix([1.0, 3.0], 2, "D"), np.diag([1.0, 3.0]))
    full = [[2.0, 1.0], [1.0, 2.0]]
    assert np.array_equal(damping_matrix(full, 2, "D"), full)


@pytest.mark.parametrize(
    "value", [0.0, -1.0, float("nan"), float("inf"), [1.0, 2.0, 3.0], [[1.0, 2.0], [2.0, 1.0]],
              [[1.0, 0.5], [0.4, 1.0]], []]
)  # fmt: skip
def test_damping_that_does_not_take_energy_out(value):
    with pytest.raises(OptionError) as caught:
        damping_matrix(np.array(value), 2, "--damping")
    assert caught.value.code == "usage"


def test_weights_of_the_cost(tmp_path):
    path = tmp_path / "weighted.py"
    text = PENDULUM.read_text(encoding="utf-8")
    path.write_text(f"{text}\nstate_cost = [4, sp.Rational(1, 2)]\ninput_cost = 3\n", "utf-8")
    made = load_model(path)
    assert np.array_equal(made.state_cost, np.diag([4, 0.5]))
    assert np.array_equal(made.input_cost, [[3.0]])
    plain = load_model(PENDULUM)
    assert (plain.state_cost, plain.input_cost) == (None, None)
    for line in ("state_cost = -1", "input_cost = 0", "state_cost = [1, 2, 3]", "input_cost = 'u'"):
        path.write_text(f"{text}\n{line}\n", "utf-8")
        with pytest.raises(ModelError, match=line.split()[0]) as caught:
            load_model(path)
        assert caught.value.code == "model_file"


@pytest.mark.parametrize("pair", ["(1, -1)", "(-1, sp.oo)", "(1,)", "('a', 2)"])
def test_limits_are_pairs_of_finite_numbers(tmp_path, pair):
    path = tmp_path / "plant.py"
    own = PENDULUM.read_text(encoding="utf-8")
    path.write_text(f"{own}\nu_limits = [{pair}]\n", encoding="utf-8")
    with pytest.raises(ModelError) as refusal:
        load_model(path)
    assert refusal.value.code == "limits"
