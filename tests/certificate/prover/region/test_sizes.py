"""How large regions are: closed forms, domains far larger than the region, nothing larger claimed.

All V are quadratic, V = ½yᵀPy over the states y that are no momenta, so that a component of
{V ≤ c} is an ellipsoid whose volume, slices, shadows and semi-widths are known.
"""

import dataclasses
import json
import math

import numpy as np
import pytest
import sympy as sp
from helpers.certificates import altered, claim, verdicts
from helpers.constructed import make_design, mechanical, pendulum
from helpers.oscillators import QUADRATIC, oscillator

from necc_casadi.certificate.claims.certificate import Certificate
from necc_casadi.certificate.prover.arithmetic.intervals import Interval
from necc_casadi.certificate.prover.arithmetic.potential import Potential
from necc_casadi.certificate.prover.certify import certify
from necc_casadi.certificate.prover.region import region as region_module
from necc_casadi.certificate.prover.region.grid import flood, make_grid
from necc_casadi.certificate.prover.region.grid_search import widest_grid
from necc_casadi.designs.design import Design
from necc_casadi.report.findings import region_claim

#: Together longer than the quick suite can afford; CI runs them.
pytestmark = pytest.mark.slow


def roomy(**sides: float):
    """A domain ±side around 0 for each state named."""
    return {name: (-sp.Rational(str(v)), sp.Rational(str(v))) for name, v in sides.items()}


def chain(domain=None) -> Design:
    """Three coupled masses: four states that are no momenta, whose region is an ellipsoid."""
    plant = mechanical(
        lambda q1, q2, q3, p1, p2, p3: (
            (p1**2 + p2**2 + p3**2 + q1**2 + (q2 - q1) ** 2 + (q3 - q2) ** 2) / 2
        ),
        3,
        inputs=[0],
    )
    plant = dataclasses.replace(plant, domain=domain or {})
    return make_design(plant, [0] * 6, QUADRATIC, [0, 0, 1.0, 0, 0, 0, 1.0, 0], [0.0])


def sizes(certificate: Certificate) -> dict[str, float]:
    """What is claimed of the size of the region."""
    return {k: v for k, v in region_claim(certificate).data.items() if isinstance(v, float)}


def by_hand(design: Design, certificate: Certificate) -> dict[str, float]:
    """Sizes of the ellipsoid ½yᵀPy ≤ c, the minimum of V taken as zero."""
    z, active = np.zeros(design.loop.n), list(certificate.region.active)
    P = np.asarray(design.lyapunov.hessian(z), float)[np.ix_(active, active)]
    c, n, d = certificate.level - design.V(z), len(active) - 1, len(active)
    domain = design.domain.of(active)
    plant = float(np.prod((domain.hi - domain.lo)[:n]))
    shadow = np.linalg.inv(np.linalg.inv(P)[:n, :n])
    volume = ellipsoid(P, c)
    half = np.sqrt(2 * c * np.diagonal(np.linalg.inv(P)))
    names = [design.loop.states[i] for i in active]
    return (
        {
            "volume": volume,
            "domain_share": volume / float(np.prod(domain.hi - domain.lo)),
            "slice_share": ellipsoid(P[:n, :n], c) / plant,
            "plant_share": ellipsoid(shadow, c) / plant,
        }
        | {f"reach_{s}": v for s, v in zip(names, half, strict=True)}
        | {"d": d}
    )


def ellipsoid(P: np.ndarray, c: float) -> float:
    d = len(P)
    ball = math.pi ** (d / 2) / math.gamma(d / 2 + 1)
    return ball * (2 * c) ** (d / 2) / math.sqrt(np.linalg.det(P))


DESIGNS = {
    "grid": lambda: oscillator(),
    "stiff": lambda: oscillator(h=2.0, k=30.0, domain=roomy(p1=9)),
    "three": lambda: coupled(),
    "ellipsoid": lambda: chain(roomy(p1=9, p2=9, p3=9)),
}
#: The share of each size that must be proved: three axes have coarse cells.
PROVED = {"grid": 0.93, "stiff": 0.9, "three": 0.8, "ellipsoid": 0.97}


def coupled() -> Design:
    """Two masses, the second behind a spring: three states that are no momenta."""
    plant = mechanical(
        lambda q1, q2, p1, p2: (p1**2 + p2**2 + q1**2 + (q2 - q1) ** 2) / 2, 2, inputs=[0]
    )
    plant = dataclasses.replace(plant, domain=roomy(p1=9, p2=9))
    return make_design(plant, [0] * 4, QUADRATIC, [0, 0, 1.0, 0, 0, 0, 1.0, 0], [0.0])


@pytest.fixture(scope="module", params=DESIGNS)
def made(request, tmp_path_factory):
    folder = tmp_path_factory.mktemp(request.param)
    design = DESIGNS[request.param]()
    certificate = certify(design)
    design.save(folder / "design.json")
    (folder / "certificate.json").write_text(certificate.to_json(), encoding="utf-8")
    return request.param, design, certificate, folder


def test_sizes_of_quadratics_are_below_the_known_ones_and_close(made):
    name, design, certificate, folder = made
    claimed, exact = sizes(certificate), by_hand(design, certificate)
    assert certificate.region.method == ("ellipsoid" if name == "ellipsoid" else "grid")
    assert set(claimed) == set(exact) - {"d"}
    for key, value in claimed.items():
        dimensions = exact["d"] if key in ("volume", "domain_share") else 2
        least = PROVED[name] ** (dimensions / 2)
        assert least * exact[key] < value <= exact[key] * (1 + 1e-12), key
    assert all(verdicts(folder).values())


@pytest.mark.slow
def test_each_size_that_is_raised_is_rejected(made, tmp_path):
    name, design, certificate, folder = made
    exact = by_hand(design, certificate)
    keys = sizes(certificate) if name == "grid" else ("slice_share", "plant_share")
    for key in keys:

        def raised(data, key=key):
            claim(data, "region")["data"][key] = 1.02 * exact[key]
            data["domain_share"] = claim(data, "region")["data"]["domain_share"]

        assert not altered(folder, tmp_path, raised)["region"], (name, key)


def test_a_size_without_a_proof_is_rejected(made, tmp_path):
    def invented(data):
        claim(data, "region")["data"]["mass"] = 0.0

    assert not altered(made[3], tmp_path, invented)["region"]


def widest(design: Design):
    """The grid search over the states that are no momenta, without a ceiling."""
    potential = Potential(design, design.momenta)
    domain = design.domain.of(potential.active)
    at = design.z_bar[list(potential.active)]
    z_bar = Interval(at - 1e-9, at + 1e-9)
    return potential, Interval(domain.lo, domain.hi), z_bar


@pytest.mark.parametrize("side", [20.0, 2000.0])
def test_a_domain_far_larger_than_the_region_costs_nothing(side):
    """min V on |q| = 2 is 3; ξ reaches ±2 there, whatever the domain of ξ."""
    design = oscillator(domain=roomy(p1=9, xi1=side))
    certificate = certify(design)
    assert 0.97 * 3 < certificate.level <= 3.0
    assert certificate.limited_by.startswith("the domain, near q1")
    exact = by_hand(design, certificate)
    assert region_claim(certificate).data["volume"] > 0.93 * exact["volume"]


def test_a_narrow_oblique_valley_is_settled():
    """Across the valley V is 10³ times as curved as along it, and no axis is along it."""
    design = oscillator(k=2e3, domain=roomy(p1=9, xi1=40))
    potential, domain, z_bar = widest(design)
    whole = flood(potential, make_grid(domain.lo, domain.hi, 128**2), z_bar)
    found = widest_grid(potential, domain, z_bar, np.inf)
    h, k = 1.0, 2e3
    exact = 2 * (1 + h * k / (h + k))  # min V on |q| = 2
    assert whole is None or whole.level < found.level
    assert 0.9 * exact < found.level <= exact


def test_the_ceiling_is_kept_and_the_cells_follow_the_smaller_component():
    design = oscillator(domain=roomy(p1=9))
    potential, domain, z_bar = widest(design)
    free, low = (widest_grid(potential, domain, z_bar, c) for c in (np.inf, 0.05))
    assert low.level == 0.05 < free.level
    assert max(low.grid.step) < min(free.grid.step)
    area = 2 * np.pi * 0.05 / np.sqrt(3)
    assert 0.93 * area < low.volume <= area


def test_another_well_in_the_box_is_left_out():
    """Equal wells at ±1: the plain values flood both, the proof only one."""
    plant = mechanical(lambda q, p: p**2 / 2 + (q**2 - 1) ** 2 / 4, 1)
    plant = dataclasses.replace(plant, domain=roomy(p1=9, q1=3, xi1=400))
    weights = [0, 0, 1.0, 0.0, 0, 0, 1e-3, 1.0]
    potential, domain, z_bar = widest(make_design(plant, (1, 0), QUADRATIC, weights, [0.0]))
    found = widest_grid(potential, domain, z_bar, np.inf)
    q = (np.argwhere(found.mask)[:, 0] + found.grid.first[0]) * found.grid.step[0]
    assert 0.2 < found.level <= 0.25 + 1e-3
    assert q.min() > -2 * found.grid.step[0]


@pytest.fixture
def small_box(monkeypatch, tmp_path):
    """An oscillator whose cells end before the domain does."""

    def within(potential, domain, z_bar, ceiling):
        return widest_grid(potential, Interval(domain.lo / 2, domain.hi / 2), z_bar, ceiling)

    monkeypatch.setattr(region_module, "widest_grid", within)
    design = oscillator(domain=roomy(p1=9))
    certificate = certify(design)
    design.save(tmp_path / "design.json")
    (tmp_path / "certificate.json").write_text(certificate.to_json(), encoding="utf-8")
    return certificate, tmp_path


def test_cells_that_end_before_the_domain_say_so(small_box, tmp_path_factory):
    """min V on |q| = 1 is ¾: less than the domain allows, and not by its fault."""
    certificate, folder = small_box
    assert 0.97 * 0.75 < certificate.level <= 0.75
    assert certificate.limited_by.startswith("the width of the cells, near q1")
    assert all(verdicts(folder).values())

    def blamed(data):
        claim(data, "region")["data"]["limit"]["kind"] = "border"
        data["limited_by"] = data["limited_by"].replace("the width of the cells", "the domain")

    assert not altered(folder, tmp_path_factory.mktemp("blamed"), blamed)["region"]


def test_slice_and_shadow_against_sampled_states():
    """The pendulum: no sampled share is below the proved one, and none far above."""
    plant = dataclasses.replace(pendulum(), domain=roomy(p=9))
    slope = -math.sin(math.pi / 4)
    weights = [0, 0, 4.0, 0.5 - slope / 4, 0, 0, 4.0, math.pi / 4 - 0.5 - slope / 4]
    design = make_design(plant, ("pi/4", 0), QUADRATIC, weights, [0.5])
    certificate = certify(design)
    data, domain = region_claim(certificate).data, design.domain
    q = np.linspace(domain.lo[0], domain.hi[0], 301)
    xi = np.linspace(domain.lo[2], domain.hi[2], 301)
    region = certificate.region

    def inside(a, b):
        return region.contains(design.V, (a, 0.0, b))

    cut = np.mean([inside(a, 0.5) for a in q])
    shadow = np.mean([any(inside(a, b) for b in xi[::10]) for a in q[::4]])
    assert cut - 0.03 < data["slice_share"] <= cut + 0.01
    assert shadow - 0.03 < data["plant_share"] <= shadow + 0.02
    stored = json.loads(certificate.to_json())
    assert stored["domain_share"] == data["domain_share"]
