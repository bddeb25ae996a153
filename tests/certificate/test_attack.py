"""Attacks on what is claimed: states of Ω under another integrator, and files made to deceive."""

import dataclasses
import hashlib
import json
import math

import numpy as np
import pytest
import sympy as sp
from helpers.certificates import claim, reword, worded
from helpers.constructed import EXAMPLES, make_design, mechanical
from helpers.oscillators import QUADRATIC, soft_pendulum
from scipy.integrate import solve_ivp

from necc_casadi import Options, find_casimirs, judge, load_model
from necc_casadi import design as synthesised
from necc_casadi.certificate.checker.check import check
from necc_casadi.certificate.checker.reading import model_hash
from necc_casadi.certificate.prover.certify import certify
from necc_casadi.errors import OutputError
from necc_casadi.model.target import parse_target, target_from_model

STATES, BATCH = 2000, 100
#: Horizons of the linearisation; V may rise by this share of its height through rounding.
HORIZONS, ROUNDING = 12.0, 1e-6


def made(name, target):
    model = load_model(EXAMPLES / f"{name}.py")
    plant = model.loop.plant
    x = parse_target(plant, target) if target else target_from_model(plant, model.target)
    casimirs = find_casimirs(model.loop, model.casimirs, x)
    return synthesised(model.loop, casimirs, judge(model.loop, casimirs, x), x, Options())


def states_of(design, certificate, count):
    """Random states of Ω, half of them just below the level."""
    rng = np.random.default_rng(0)
    lo, hi = np.array(list(certificate.reach.values())).T
    found = []
    while len(found) < count:
        for z in rng.uniform(lo, hi, (4096, len(lo))):
            if certificate.contains(design.V, z):
                found.append(z)
    z = np.array(found[:count])
    momenta = list(design.momenta)
    low, high = np.ones(count // 2), np.full(count // 2, 50.0)
    for _ in range(50):  # the momenta scaled until V reaches the level
        middle = (low + high) / 2
        trial = z[: count // 2].copy()
        trial[:, momenta] *= middle[:, None]
        inside = design.lyapunov.V(trial) <= certificate.level
        low, high = np.where(inside, middle, low), np.where(inside, high, middle)
    z[: count // 2, momenta] *= low[:, None]
    return z


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "target"), [("pendulum", "pi/4"), ("dc_motor", None), ("cart_pole", None)]
)
def test_no_state_of_the_region_leaves_it(name, target):
    """They stay, V never rises, and where it is claimed all converge."""
    design = made(name, target)
    certificate = certify(design)
    claim = next(c for c in certificate.claims if c.name == "region")
    assert claim.holds
    z = states_of(design, certificate, STATES)
    V, field, N = design.lyapunov.V, design.lyapunov.vector_field, design.loop.n
    height = certificate.level_above_minimum
    lo, hi = np.array(list(certificate.reach.values())).T
    slow = HORIZONS / -design.spectrum.real.max()
    for batch in np.split(z, STATES // BATCH):
        found = solve_ivp(
            lambda _, y: field(y.reshape(-1, N)).ravel(),
            (0.0, slow),
            batch.ravel(),
            method="DOP853",
            rtol=1e-9,
            atol=1e-10,
            t_eval=np.linspace(0.0, slow, 40),
        )
        assert found.success
        path = found.y.T.reshape(-1, BATCH, N)
        values = np.array([V(states) for states in path])
        assert (np.diff(values, axis=0) <= ROUNDING * height).all()
        assert (values <= certificate.level + ROUNDING * height).all()
        assert ((lo <= path + 1e-7) & (path <= hi + 1e-7)).all()
        if claim.data["follows"] == "converges":
            away = np.abs(path[-1] - design.z_bar) / design.sizes.state
            assert away.max() < 0.02


# --- files that are made to deceive --------------------------------------------------------------


def faults(folder, design, certificate) -> list[str]:
    """Claims that do not hold of a design and a certificate with the right hashes."""
    design["model_hash"] = model_hash(design)
    text = json.dumps(design, ensure_ascii=False)
    certificate["design_hash"] = hashlib.sha256(text.encode()).hexdigest()
    (folder / "design.json").write_text(text, encoding="utf-8")
    (folder / "certificate.json").write_text(json.dumps(certificate), encoding="utf-8")
    return [f"{r.name}: {r.statement}" for r in check(folder) if not r.holds]


def as_data(made, **options):
    return json.loads(made.text), json.loads(certify(made, **options).to_json())


def test_an_energy_of_the_controllers_states_is_none_of_the_plants(tmp_path):
    """u = −Gcᵀ∇Hc knows nothing of H(q, ξ): ż = M∇(H + Hc) would be another loop."""
    made = soft_pendulum()
    design, certificate = as_data(made, region=False)
    assert not faults(tmp_path, design, certificate)
    off = float(made.x_star[0]) - float(made.xi_star[0])
    design["model"]["H"] += f" + 5*(q - xi1 - ({off!r}))**2"
    certificate["enclosure"] = certificate["bound_rigorous"] = 1e-5
    claim(certificate, "equilibrium")["data"]["gradient_norm"] = 1e-8
    claim(certificate, "attraction")["data"]["rate"] = 0.0
    reword(certificate)
    with pytest.raises(OutputError, match="xi1"):
        faults(tmp_path, design, certificate)


def turning():
    """V = ½p² + ½(sin(q − ξ) − c̄)² + ½ξ²: q is an angle, and Ω ends at a fold of the Casimir."""
    plant, middle = mechanical(lambda q, p: p**2 / 2, 1), sp.Rational(31, 10)
    made = make_design(plant, (middle, 0), QUADRATIC, [0] * 8, [0.0])
    c = sp.sin(plant.x[0] - made.loop.z[-1])
    weights = np.array([0, 0, 1.0, 0, 0, 0, 1.0, math.sin(middle)])
    casimirs = dataclasses.replace(made.casimirs, functions=(c,))
    return dataclasses.replace(made, casimirs=casimirs, weights=weights)


def test_an_angle_that_may_turn_keeps_no_bounds(tmp_path):
    """±3.2 is more than a period, and yet Ω around q = 3.1 reaches beyond it."""
    made = turning()
    design, certificate = as_data(made)
    assert certificate["reach"]["q1"] is None
    assert not faults(tmp_path, design, certificate)
    beyond = np.array([3.6, 0.0, 0.0])
    assert certify(made).contains(made.V, beyond)
    design["model"]["domain"] = {"q1": ["-16/5", "16/5"]}
    (fault,) = faults(tmp_path, design, certificate)
    assert fault.endswith("the region stays in the user's domain")


def raised(certificate):
    """Above the fold, V − V(z̄) = ½(1 − sin 3.1)², everything else in proportion."""
    region, obstacle = certificate["region"], certificate["obstacle"]
    for place in (region, certificate):
        place["level"] *= 1.02
    region["height"] *= 1.02
    certificate["level_above_minimum"] *= 1.02
    obstacle.update(
        kind="arithmetic", level_above_minimum=1.02**2 * obstacle["level_above_minimum"]
    )
    for name in ("p1", "xi1"):
        certificate["reach"][name] = [2 * side for side in certificate["reach"][name]]


def faced(certificate):
    """q between faces that ξ lets it cross."""
    certificate["region"]["faces"] = [{"state": 0, "lo": "8/5", "hi": "9/2"}]
    certificate["reach"]["q1"] = [1.6, 4.5]


def scaled(key, factor):
    def change(certificate):
        certificate["region"][key] = [factor * v for v in certificate["region"][key]]

    return change


def narrowed(name):
    def change(certificate):
        certificate["reach"][name] = [0.99 * side for side in certificate["reach"][name]]

    return change


FORGED = {
    "level": raised,
    "faces": faced,
    "K": scaled("floor_k", 1.01),
    "Hc": scaled("floor_h", 1.01),
    "momentum": narrowed("p1"),
    "controller": narrowed("xi1"),
    "bounded angle": lambda certificate: certificate["reach"].update(q1=[-3.2, 3.2]),
    "block": lambda certificate: certificate["region"].update(columns=[0]),
    "pole": lambda certificate: certificate["obstacle"].update(kind="singularity"),
    "bound": lambda certificate: certificate["obstacle"].update(kind="domain"),
}


@pytest.mark.parametrize("change", FORGED.values(), ids=FORGED)
def test_a_forged_curved_region_is_found(change, tmp_path):
    """The words say what the altered numbers say: only proofs tell."""
    design, certificate = as_data(turning())
    change(certificate)
    region = claim(certificate, "region")
    region["statement"] = worded(certificate, region["data"]["follows"])
    assert [fault[:7] for fault in faults(tmp_path, design, certificate)] == ["region:"]


def test_places_where_v_is_as_low_may_be_in_other_components():
    """sin(π − q) = sin q, and whole turns, though every stride of a way is one: V is the same."""
    made = turning()
    certificate = certify(made)
    assert certificate.contains(made.V, made.z_bar)
    away = [math.pi - 6.2, *(2 * math.pi * turns for turns in (1, 64, 128, 10**9))]
    for shift in away:
        other = made.z_bar + np.array([shift, 0.0, 0.0])
        assert made.V(other) < certificate.level
        assert not certificate.contains(made.V, other)


def test_where_smoothness_is_not_proved_no_pole_is_claimed(tmp_path):
    """1/((q − 5)² + 10⁻⁸) has none; in the expanded form boxes cannot tell."""
    spike = sp.Rational(1, 10**8)
    plant = mechanical(lambda q, p: p**2 / 2 + q**2 / 2 + spike / (q**2 - 10 * q + 25 + spike), 1)
    made = make_design(plant, (0, 0), QUADRATIC, [0, 0, 1.0, 0, 0, 0, 1.0, 0], [0.0])
    design, certificate = as_data(made)
    assert certificate["obstacle"]["kind"] != "singularity"
    assert not faults(tmp_path, design, certificate)
    at = {"q1": 4.9, "p1": 0.0, "xi1": 2.45}
    height = made.V(np.array([*at.values()])) - made.V(made.z_bar)
    certificate["obstacle"] = {"kind": "singularity", "at": at, "level_above_minimum": height}
    region = claim(certificate, "region")
    region["statement"] = worded(certificate, region["data"]["follows"])
    (fault,) = faults(tmp_path, design, certificate)
    assert fault.endswith("the obstacle is what it is said to be")
