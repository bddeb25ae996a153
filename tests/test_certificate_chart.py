"""Regions in the coordinates (c, ξ): enclosures, what they claim, and what is rejected."""

import json
from itertools import product

import mpmath
import numpy as np
import pytest
import sympy as sp
from certificate_designs import EXAMPLES, make_design, mechanical
from flint import arb
from hypothesis import given, settings
from hypothesis import strategies as st

from necc_casadi.casimirs import find_casimirs
from necc_casadi.certificate import certify
from necc_casadi.certificate.ball_energy import Energy
from necc_casadi.certificate.balls import ball, evaluate
from necc_casadi.certificate.chart import ChartRegion, _Chart, _spectral, _tensor
from necc_casadi.certificate.check_model import Model
from necc_casadi.certificate.checker import check
from necc_casadi.certificate.enclosures import Potential
from necc_casadi.certificate.intervals import Interval, point
from necc_casadi.certificate.proof import Certificate
from necc_casadi.lyapunov import Form
from necc_casadi.model_file import load_model
from necc_casadi.networks import Network

XI = np.array([-0.4, 0.2, -0.3])


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
    weights = [*quadratic_weights([1.2, 1, 1.1], XI), *quadratic_weights([1, 1.2, 0.9], c)]
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


def energy_of(folder) -> Energy:
    model = Model(json.loads((folder / "design.json").read_text(encoding="utf-8")))
    return Energy(model, [0, 1, 2, 6, 7, 8])


def test_satellite_has_a_region_that_the_checker_confirms(folder, certificate):
    assert certificate.certified
    assert isinstance(certificate.region, ChartRegion)
    data = next(c for c in certificate.claims if c.name == "region").data
    assert min(v for key, v in data.items() if key.startswith("reach_")) > 0.06
    assert all(result.holds for result in check(folder))


@pytest.mark.parametrize(
    ("field", "change"),
    [
        ("level", lambda v: v + 1e-4),
        ("radius", lambda v: 3 * v),
        ("size", lambda v: 1.02 * v),
        ("nu", lambda v: 1.02 * v),
        ("above", lambda v: 0.98 * v),
        ("inner", lambda v: 1.02 * v),
        ("center", lambda v: [v[0] + 0.05, *v[1:]]),
        ("middle", lambda v: [v[0] + 0.05, *v[1:]]),
        ("bends", lambda v: [0.98 * v[0], *v[1:]]),
        ("bends", lambda v: [v[0], 0.98 * v[1], *v[2:]]),
        ("bends", lambda v: [*v[:2], 0.98 * v[2], v[3]]),
        ("bends", lambda v: [*v[:3], 0.5 * v[3]]),
        ("bends", lambda v: [*v[:3]]),
        ("basis", lambda v: [[1.05 * x for x in row] for row in v]),
        ("scale_k", lambda v: [[1.05 * x for x in row] for row in v]),
        ("scale_h", lambda v: [[1.05 * x for x in row] for row in v]),
    ],
)
def test_no_field_can_be_loosened(folder, tmp_path, field, change):
    data = json.loads((folder / "certificate.json").read_text(encoding="utf-8"))
    data["region"][field] = change(data["region"][field])
    data["level"] = data["region"]["level"]
    (tmp_path / "certificate.json").write_text(json.dumps(data), encoding="utf-8")
    (tmp_path / "design.json").write_bytes((folder / "design.json").read_bytes())
    assert not {r.name: r.holds for r in check(tmp_path)}["region"]


@pytest.mark.parametrize("key", ["reach_roll", "domain_share"])
def test_sizes_cannot_be_exaggerated(folder, tmp_path, key):
    data = json.loads((folder / "certificate.json").read_text(encoding="utf-8"))
    claim = next(c for c in data["claims"] if c["name"] == "region")["data"]
    claim[key] *= 1.01
    data["domain_share"] = claim["domain_share"]
    (tmp_path / "certificate.json").write_text(json.dumps(data), encoding="utf-8")
    (tmp_path / "design.json").write_bytes((folder / "design.json").read_bytes())
    assert not {r.name: r.holds for r in check(tmp_path)}["region"]


def test_samples_agree_with_the_region(satellite, certificate):
    """V ≤ c inside, V > c where |θ| = size is crossed, and |θ| grows as the bounds say."""
    region, rng = certificate.region, np.random.default_rng(4)
    B, active = np.array(region.basis), list(region.active)
    A_K, A_H = np.array(region.scale_k), np.array(region.scale_h)
    z = satellite.z_bar.copy()

    def theta(w) -> float:
        z[active] = np.array(region.center) + B @ w
        c = np.asarray(satellite.lyapunov.terms.c(z), float).ravel() - region.middle
        return float(np.linalg.norm([*(A_K @ c), *(A_H @ (B @ w)[3:])]))

    for u in rng.normal(size=(300, 6)):
        w = u / np.linalg.norm(u)
        assert theta(region.radius * w) > region.size
        assert satellite.V(z) > region.level
        assert not region.contains(satellite, z)
        assert theta(region.inner * w) < region.size
        assert satellite.V(z) <= region.level
        assert region.contains(satellite, z)
        assert np.linalg.norm(np.asarray(satellite.lyapunov.gradient(z), float)) > 0.01


def test_linear_casimirs_and_quadratic_networks_reach_the_border_of_the_domain():
    """V is a quadratic form: c is ½ρ² for the largest ellipsoid in the box."""
    plant = mechanical(lambda q1, q2, p1, p2: (p1**2 + p2**2) / 2, 2)
    form = Form(Network(2, (), quadratic=True), Network(2, (), quadratic=True))
    weights = [*quadratic_weights([1.0, 1.0], [0, 0]), *quadratic_weights([1.0, 1.0], [0, 0])]
    certificate = certify(make_design(plant, [0] * 4, form, weights, [0.0, 0.0]))
    assert certificate.region.method == "chart"
    # ∇²V = [[1, −1], [−1, 2]] for each joint, whose inverse has the diagonal (2, 1): ρ² = 2²/2
    assert certificate.level == pytest.approx(1.0, rel=0.02)
    assert certificate.level <= 1.0


@pytest.mark.parametrize("order", [2, 3, 4, 5])
def test_derivatives_enclose_high_precision_values(satellite, folder, order):
    potential, rng = Potential(satellite, (3, 4, 5)), np.random.default_rng(order)
    symbols = [satellite.loop.z[i] for i in potential.active]
    chart = _Chart.at(potential, satellite.z_bar[list(potential.active)])
    half = 0.1 * np.ones(6)
    box = Interval(chart.center - half, chart.center + half)
    made = _tensor(potential, chart.entries[order], order, box[None])
    sides = tuple(zip(map(float, box.lo), map(float, box.hi), strict=True))
    checked = energy_of(folder).casimir_derivatives(order, sides)
    keys = list(product(range(6), repeat=order))
    for n in rng.choice(len(keys), 12):
        at = [sp.Float(v, 40) for v in chart.center + half * rng.uniform(-1, 1, 6)]
        for i, f in enumerate(satellite.casimirs.functions):
            derivative = f.diff(*(symbols[k] for k in keys[n]))
            exact = sp.N(derivative.subs(dict(zip(symbols, at, strict=True))), 30)
            assert made.lo[i, n] <= exact <= made.hi[i, n]
            assert checked[i][n].overlaps(arb(str(exact)))


@settings(max_examples=200, deadline=None)
@given(st.floats(-50, 50), st.floats(0, 4), st.floats(0, 1))
def test_waves_of_wide_balls_enclose_high_precision_values(lo, width, share):
    x = sp.Symbol("x")
    inside = min(lo + share * width, lo + width)
    for f, exact in ((sp.sin, mpmath.sin), (sp.cos, mpmath.cos)):
        image = evaluate(f(x), {x: ball(lo, lo + width)})
        with mpmath.workdps(40):
            assert image.overlaps(arb(mpmath.nstr(exact(mpmath.mpf(inside)), 30)))
        assert image.rad() <= 1 + 1e-6


def test_spectral_bound_is_above_and_close():
    X = np.random.default_rng(0).normal(size=(18, 36))
    exact = np.linalg.norm(X, 2)
    assert exact <= _spectral(point(X)) <= 1.001 * exact
    assert _spectral(point(np.zeros((2, 2)))) < 1e-10
