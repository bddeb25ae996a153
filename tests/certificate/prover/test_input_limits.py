"""Input limits: levels known by hand, simulation from their boundary, and nothing looser."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
import sympy as sp
from helpers.constructed import (
    full_damping,
    make_design,
    mechanical,
    quadratic_pendulum,
    trained_like_pendulum,
)
from scipy.optimize import minimize

from necc_casadi.certificate.checker.check import check
from necc_casadi.certificate.checker.evidence import Evidence
from necc_casadi.certificate.checker.input_limits import check_input_limits
from necc_casadi.certificate.checker.model import StoredDesign
from necc_casadi.certificate.checker.region.region import region_proof
from necc_casadi.certificate.claims.fields import Fields
from necc_casadi.certificate.prover.certify import certify
from necc_casadi.designs.design import Design
from necc_casadi.errors import OutputError
from necc_casadi.lyapunov.networks import MonotonePhi, Network
from necc_casadi.lyapunov.parameterization import Form
from necc_casadi.model.closed_loop import interconnect
from necc_casadi.model.control_affine import Preliminary
from necc_casadi.simulation.responses import simulate

#: Together longer than the quick suite can afford; CI runs them.
pytestmark = pytest.mark.slow

QUADRATIC = Form(Network(1, (), quadratic=True), Network(1, (), quadratic=True))


def limited(design: Design, *pairs) -> Design:
    plant = dataclasses.replace(design.loop.plant, u_limits=pairs)
    return dataclasses.replace(design, loop=interconnect(plant, design.loop.controller))


def spring(*pairs) -> Design:
    """V = ½(q² + p²) + ½ξ² + ½(q − ξ)², u = −ξ − 5p."""
    plant = mechanical(lambda q, p: (p**2 + q**2) / 2, 1)
    return limited(
        make_design(plant, (0, 0), QUADRATIC, [0, 0, 1.0, 0, 0, 0, 1.0, 0], [0.0]), *pairs
    )


def coupled(*pairs) -> Design:
    """The same with a full damping: u sees ∂V/∂ξ too."""
    made = spring(*pairs)
    return dataclasses.replace(made, damping=full_damping(made.damping))


def fed_ahead(*pairs) -> Design:
    """The spring under u = p² + p/2 + ũ: the momentum enters u squared, and beside the damping."""
    plant = mechanical(lambda q, p: (p**2 + q**2) / 2, 1)
    u0 = sp.ImmutableMatrix([plant.x[1] ** 2 + plant.x[1] / 2])
    one = sp.ImmutableMatrix([[1]])
    ahead = Preliminary(plant.flow - plant.G * u0, plant.G, u0, one)
    made = make_design(
        dataclasses.replace(plant, preliminary=ahead),
        (0, 0),
        QUADRATIC,
        [0, 0, 1.0, 0, 0, 0, 1.0, 0],
        [0.0],
    )
    return limited(made, *pairs)


def chain(*pairs) -> Design:
    """Three coupled masses, whose region is an ellipsoid; V is quadratic."""
    plant = mechanical(
        lambda q1, q2, q3, p1, p2, p3: (
            (p1**2 + p2**2 + p3**2 + q1**2 + (q2 - q1) ** 2 + (q3 - q2) ** 2) / 2
        ),
        3,
        inputs=[0],
    )
    design = make_design(plant, [0] * 6, QUADRATIC, [0, 0, 1.0, 0, 0, 0, 1.0, 0], [0.0])
    return limited(design, *pairs)


def neural() -> Design:
    base = trained_like_pendulum((16,), quadratic=True, phi=MonotonePhi(4))
    return limited(base, (-3.0, 3.0))


def of_quadratic(design: Design, bound: float) -> float:
    """max bᵀz on ½zᵀPz ≤ c is √(2c bᵀP⁻¹b)."""
    V, z = design.lyapunov, np.zeros(design.loop.n)
    P = np.asarray(V.hessian(z), float)
    step = 1e-3 * np.eye(design.loop.n)
    n = design.loop.plant.n
    b = np.array([float(design.control(e[:n], e[n:])[0][0]) / 1e-3 for e in step])
    return float(bound**2 / (2 * b @ np.linalg.solve(P, b)))


def limits_claim(certificate):
    return {claim.name: claim for claim in certificate.claims}.get("input_limits")


def test_without_limits_nothing_is_said():
    certificate = certify(quadratic_pendulum())
    assert certificate.level_u is None
    assert limits_claim(certificate) is None


@pytest.mark.parametrize(("make", "share"), [(spring, 0.97), (coupled, 0.9), (chain, 0.85)])
def test_level_of_a_quadratic_is_the_one_known_by_hand(make, share):
    bound = 0.8 if make is chain else 1.5
    design = make((-bound, 9.0))
    by_hand = of_quadratic(design, bound)
    certificate = certify(design)
    assert certificate.certified
    assert limits_claim(certificate).holds
    assert share * by_hand < certificate.level_u <= by_hand
    assert by_hand < certificate.level  # beyond, limits do no harm


def test_wide_limits_bind_nowhere_and_impossible_ones_everywhere():
    """Limits do harm later than they are met, and as late whatever the damping is."""
    made, full = certify(spring((-50, 50))), certify(coupled((-50, 50)))
    for each in (made, full):
        assert each.level_u < each.level_clipped == each.level
    assert full.level_clipped == pytest.approx(made.level_clipped, rel=1e-9)
    refused = certify(spring((0.5, 1.0)))  # u is 0 at rest
    assert refused.level_u is None
    assert not limits_claim(refused).holds
    assert refused.certified


def test_level_of_the_pendulum_is_close_to_the_largest():
    """c_u against the least V on the surface where u reaches a limit, found by optimisation."""
    design = limited(quadratic_pendulum(), (-2.5, 1.0))
    certificate = certify(design)
    least = np.inf
    for limit in (-2.5, 1.0):
        surface = {
            "type": "eq",
            "fun": lambda z, limit=limit: design.control(z[:2], z[2:])[0][0] - limit,
        }
        for start in np.random.default_rng(0).normal(design.z_bar, 0.5, (5, 3)):
            found = minimize(design.V, start, method="SLSQP", constraints=[surface])
            if found.success:
                least = min(least, found.fun)
    bottom = design.V(design.z_bar)
    assert 0.97 * (least - bottom) < certificate.level_u - bottom <= least - bottom


@pytest.mark.parametrize("limits", [(-0.5, 9.0), (-9.0, 0.5), (-3.0, 20.0)])
def test_momenta_in_what_is_fed_ahead_are_bounded_by_the_room_below_the_level(limits):
    """For each q and p the states with V ≤ c have the ξ = q/2 ± √(c − p²/2 − 3q²/4)."""
    design = limited(fed_ahead(), limits)
    certificate = certify(design)
    assert limits_claim(certificate).holds
    assert design.control([0.0, 2.0], [0.0])[0][0] == pytest.approx(4 + 1 - 10)

    def range_of_u(level):
        q, p = np.meshgrid(*[np.linspace(-1, 1, 801) * np.sqrt(2 * level)] * 2)
        left = level - p**2 / 2 - 3 * q**2 / 4
        root = np.sqrt(np.where(left >= 0, left, np.nan))
        u = [p**2 + p / 2 - 5 * p - q / 2 - sign * root for sign in (1, -1)]
        return float(np.nanmin(u)), float(np.nanmax(u))

    for share, keeps in ((1.0, True), (2.5, False)):
        low, high = range_of_u(share * certificate.level_u)
        assert (limits[0] <= low and high <= limits[1]) is keeps


def test_nothing_is_claimed_where_a_higher_power_of_momenta_is_fed_ahead():
    design = fed_ahead((-9.0, 9.0))
    ahead = design.loop.plant.preliminary
    u0 = sp.ImmutableMatrix([design.loop.plant.x[1] ** 3])
    cubic = dataclasses.replace(ahead, u0=u0, f=design.loop.plant.flow - ahead.g * u0)
    plant = dataclasses.replace(design.loop.plant, preliminary=cubic)
    changed = dataclasses.replace(design, loop=interconnect(plant, design.loop.controller))
    assert not limits_claim(certify(changed)).holds


def test_neural_phi_and_networks_keep_the_bound():
    design = neural()
    certificate = certify(design)
    assert limits_claim(certificate).holds
    assert_kept(design, certificate, 3.0)


def test_nothing_is_claimed_where_the_momenta_reach_u_through_the_slope_of_phi():
    made = neural()
    full = dataclasses.replace(made, damping=full_damping(made.damping))
    assert limits_claim(certify(made)).holds
    assert not limits_claim(certify(full)).holds


def boundary(design: Design, level: float, count: int) -> np.ndarray:
    """States with V just below the level, along random rays from z̄."""
    rng, states = np.random.default_rng(1), []
    for ray in rng.normal(size=(count, design.loop.n)):
        low, high = 0.0, 1e-3
        while design.V(design.z_bar + high * ray) < level:
            low, high = high, 1.2 * high
        for _ in range(40):
            middle = (low + high) / 2
            inside = design.V(design.z_bar + middle * ray) < level
            low, high = (middle, high) if inside else (low, middle)
        states.append(design.z_bar + low * ray)
    return np.array(states)


def assert_kept(design: Design, certificate, bound: float) -> None:
    n = design.loop.plant.n
    for z in boundary(design, certificate.level_u, 20):
        response = simulate(design, z[:n], z[n:], points=201)
        assert response.converged
        assert response.peak_input <= bound


@pytest.mark.slow
@pytest.mark.parametrize("design", [spring((-1.5, 1.5)), coupled((-1.5, 1.5)), chain((-1.5, 1.5))])
def test_simulation_from_the_boundary_never_exceeds_the_limits(design):
    assert_kept(design, certify(design), 1.5)


def test_simulation_of_a_network_never_exceeds_the_limits():
    design = limited(trained_like_pendulum(quadratic=True), (-2.0, 2.0))
    certificate = certify(design)
    assert limits_claim(certificate).holds
    assert_kept(design, certificate, 2.0)


@pytest.fixture(
    scope="module",
    params=["spring", "coupled", "fed_ahead", "pendulum", "network", "neural", "chain"],
)
def folder(request, tmp_path_factory):
    folder = tmp_path_factory.mktemp(request.param)
    design = {
        "spring": lambda: spring((-1.5, 9.0)),
        "coupled": lambda: coupled((-1.5, 9.0)),
        "fed_ahead": lambda: fed_ahead((-1.5, 9.0)),
        "pendulum": lambda: limited(quadratic_pendulum(), (-2.5, 1.0)),
        "network": lambda: limited(trained_like_pendulum(quadratic=True), (-2.0, 2.0)),
        "neural": neural,
        "chain": lambda: chain((-0.8, 9.0)),
    }[request.param]()
    return written(design, folder)


def written(design: Design, folder: Path) -> Path:
    design.save(folder / "design.json")
    (folder / "certificate.json").write_text(certify(design).to_json(), encoding="utf-8")
    return folder


def rechecked(folder, change) -> bool:
    """The checker's word on the input limits alone, as if the region had just been proved."""
    data = json.loads((folder / "certificate.json").read_text(encoding="utf-8"))
    change(data)
    model = StoredDesign(json.loads((folder / "design.json").read_text(encoding="utf-8")))
    evidence = Evidence(model, Fields(data))
    region = evidence.certificate.region
    proof = None if region is None else region_proof(evidence, region)
    return check_input_limits(evidence, proof, True).holds


@pytest.mark.slow
def test_the_level_is_proved_again_and_a_raised_one_rejected(folder):
    bottom = json.loads((folder / "certificate.json").read_text(encoding="utf-8"))
    design = Design.load(folder)
    height = bottom["level_u"] - design.V(design.z_bar)

    def raised(data):
        data["level_u"] += 0.25 * height

    def above_the_region(data):
        data["level_u"] = data["level"] + 0.01

    def widened(data):
        data["level_u"] -= 2 * height  # below the minimum: empty, no claim

    assert rechecked(folder, lambda data: None)
    for change in (raised, above_the_region, widened):
        assert not rechecked(folder, change)


@pytest.fixture(scope="module")
def quick(tmp_path_factory):
    folder = tmp_path_factory.mktemp("quick")
    return written(limited(quadratic_pendulum(), (-2.5, 1.0)), folder)


def altered(folder, tmp_path, change) -> dict[str, bool]:
    data = json.loads((folder / "certificate.json").read_text(encoding="utf-8"))
    change(data)
    (tmp_path / "certificate.json").write_text(json.dumps(data), encoding="utf-8")
    (tmp_path / "design.json").write_bytes((folder / "design.json").read_bytes())
    return {result.name: result.holds for result in check(tmp_path)}


def test_a_level_without_its_claim_or_a_claim_without_a_level(quick, tmp_path):
    def unclaimed(data):
        data["claims"] = [c for c in data["claims"] if c["name"] != "input_limits"]
        data["level_u"] = data["level"]

    def unlevelled(data):
        data["level_u"] = None

    def absent(data):
        del data["level_u"]

    assert all(altered(quick, tmp_path, lambda data: None).values())
    for change in (unclaimed, unlevelled):
        result = altered(quick, tmp_path, change)
        assert not result["input_limits"]
        assert result["region"]
    with pytest.raises(OutputError):
        altered(quick, tmp_path, absent)
