"""Regions in the coordinates (c, ξ): enclosures, what they claim, and what is rejected."""

import json

import numpy as np
import pytest
import sympy as sp
from helpers.constructed import EXAMPLES, make_design, mechanical
from scipy.integrate import solve_ivp

from necc_casadi.casimirs.find import find_casimirs
from necc_casadi.certificate.checker.check import check
from necc_casadi.certificate.claims import statements
from necc_casadi.certificate.claims.certificate import Certificate
from necc_casadi.certificate.claims.regions import ChartRegion
from necc_casadi.certificate.prover.arithmetic.intervals import Interval
from necc_casadi.certificate.prover.arithmetic.potential import Potential
from necc_casadi.certificate.prover.certify import certify
from necc_casadi.certificate.prover.region.chart import Chart
from necc_casadi.lyapunov.networks import Network
from necc_casadi.lyapunov.parameterization import Form
from necc_casadi.model.model_file import load_model
from necc_casadi.simulation.convergence import converging

#: Together longer than the quick suite can afford; CI runs them.
pytestmark = pytest.mark.slow


#: Where the relative attitude of plant and controller makes the Casimirs good coordinates.
XI = np.array([-0.776, -0.574, -0.473])


def quadratic_weights(kappa, middle) -> list[float]:
    """½ Σ κᵢ(vᵢ − oᵢ)²: the affine part is zero."""
    return [*np.zeros(len(middle) + 1), *kappa, *middle]


@pytest.fixture(scope="module")
def satellite():
    """Three nonlinear Casimirs; K and Hc are quadratic with their minima at the target."""
    model = load_model(EXAMPLES / "satellite.py", {})
    target = (sp.pi / 6, sp.pi / 8, -sp.pi / 5, 0, 0, 0)
    casimirs = find_casimirs(
        model.loop, model.casimirs, dict(zip(model.loop.plant.x, target, strict=True))
    )
    at = dict(zip(model.loop.z, [*target, *XI], strict=True))
    c = [float(sp.N(f.subs(at))) for f in casimirs.functions]
    form = Form(Network(3, (), quadratic=True), Network(3, (), quadratic=True))
    weights = [*quadratic_weights([1.2, 1, 1.1], XI), *quadratic_weights([4, 4.5, 5], c)]
    return make_design(
        model.loop.plant, target, form, weights, XI, casimirs=casimirs, loop=model.loop
    )


@pytest.fixture(scope="module")
def folder(satellite, tmp_path_factory):
    path = tmp_path_factory.mktemp("satellite")
    satellite.save(path / "design.json")
    (path / "certificate.json").write_text(certify(satellite).to_json(), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def certificate(folder) -> Certificate:
    return Certificate.from_json((folder / "certificate.json").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def chart(satellite) -> Chart:
    region_of = [0, 1, 2, 6, 7, 8]
    lo, hi = satellite.z_star[region_of] - 1.2, satellite.z_star[region_of] + 1.2
    made = Chart.at(Potential(satellite, (3, 4, 5)), satellite.z_bar[region_of], lo, hi)
    assert made is not None
    return made


@pytest.mark.slow
def test_satellite_has_a_region_that_the_checker_confirms(folder, certificate):
    assert certificate.certified
    assert isinstance(certificate.region, ChartRegion)
    claim = next(c for c in certificate.claims if c.name == "region")
    assert "every solution from Ω converges to z̄" in claim.statement
    reach = {k: v for k, v in claim.data.items() if k.startswith("reach_")}
    assert len(reach) == 6
    assert min(reach.values()) > 0.35
    results = check(folder)
    assert all(result.holds for result in results), results


def shrunk(shells):
    return [0.2 * v for v in shells]


@pytest.mark.parametrize(
    ("field", "change"),
    [
        ("level", lambda v: v + 0.05),
        ("a", lambda v: 0.98 * v),
        ("b", lambda v: 0.98 * v),
        ("nu_k", lambda v: [1.1 * x for x in v]),
        ("nu_h", lambda v: [1.1 * x for x in v]),
        ("above", lambda v: 0.5 * v),
        ("radii_k", shrunk),
        ("center", lambda v: [v[0] + 0.05, *v[1:]]),
        ("middle", lambda v: [v[0] + 0.05, *v[1:]]),
        ("scale_k", lambda v: [[1.05 * x for x in row] for row in v]),
        ("scale_h", lambda v: [[1.05 * x for x in row] for row in v]),
        ("fibre", lambda v: [[lo + 0.2 * (hi - lo), hi] for lo, hi in v]),
    ],
)
def test_no_field_can_be_loosened(folder, tmp_path, field, change):
    data = json.loads((folder / "certificate.json").read_text(encoding="utf-8"))
    data["region"][field] = change(data["region"][field])
    data["level"] = data["region"]["level"]
    (tmp_path / "certificate.json").write_text(json.dumps(data), encoding="utf-8")
    (tmp_path / "design.json").write_bytes((folder / "design.json").read_bytes())
    assert not {r.name: r.holds for r in check(tmp_path)}["region"]


def on_another_yaw(data):
    """The box moved to where the Casimirs take the same values a turn of yaw away."""
    data["region"]["fibre"][2] = [v + 2 * np.pi for v in data["region"]["fibre"][2]]


def reversed_box(data):
    data["region"]["fibre"] = [side[::-1] for side in data["region"]["fibre"]]


def higher_beside_another_centre(data):
    """Growth around c̄, but a height above a point where V is larger: Ω would leave the domain."""
    data["region"]["center"][2] -= 0.8
    data["level"] = data["region"]["level"] = data["region"]["level"] + 0.8


def reach_from_another_centre(data):
    data["region"]["center"][0] -= 0.06
    next(c for c in data["claims"] if c["name"] == "region")["data"]["reach_roll"] *= 1.05


@pytest.mark.parametrize(
    "change",
    [on_another_yaw, reversed_box, higher_beside_another_centre, reach_from_another_centre],
)
def test_what_the_proof_takes_for_granted_is_checked(folder, tmp_path, change):
    """With the words that the changed numbers ask for."""
    data = json.loads((folder / "certificate.json").read_text(encoding="utf-8"))
    claim = next(c for c in data["claims"] if c["name"] == "region")
    change(data)
    claim["statement"] = statements.region(
        data["level"], data["domain_share"], data["limited_by"], "converges"
    )
    (tmp_path / "certificate.json").write_text(json.dumps(data), encoding="utf-8")
    (tmp_path / "design.json").write_bytes((folder / "design.json").read_bytes())
    assert not {r.name: r.holds for r in check(tmp_path)}["region"]


def test_states_of_the_region_converge(satellite, certificate):
    """A second route: what is simulated from the region, momenta included, comes to z̄."""
    region, rng = certificate.region, np.random.default_rng(4)
    level, n = region.level, satellite.loop.n
    states = []
    while len(states) < 60:
        z = satellite.z_bar + rng.normal(size=n) * 0.3
        if region.contains(satellite.V, z):
            assert satellite.V(z) <= level
            assert np.linalg.norm(np.asarray(satellite.lyapunov.gradient(z), float)) > 1e-4
            states.append(z)
    assert converging(satellite, np.array(states)).arrived.all()


def test_the_fibre_has_no_fold_where_none_is_found(chart):
    """|α| is within its bounds on every cell, and ∂α/∂q keeps the sign of its determinant."""
    a = 0.4
    fibre = chart.fold.cover(chart._fibre_box(a), chart.center[:3], a)
    rng, terms = np.random.default_rng(1), chart.potential.design.lyapunov.terms
    signs = set()
    for index in rng.choice(len(fibre.least), 40):
        q = rng.uniform(fibre.cells.lo[index], fibre.cells.hi[index])
        z = np.concatenate([q, np.zeros(3), chart.center[3:]])
        c = np.asarray(terms.c(z), float).ravel() - chart.fold.middle
        length = np.linalg.norm(chart.fold.scale @ c)
        assert fibre.least[index] <= length <= fibre.most[index]
        slopes = [
            (np.asarray(terms.c(z + h), float) - np.asarray(terms.c(z - h), float)).ravel() / 2e-6
            for h in 1e-6 * np.eye(9)[:3]
        ]
        signs.add(float(np.sign(np.linalg.det(np.array(slopes)))))
    assert len(signs) == 1


def test_motions_along_the_casimirs_stay_in_their_box(chart):
    """Against an adaptive integrator, in random directions; the Casimirs do not change."""
    transport, b, a = chart.transport, 0.4, 0.2
    fibre = chart.fold.cover(chart._fibre_box(a), chart.center[:3], a)
    radii = np.linspace(0, b, 9)
    box = transport.hull(radii, [fibre.within(a)] * 8, *chart._room())
    A, B = (
        sp.lambdify([list(s)], m)
        for s, m in ((transport.q, transport.along), (transport.xi, transport.across))
    )
    rng, terms = np.random.default_rng(2), chart.potential.design.lyapunov.terms
    back = np.linalg.inv(transport.scale)

    def casimirs(q, xi):
        return np.asarray(terms.c(np.concatenate([q, np.zeros(3), xi])), float).ravel()

    for _ in range(25):
        v = rng.normal(size=3)
        way = back @ v / np.linalg.norm(v)
        index = int(rng.choice(np.flatnonzero(fibre.most <= a)))
        q0 = fibre.cells.mid[index]

        def rate(s, q, way=way):
            return np.array(A(q)) @ np.linalg.solve(np.array(B(transport.xi_bar + s * way)), way)

        found = solve_ivp(rate, (0, b), q0, rtol=1e-9, atol=1e-11).y
        assert (found >= box.lo[:, None]).all()
        assert (found <= box.hi[:, None]).all()
        end = casimirs(found[:, -1], transport.xi_bar + b * way)
        assert end == pytest.approx(casimirs(q0, transport.xi_bar), abs=1e-7)


def test_linear_casimirs_and_quadratic_networks_reach_the_border_of_the_domain():
    """V is a quadratic form and motions are parallel: c is known by hand."""
    plant = mechanical(lambda q1, q2, p1, p2: (p1**2 + p2**2) / 2, 2)
    form = Form(Network(2, (), quadratic=True), Network(2, (), quadratic=True))
    weights = [*quadratic_weights([1.0, 1.0], [0, 0]), *quadratic_weights([1.0, 1.0], [0, 0])]
    certificate = certify(make_design(plant, [0] * 4, form, weights, [0.0, 0.0]))
    assert certificate.region.method == "chart"
    # ∇²V = [[1, −1], [−1, 2]] for each joint, whose inverse has the diagonal (2, 1): ρ² = 2²/2
    assert 0.6 < certificate.level <= 1.0
    data = next(c for c in certificate.claims if c.name == "region").data
    assert data["reach_q1"] <= np.sqrt(4 * certificate.level)
    assert data["reach_xi1"] == pytest.approx(np.sqrt(2 * certificate.level), rel=0.05)
    # the unit ball in four dimensions has the volume π²/2; det ∇²V = 1
    assert data["volume"] <= np.pi**2 / 2 * (2 * certificate.level) ** 2
    assert data["volume"] >= 0.7 * np.pi**2 / 2 * (2 * certificate.level) ** 2


def test_a_box_of_the_fibre_that_holds_a_fold_is_refused(chart):
    lo, hi = chart.center[:3] - 2.5, chart.center[:3] + 2.5
    assert chart.fold.cover(Interval(lo, hi), chart.center[:3], 5.0) is None
