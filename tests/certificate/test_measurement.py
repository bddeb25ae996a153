"""The claim about what is measured: proved, checked again, and true of other masses."""

import json
from dataclasses import replace

import numpy as np
import pytest
import sympy as sp
from helpers.certificates import claim, verdicts, written
from helpers.constructed import quadratic_pendulum

from necc_casadi.certificate.claims import statements
from necc_casadi.certificate.prover.certify import certify
from necc_casadi.certificate.prover.measurement import prove_measurement
from necc_casadi.certificate.prover.momenta import prove_momenta
from necc_casadi.designs.plant_file import plant_text
from necc_casadi.lyapunov.lyapunov import LyapunovFunction, make_terms
from necc_casadi.model.lagrangian import Plants
from necc_casadi.model.parametric import Parametric
from necc_casadi.simulation.responses import simulate


def pendulum(inertia=1):
    """A design that takes (q, q̇); its p is q̇ times 1."""
    made = quadratic_pendulum()
    plant = replace(made.loop.plant, inertia=sp.ImmutableMatrix([[inertia]]))
    return replace(made, loop=replace(made.loop, plant=plant))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return written(pendulum(), tmp_path_factory.mktemp("velocity"))


def test_it_is_proved_and_proved_again(folder):
    data = json.loads((folder / "certificate.json").read_text(encoding="utf-8"))
    assert claim(data, "measurement")["statement"] == statements.MEASURED_OF_ANY_MASS
    assert all(verdicts(folder).values())


def test_another_inertia_is_not_that_of_the_momenta(folder, tmp_path):
    wrong = pendulum(inertia=2)
    assert prove_measurement(wrong).holds is False
    wrong.save(tmp_path / "design.json")
    (tmp_path / "certificate.json").write_bytes((folder / "certificate.json").read_bytes())
    assert verdicts(tmp_path)["measurement"] is False


def test_no_claim_is_left_out_and_none_is_made_of_states(folder, tmp_path):
    """A design that measures states cannot borrow the claim."""
    made = quadratic_pendulum()
    assert prove_measurement(made) is None
    made.save(tmp_path / "design.json")
    (tmp_path / "certificate.json").write_bytes((folder / "certificate.json").read_bytes())
    assert verdicts(tmp_path)["measurement"] is False


def test_a_law_with_feedback_of_momenta_holds_for_one_inertia_only():
    made = pendulum()
    p = made.loop.plant.x[1]
    casimirs = replace(made.casimirs, functions=(made.casimirs.functions[0] + p,))
    changed = replace(made, casimirs=casimirs)
    assert prove_measurement(changed).statement == statements.MEASURED_OF_THIS_MASS


@pytest.mark.parametrize("mass", [0.25, 7.0])
def test_with_another_mass_the_V_of_its_energy_falls(mass):
    """Along the loop of another plant, its own V = H′ + Hc + C never rises."""
    made = pendulum()
    q, p = made.loop.plant.x
    other = replace(
        made.loop.plant,
        H=p**2 / (2 * sp.Rational(mass)) + 3 * (1 - sp.cos(q)),
        inertia=sp.ImmutableMatrix([[sp.Rational(mass)]]),
        R=sp.ImmutableMatrix(sp.diag(0, sp.Rational(1, 5))),
    )
    moved = replace(made, loop=replace(made.loop, plant=other))
    y, xi = [0.4, -1.3], [0.1]
    for wanted, found in zip(made.control(y, xi), moved.control(y, xi), strict=True):
        assert found == pytest.approx(wanted, rel=1e-14)
    response = simulate(moved, y, xi, time=20.0)
    assert np.diff(response.V).max() < 1e-8 * np.ptp(response.V)
    terms = make_terms(moved.loop, moved.casimirs)
    V = LyapunovFunction(terms, made.form, made.weights, made.damping)
    z, step = np.concatenate([moved.lyapunov.state(y), xi]), 1e-6
    rate = V.vector_field(z)
    slope = (V.V(z + step * rate) - V.V(z - step * rate)) / (2 * step)
    assert slope == pytest.approx(float(V.gradient(z) @ rate), rel=1e-6)
    assert slope < 0


def test_a_response_starts_and_is_told_as_it_is_measured():
    made = pendulum()
    moved = replace(
        made,
        loop=replace(
            made.loop,
            plant=replace(
                made.loop.plant,
                H=made.loop.plant.x[1] ** 2 / 8 + 1 - sp.cos(made.loop.plant.x[0]),
                inertia=sp.ImmutableMatrix([[4]]),
            ),
        ),
    )
    response = simulate(moved, [0.2, 0.5], time=1.0)
    assert response.z[0, :2] == pytest.approx([0.2, 2.0])
    assert response.shown[0, :2] == pytest.approx([0.2, 0.5])
    names = (*moved.measurement.names, *moved.loop.controller.states)
    head, first, *_ = response.csv(names).splitlines()
    assert head == "t,q,q_dot,xi1,u1,V"
    assert [float(v) for v in first.split(",")[1:3]] == pytest.approx([0.2, 0.5])


# --- momenta of other masses ---------------------------------------------------------------------


def fed(D, Dc, **ranges):
    """A pendulum that measures p, with D and Dc and a mass that is not known."""
    made = quadratic_pendulum()
    q, p = made.loop.plant.x
    m = sp.Symbol("m", real=True)
    plant = made.loop.plant
    formal = Parametric(
        plant.J, plant.R, plant.G, p**2 / (2 * m) + 1 - sp.cos(q), {"m": sp.Integer(1)}
    )
    known = {name: tuple(map(sp.sympify, side)) for name, side in ranges.items()}
    return replace(made, damping=np.diag([D, Dc]).astype(float)), Plants(formal, known)


@pytest.mark.parametrize("rho", [0.25, 4.0, 20.0])
def test_momenta_may_be_fed_up_to_the_mass_that_the_formula_says(rho):
    """(ρ − 1)² < 4ρDDc is what the intervals find, on both sides."""
    product = (rho - 1) ** 2 / (4 * rho)
    ends = {"m": sorted((sp.Rational(1), sp.Rational(rho)))}
    enough, plants = fed(1.5 * product, 1.0 / 1.4, **ends)
    assert prove_momenta(enough, plants).holds
    short, plants = fed(1.5 * product, 1.0 / 1.6, **ends)
    assert prove_momenta(short, plants).statement == statements.NO_MOMENTA


def test_V_falls_with_momenta_by_the_form_Q(tmp_path):
    """V̇ of the true plant, whose p goes to the law of the model, by the law itself."""
    made, plants = fed(2.0, 0.5, m=("1/2", "3"))
    assert prove_momenta(made, plants).holds
    V, rho = made.lyapunov, 3.0
    rng = np.random.default_rng(0)
    for _ in range(20):
        q, p, xi = rng.uniform(-2, 2, 3)
        u, xi_dot = V.control_law([q, p], [xi])  # thinks that q̇ is p
        rate = np.array([p / rho, -np.sin(q) + u[0], xi_dot[0]])
        at_rest = V.gradient([q, 0.0, xi])  # ∂V/∂q and ∂V/∂ξ do not see p
        slope = np.array([at_rest[0], p / rho, at_rest[2]])
        y, w, E = p / rho, at_rest[2], rho - 1
        assert slope @ rate == pytest.approx(-(2.0 * (1 + E) * y * y - E * w * y + 0.5 * w * w))
        assert slope @ rate < 0


def test_the_claim_about_momenta_is_proved_again(tmp_path):
    made, plants = fed(2.0, 0.5, m=("1/2", "3"))
    certificate = certify(made)
    claims = (*certificate.claims, prove_momenta(made, plants))
    made.save(tmp_path / "design.json")
    (tmp_path / "plant.json").write_text(plant_text(made, plants.parametric), encoding="utf-8")
    text = replace(certificate, claims=claims).to_json()
    (tmp_path / "certificate.json").write_text(text, encoding="utf-8")
    assert all(verdicts(tmp_path).values())
    wider = text.replace('"3"', '"30"').replace("m in [1/2, 3]", "m in [1/2, 30]")
    (tmp_path / "certificate.json").write_text(wider, encoding="utf-8")
    assert verdicts(tmp_path)["momenta"] is False


def test_nothing_is_said_of_velocities_or_of_underactuated_plants():
    assert prove_momenta(pendulum(), fed(1, 1, m=("1", "2"))[1]) is None
