"""Regions that curved Casimirs shape: obstacle, proof below it, and what is rejected."""

import dataclasses
import json

import numpy as np
import pytest
import sympy as sp
from flint import arb
from helpers.constructed import EXAMPLES, make_design
from scipy.integrate import solve_ivp

from necc_casadi.casimirs.find import find_casimirs
from necc_casadi.certificate.checker.arithmetic.potential import Energy
from necc_casadi.certificate.checker.model import StoredDesign
from necc_casadi.certificate.checker.region import curved as checked
from necc_casadi.certificate.checker.region.poles import Surroundings
from necc_casadi.certificate.claims.curved import CurvedRegion, Faces
from necc_casadi.certificate.claims.fields import read_as
from necc_casadi.certificate.prover.arithmetic.intervals import Interval, point
from necc_casadi.certificate.prover.arithmetic.potential import Potential
from necc_casadi.certificate.prover.equilibrium import prove_equilibrium
from necc_casadi.certificate.prover.region.curved import Curved
from necc_casadi.certificate.prover.region.curved_search import prove_curved
from necc_casadi.certificate.prover.region.poles import Between, denominators, poles_around
from necc_casadi.lyapunov.networks import Network
from necc_casadi.lyapunov.parameterization import Form
from necc_casadi.model.model_file import load_model

XI = np.array([-0.786, -0.535, -0.468])
x = sp.Symbol("x", real=True)
slow = pytest.mark.slow


def quadratic(kappa, middle) -> list[float]:
    """½ Σ κᵢ(vᵢ − oᵢ)²: the affine part is zero."""
    return [*np.zeros(len(middle) + 1), *kappa, *middle]


def satellite_in(domain=None):
    """K and Hc quadratic with their minima at the target, within bounds of the user's."""
    model = load_model(EXAMPLES / "satellite.py", {})
    loop = dataclasses.replace(
        model.loop, plant=dataclasses.replace(model.loop.plant, domain=domain or {})
    )
    target = (sp.pi / 6, sp.pi / 8, -sp.pi / 5, 0, 0, 0)
    casimirs = find_casimirs(loop, model.casimirs, dict(zip(loop.plant.x, target, strict=True)))
    at = dict(zip(loop.z, [*target, *XI], strict=True))
    c = [float(sp.N(f.subs(at))) for f in casimirs.functions]
    form = Form(Network(3, (), quadratic=True), Network(3, (), quadratic=True))
    weights = [*quadratic([2.0, 2.1, 1.9], XI), *quadratic([5, 4.5, 5.5], c)]
    return make_design(loop.plant, target, form, weights, XI, casimirs=casimirs, loop=loop)


@pytest.fixture(scope="module")
def satellite():
    return satellite_in()


@pytest.fixture(scope="module")
def potential(satellite):
    return Potential(satellite, satellite.momenta)


@pytest.fixture(scope="module")
def z_bar(satellite):
    return prove_equilibrium(Potential(satellite)).box


@pytest.fixture(scope="module")
def proof(potential, z_bar):
    found = prove_curved(potential, z_bar)
    assert found is not None
    return found


def holds(design, region: CurvedRegion, z_bar: Interval) -> bool:
    """What the checker says of it."""
    model = StoredDesign(json.loads(design.text))
    energy = Energy(model, region.active)
    place = tuple((float(z_bar.lo[i]), float(z_bar.hi[i])) for i in region.active)
    made = checked.CurvedProof(energy, region, place)
    return all(proved() for _, proved in made.obligations())


@slow
def test_the_region_ends_just_below_a_pole(satellite, potential, proof, z_bar):
    """At 95 % of the obstacle at least; the obstacle is on the border of Ω in floats."""
    region, obstacle = proof.region, proof.obstacle
    bottom = float(proof.curved.bottom.mid)
    assert obstacle.kind == "singularity"
    assert region.level - bottom >= 0.95 * (obstacle.level - bottom)
    assert satellite.V(obstacle.z) == pytest.approx(obstacle.level)
    assert holds(satellite, region, z_bar)
    assert read_as(CurvedRegion, json.loads(json.dumps(dataclasses.asdict(region)))) == region


@slow
def test_nothing_above_the_obstacle_is_proved(satellite, proof, z_bar):
    bottom = float(proof.curved.bottom.mid)
    height = 1.02 * (proof.obstacle.level - bottom)
    assert proof.curved.region(bottom + height) is None
    raised = dataclasses.replace(proof.region, level=bottom + height, height=height * (1 + 1e-9))
    assert not holds(satellite, raised, z_bar)


@slow
@pytest.mark.parametrize(
    "change",
    [
        {"level": lambda v: v + 0.01},
        {"height": lambda v: 0.99 * v},
        {"floor_k": lambda v: (1.01 * v[0], *v[1:])},
        {"floor_h": lambda v: (*v[:2], 1.01 * v[2])},
        {"floor_k": lambda v: (-v[0], *v[1:])},
        {"faces": lambda v: ()},
        {"faces": lambda v: (dataclasses.replace(v[0], hi="2"),)},
        {"faces": lambda v: (dataclasses.replace(v[0], lo="-3*pi/2"),)},
        {"faces": lambda v: (dataclasses.replace(v[0], lo="0.39"),)},
        {"faces": lambda v: (dataclasses.replace(v[0], lo="0.5"),)},
        {"faces": lambda v: (*v, v[0])},
        {"faces": lambda v: (*v, Faces(4, "-1", "1"))},
        {"columns": lambda v: (0, 1, 2)},
        {"columns": lambda v: v[:2]},
        {"active": lambda v: (0, 1, 2, 6, 7)},
        {"center": lambda v: (v[0], v[1], v[2] + 2 * np.pi, *v[3:])},
    ],
)
def test_no_field_can_be_loosened(satellite, proof, z_bar, change):
    ((name, by),) = change.items()
    altered = dataclasses.replace(proof.region, **{name: by(getattr(proof.region, name))})
    assert not holds(satellite, altered, z_bar)


@slow
def test_v_is_above_its_closed_form(satellite, proof):
    """V − V(z̄) ≥ f at random states, and f = V − V(z̄) for quadratic K and Hc."""
    curved, rng = proof.curved, np.random.default_rng(2)
    c = sp.lambdify(curved.symbols, list(curved.casimirs))
    y = rng.uniform(-3, 3, (200, 6))
    for row in y:
        away = np.array(c(*row)) - curved.c_bar.mid
        f = (curved.floor_k * away**2).sum() + (curved.floor_h * (row[3:] - XI) ** 2).sum()
        z = np.zeros(9)
        z[list(proof.region.active)] = row
        rise = satellite.V(z) - float(curved.bottom.mid)
        assert rise >= 0.5 * f - 1e-12
        assert rise <= 0.5 * f * (1 + 1e-5) + 1e-12


@slow
def test_faces_are_left_with_fewer_states_but_all_values(proof):
    """The least of f on a face over what is left is its least over all five states."""
    curved, rng = proof.curved, np.random.default_rng(5)
    for face in (f for pair in curved.faces for f in pair):
        short, free = curved._on_face(face)
        assert len(free) == 3
        at = {curved.symbols[face.state]: face.value}
        plain = sp.lambdify(curved.symbols, [e.subs(at) for e in curved.casimirs])
        reduced = sp.lambdify(curved.symbols, short)
        for row in rng.uniform(-3, 3, (20, 6)):
            wanted = np.array(plain(*row))
            angle = next(k for k in free if k in curved.angles)

            def off(turn, row=row, angle=angle, wanted=wanted, reduced=reduced):
                moved = row.copy()
                moved[angle] = turn
                return np.abs(np.array(reduced(*moved)) - wanted).max()

            turns = np.linspace(-np.pi, np.pi, 2001)
            best = min(turns, key=off)
            assert off(best) < 4e-3


@slow
def test_the_users_bounds_are_obstacles_of_their_own():
    pitch = sp.Symbol("pitch", real=True)
    design = satellite_in({"pitch": (-sp.pi / 2, sp.Rational(6, 5)), "p1": (-1, 1)})
    assert any(str(s) == str(pitch) for s in design.loop.plant.x)
    box = prove_equilibrium(Potential(design)).box
    found = prove_curved(Potential(design, design.momenta), box)
    assert found is not None
    assert found.obstacle.kind == "domain"
    assert found.region.faces[0].hi == "6/5"
    assert found.obstacle.level - float(found.curved.bottom.mid) <= 0.5 + 1e-9  # ½p1², I1 = 1
    assert holds(design, found.region, box)
    assert np.abs(found.obstacle.z[3]) == 1
    wider = dataclasses.replace(found.region, faces=(Faces(1, "-pi/2", "pi/2"),))
    assert not holds(design, wider, box)


@slow
def test_a_bound_across_another_well_is_not_claimed_away():
    """The Casimirs do not tell that well from z̄'s: f is small where the bound runs through it."""
    design = satellite_in({"pitch": (sp.Rational(-1, 2), sp.Rational(6, 5))})
    box = prove_equilibrium(Potential(design)).box
    curved = Curved.of(Potential(design, design.momenta), box)
    lower, upper = curved.faces[0]
    assert not curved.face_is_above(lower, 0.05)
    assert curved.face_is_above(upper, 0.3)


@slow
def test_other_attitudes_of_the_same_level_are_not_members(satellite, proof):
    """The Casimirs take the same values at other attitudes, and a turn away: not in Ω."""
    region, z = proof.region, np.array(satellite.z_bar)
    assert region.contains(satellite.V, z)
    turned = z + np.array([0, 0, 2 * np.pi, 0, 0, 0, 0, 0, 0])
    assert satellite.V(turned) == pytest.approx(satellite.V(z))
    assert not region.contains(satellite.V, turned)
    beyond = np.array(z)
    beyond[[0, 1, 2]] = z[0] + np.pi, np.pi - z[1], z[2] + np.pi  # the same attitude
    assert not region.contains(satellite.V, beyond)


@slow
def test_solutions_from_the_region_go_to_its_one_minimum(satellite, proof):
    """24 random starts in Ω, most of them near its border, by an outside integrator."""
    region, rng = proof.region, np.random.default_rng(11)
    box, starts = proof.place.box[list(region.active)], []
    while len(starts) < 24:
        z = np.zeros(9)
        share = rng.uniform(0.3, 1.0)
        z[list(region.active)] = satellite.z_bar[list(region.active)] + share * (
            rng.uniform(box.lo, box.hi) - satellite.z_bar[list(region.active)]
        )
        z[3:6] = rng.normal(size=3) * 0.3
        level = satellite.V(z) - float(proof.curved.bottom.mid)
        high = level > 0.3 * (region.level - float(proof.curved.bottom.mid))
        if high and region.contains(satellite.V, z):
            starts.append(z)
    field = satellite.lyapunov.vector_field
    for start in starts:
        found = solve_ivp(
            lambda t, z: np.asarray(field(z), float).ravel(),
            (0, 400), start, method="LSODA", rtol=1e-9, atol=1e-11,
        )  # fmt: skip
        assert found.success
        assert np.abs(found.y[:, -1] - satellite.z_bar).max() < 1e-2
        assert np.abs(found.y[1]).max() < np.pi / 2


def test_poles_come_from_the_models_own_denominators():
    y = sp.Symbol("y", real=True)
    factors = denominators([sp.tan(x), 1 / (y**2 - 4), 1 / (1 + sp.cos(y / 2))])
    assert poles_around(factors, x, 0.3) == (-sp.pi / 2, sp.pi / 2)
    assert poles_around(factors, x, 2.0) == (sp.pi / 2, 3 * sp.pi / 2)
    assert poles_around(factors, y, 0.0) == (-2, 2)
    assert poles_around(factors, y, 3.0) == (2, 2 * sp.pi)
    assert denominators([sp.log(x)]) is None
    assert denominators([sp.sqrt(x)]) is None


@pytest.mark.parametrize(
    ("entry", "ends", "defined"),
    [
        (sp.tan(x), (-sp.pi / 2, sp.pi / 2), True),
        (sp.tan(x), (-sp.pi / 2, sp.pi / 2 + sp.Rational(1, 1000)), False),
        (1 / (1 + sp.cos(x)), (-sp.pi, sp.pi), True),  # a double zero at the ends
        (1 / (1 + sp.cos(x)), (-sp.pi, sp.Integer(4)), False),
        (1 / (x - 1), (sp.Integer(1), sp.Integer(3)), True),
        (1 / (x - 2), (sp.Integer(1), sp.Integer(3)), False),
        (sp.sin(1 / (x - 2)), (sp.Integer(1), sp.Integer(3)), False),
        (1 / (x**2 + 1), (sp.Integer(-5), sp.Integer(5)), True),
        (sp.sqrt(x + 9), (sp.Integer(-5), sp.Integer(5)), True),
        (sp.log(x + 5), (sp.Integer(-5), sp.Integer(5)), True),  # its pole is an end
        (sp.sqrt(x - 9), (sp.Integer(-5), sp.Integer(5)), False),  # x − 9 < 0
        (sp.Abs(x), (sp.Integer(1), sp.Integer(5)), False),  # undecided, so not claimed
        (sp.atan(sp.tan(x)), (-sp.pi, sp.pi), False),  # a sawtooth, though its slope is 1
    ],
)
def test_where_an_entry_is_defined_between_exact_ends(entry, ends, defined):
    middle = float((ends[0] + ends[1]) / 2) + 0.01
    between, surroundings = Between({x: ends}, {}, []), Surroundings({x: ends}, {}, [])
    assert between.is_smooth([entry], {x: point(np.float64(middle))}) is defined
    assert surroundings.is_smooth([entry], {x: arb(middle)}) is defined


def test_an_angle_stands_for_all_its_turns():
    """1/(4 − x) is defined on one period around 0, not on all."""
    side = (-3.1415927, 3.1415927)
    wide = {x: Interval(np.float64(side[0]), np.float64(side[1]))}
    for entry, defined in ((1 / (4 - x), False), (1 / (2 + sp.cos(x)), True)):
        assert Between({}, wide, [x]).is_smooth([entry], {x: point(np.float64(0))}) is defined
        assert Surroundings({}, {x: side}, [x]).is_smooth([entry], {x: arb(0)}) is defined


def test_a_plant_with_stiffness_of_its_own_is_not_of_this_kind(default_design):
    z = default_design.z_bar
    assert Curved.of(Potential(default_design, default_design.momenta), point(z)) is None
