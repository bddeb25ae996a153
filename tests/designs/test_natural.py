"""A design in natural units: exact, and the same loop by a second route."""

import numpy as np
import pytest
import sympy as sp
from helpers.models import BASE
from helpers.problems import CART_AND_CRANE, problem, solve

from necc_casadi.casimirs.condition import rates
from necc_casadi.designs.design import Design
from necc_casadi.designs.error_bound import loss, natural_loss
from necc_casadi.model.model_file import load_model
from necc_casadi.synthesis.options import Options

SMALL = {"hidden_k": (8,), "hidden_h": (6,)}
SPRING = BASE + "H = p**2 / 600 + 200000 * q**2 / 2\n"
HEAVY = CART_AND_CRANE.replace("k = 0.5", "").replace(
    "H = p1", "H = 30000 * q2**4 + 3000 * sp.cos(q1) + p1"
)
FORMS = {
    "joint": {},
    "beta-sum": {"casimir_form": "sum", "activation": "sin", "hidden_h": (4, 3)},
    "neural": {"phi": "neural"},
    "paper": {"natural_units": False, "quadratic": False, "casimir_form": "sum", "a": 1e-3},
}


@pytest.fixture(scope="module", params=["spring", "crane"])
def task(request, tmp_path_factory):
    path = tmp_path_factory.mktemp("models") / "model.py"
    text, target = {"spring": (SPRING, "q=0.05"), "crane": (HEAVY, "q1=pi/3,q2=-0.05")}[
        request.param
    ]
    path.write_text(text, encoding="utf-8")
    return problem(load_model(path), target)


@pytest.fixture(scope="module", params=FORMS)
def made(task, request) -> Design:
    return solve(task, Options(**SMALL | FORMS[request.param]))


def points(made, count=5):
    rng = np.random.default_rng(0)
    return made.z_star + rng.uniform(-1, 1, (count, made.loop.n)) * made.sizes.state


def test_values_derivatives_and_motion_are_those_of_the_model(made):
    """V, ∇V, ∇²V, u and ż of both designs at the same states, by both sets of functions."""
    natural, units = made.natural, made.units
    S, E, T, U = units.state, units.energy, units.time, units.input
    n = made.loop.plant.n
    assert not units.are_ones
    for z in points(made):
        w = z / S
        one, other = made.lyapunov, natural.lyapunov

        def close(got, expected):
            got, expected = np.asarray(got, float), np.asarray(expected, float)
            np.testing.assert_allclose(got, expected, rtol=1e-10, atol=1e-12 * abs(expected).max())

        close(other.V(w), np.asarray(one.V(z)) / E)
        close(
            np.asarray(other.gradient(w), float).ravel(),
            np.asarray(one.gradient(z), float).ravel() * S / E,
        )
        close(other.hessian(w), np.asarray(one.hessian(z)) * np.outer(S, S) / E)
        close(
            np.asarray(other.vector_field(w), float).ravel(),
            np.asarray(one.vector_field(z), float).ravel() * T / S,
        )
        close(natural.control(w[:n], w[n:])[0], made.control(z[:n], z[n:])[0] / U)


def test_the_spectrum_is_that_of_the_model_in_natural_time(made):
    S = made.units.state
    A = made.lyapunov.linearisation(made.z_bar) * np.outer(1 / S, S)
    expected = np.sort_complex(np.linalg.eigvals(A))
    np.testing.assert_allclose(np.sort_complex(made.spectrum), expected, rtol=1e-7, atol=1e-9)


def test_the_scaled_model_is_port_hamiltonian_and_its_casimirs_are_casimirs(made):
    loop = made.natural.loop
    assert (loop.J + loop.J.T).expand().is_zero_matrix
    assert (loop.R - loop.R.T).is_zero_matrix
    assert all(sp.simplify(r) == 0 for c in made.natural.casimirs.functions for r in rates(c, loop))
    assert [float(sp.N(v)) for v in made.natural.x_star] == pytest.approx(
        made.z_star[: made.loop.plant.n] / made.units.state[: made.loop.plant.n]
    )


def test_weights_and_damping_differ_by_powers_of_two_alone(made):
    natural = made.natural
    for one, other in ((made.weights, natural.weights), (made.damping, natural.damping)):
        used = one != 0
        assert np.all(np.frexp(one[used] / other[used])[0] == 0.5)
        assert np.all(other[~used] == 0)


def test_sizes_survive_the_file_bit_for_bit_and_older_files_are_in_the_models_units(made):
    again = Design.from_text(made.text)
    for name in ("sizes", "units"):
        one, other = getattr(made, name), getattr(again, name)
        assert one.state.tolist() == other.state.tolist()
        assert (one.energy, one.time, one.guessed) == (other.energy, other.time, other.guessed)
    assert again.curvature.tolist() == made.curvature.tolist()
    old = Design.from_text(older(made))
    assert old.natural is old
    assert old.sizes.are_ones
    assert old.curvature.tolist() == [made.a] * made.loop.n
    assert old.lyapunov.V(made.z_star) == made.lyapunov.V(made.z_star)


def older(made) -> str:
    import json

    data = json.loads(made.text)
    for name in ("sizes", "units", "curvature"):
        del data[name]
    return json.dumps(data)


@pytest.mark.parametrize(
    ("edit", "piece"),
    [
        (lambda d: d["units"].update(energy=(3.0).hex()), "powers of two"),
        (lambda d: d["units"]["state"].__setitem__(0, (-2.0).hex()), "positive"),
        (lambda d: d["sizes"].update(time=(0.0).hex()), "positive"),
        (lambda d: d["sizes"]["state"].pop(), "shape"),
        (lambda d: d["units"]["input"].__setitem__(0, float("inf").hex()), "finite"),
    ],
)
def test_units_that_are_none_are_refused(default_design, edit, piece):
    import json

    from necc_casadi.errors import OutputError

    data = json.loads(default_design.text)
    edit(data)
    with pytest.raises(OutputError, match=piece):
        Design.from_text(json.dumps(data))


def test_the_default_curvature_is_asked_in_natural_units(task):
    made = solve(task, Options(**SMALL))
    assert natural_loss(made) <= 1e-9
    share = made.curvature / made.sizes.measured_in(made.units).stiffness
    assert share == pytest.approx(np.full(share.size, share[0]))
    assert share[0] <= 0.5
    assert made.a == pytest.approx((made.curvature * made.units.energy / made.units.state**2).min())


def test_a_given_curvature_is_meant_in_the_models_units(task):
    a = 0.3 * task.verdict.a_max
    made = solve(task, Options(a=a, **SMALL))
    assert made.a == a
    hessian = np.asarray(made.lyapunov.hessian(made.z_star))
    assert np.linalg.eigvalsh(hessian)[0] >= a * (1 - 1e-9)
    assert loss(made) <= 1e-6 * np.abs(hessian).max()
