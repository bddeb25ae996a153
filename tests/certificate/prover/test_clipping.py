"""Clipped inputs: V falls with them as far as is claimed, and nothing looser is accepted."""

import copy
import dataclasses
import json

import numpy as np
import pytest
from helpers.certificates import claim, verdicts, written
from helpers.constructed import full_damping, quadratic_pendulum
from scipy.integrate import solve_ivp
from scipy.optimize import minimize

from necc_casadi.certificate.claims import statements
from necc_casadi.certificate.prover.certify import certify
from necc_casadi.model.closed_loop import interconnect
from necc_casadi.simulation.saturated import saturated_field

LIMITS = (-2.5, 1.0)


def limited(design, *pairs):
    plant = dataclasses.replace(design.loop.plant, u_limits=pairs)
    return dataclasses.replace(design, loop=interconnect(plant, design.loop.controller))


def undamped(design, z) -> float:
    """−Gcᵀ∇Hc: what u is where 𝒢ᵀ∇V vanishes."""
    still = dataclasses.replace(design, damping=1e-12 * np.eye(2))
    return float(still.control(z[:2], z[2:])[0][0])


def clipped_field(design, z):
    """The plant under a clipped input, and the controller as it is."""
    q, p, xi = z
    u, xi_dot = design.control([q, p], [xi])
    return np.array([p, -np.sin(q) + np.clip(u[0], *LIMITS), xi_dot[0]])


@pytest.fixture(scope="module")
def made():
    return limited(quadratic_pendulum(), LIMITS)


@pytest.fixture(scope="module")
def certificate(made):
    return certify(made)


def inside(made, certificate, count, share):
    """Random states of Ω below the level, above a share of its height."""
    rng, found = np.random.default_rng(5), []
    sides = np.array(list(certificate.reach.values()))
    bottom = made.V(made.z_bar)
    height = certificate.level_clipped - bottom
    while len(found) < count:
        z = rng.uniform(sides[:, 0], sides[:, 1])
        level = made.V(z) - bottom
        if share * height < level <= height and certificate.contains(made.V, z):
            found.append(z)
    return found


def test_the_level_is_close_to_the_largest(made, certificate):
    """c_y against the least V where −Gcᵀ∇Hc reaches a limit, found by optimisation."""
    least = np.inf
    for limit in LIMITS:
        surface = {"type": "eq", "fun": lambda z, at=limit: undamped(made, z) - at}
        for start in np.random.default_rng(0).normal(made.z_bar, 0.5, (5, 3)):
            found = minimize(made.V, start, method="SLSQP", constraints=[surface])
            least = min(least, found.fun) if found.success else least
    bottom = made.V(made.z_bar)
    most = min(least, certificate.level) - bottom
    assert 0.9 * most < certificate.level_clipped - bottom <= most
    assert certificate.level_clipped > certificate.level_u


def test_V_falls_with_clipped_inputs(made, certificate):
    """Over random states; at many of them the input is clipped."""
    clipped = 0
    for z in inside(made, certificate, 1500, 0.0):
        u = made.control(z[:2], z[2:])[0][0]
        clipped += not LIMITS[0] <= u <= LIMITS[1]
        slope = np.asarray(made.lyapunov.gradient(z)).ravel()
        assert slope @ clipped_field(made, z) <= 1e-12
    assert clipped > 75


def test_solutions_with_clipped_inputs_converge(made, certificate):
    for start in inside(made, certificate, 4, 0.8):
        found = solve_ivp(lambda t, z: clipped_field(made, z), (0, 60), start, rtol=1e-7, atol=1e-9)
        assert np.abs(found.y[:, -1] - made.z_bar).max() < 0.02


def test_the_checker_proves_it_again_and_nothing_more(made, certificate, tmp_path):
    folder = written(made, tmp_path / "made")
    assert verdicts(folder)["clipping"]
    stored = json.loads((folder / "certificate.json").read_text(encoding="utf-8"))
    height = claim(stored, "clipping")["data"]["level_above_minimum"]

    def raised(data, share):
        data["level_clipped"] += share * height
        other = claim(data, "clipping")
        other["data"]["level_above_minimum"] = height * (1 + share)
        other["statement"] = statements.clipping([LIMITS], height * (1 + share), False, False)

    for share in (0.2, 1.0, 10.0):
        data = copy.deepcopy(stored)
        raised(data, share)
        (folder / "certificate.json").write_text(json.dumps(data), encoding="utf-8")
        assert not verdicts(folder)["clipping"], share


def coupled(made):
    """The same with a damping that is coupled with ξ and has a skew part."""
    return dataclasses.replace(made, damping=full_damping(made.damping))


def test_a_coupled_damping_is_scaled(made, tmp_path):
    """The claim is the same, about another law; the level needs no damping and is the same."""
    scaled = coupled(made)
    certificate = certify(scaled)
    assert certificate.level_clipped > certificate.level_u
    folder = written(scaled, tmp_path / "coupled")
    found = claim(json.loads((folder / "certificate.json").read_text("utf-8")), "clipping")
    assert found["holds"]
    assert "scaling all of its damping injection" in found["statement"]
    assert verdicts(folder)["clipping"]

    field, lost = saturated_field(scaled), 0
    for z in inside(scaled, certificate, 600, 0.0):
        u = scaled.control(z[:2], z[2:])[0][0]
        lost += not LIMITS[0] <= u <= LIMITS[1]
        slope = np.asarray(scaled.lyapunov.gradient(z)).ravel()
        rate = np.asarray(field(z), float).ravel()
        assert slope @ rate <= 1e-12
        resting = np.asarray(scaled.limited_controller.call([z[:2], z[2:]])[0], float)
        assert LIMITS[0] <= resting[0, 0] <= LIMITS[1]
    assert lost > 30
    for start in inside(scaled, certificate, 3, 0.8):
        ode = lambda t, z: np.asarray(field(z), float).ravel()  # noqa: E731
        end = solve_ivp(ode, (0, 60), start, rtol=1e-7, atol=1e-9).y[:, -1]
        assert np.abs(end - scaled.z_bar).max() < 0.02


@pytest.mark.parametrize("is_coupled", [True, False])
def test_the_claim_is_about_the_law_of_the_code(made, tmp_path, is_coupled):
    """Clipping of a coupled damping is not accepted, nor that a diagonal one is scaled."""
    folder = written(coupled(made) if is_coupled else made, tmp_path / "made")
    path = folder / "certificate.json"
    data = json.loads(path.read_text("utf-8"))
    said = claim(data, "clipping")
    height, whole = said["data"]["level_above_minimum"], data["level_clipped"] == data["level"]
    said["statement"] = statements.clipping([LIMITS], height, whole, not is_coupled)
    path.write_text(json.dumps(data), encoding="utf-8")
    assert not verdicts(folder)["clipping"]
