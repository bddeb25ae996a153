"""Other units of states, time and energy: the same design, proof and responses in natural units."""

import numpy as np
import pytest
import sympy as sp
from helpers.models import BASE
from helpers.problems import CART_AND_CRANE
from helpers.units import Change, converted, converted_target
from hypothesis import given, settings
from hypothesis import strategies as st

from necc_casadi.casimirs.find import find_casimirs
from necc_casadi.certificate.prover.certify import certify
from necc_casadi.model.model_file import load_model
from necc_casadi.model.target import parse_target
from necc_casadi.performance.shares import sampled_share
from necc_casadi.simulation.responses import random_states, simulate
from necc_casadi.synthesis.options import Options
from necc_casadi.synthesis.synthesis import design
from necc_casadi.verdict.judge import judge

RLC = (
    BASE
    + """
R = sp.diag(0, 5)
H = q**2 / (2 * sp.Rational("1e-6")) + p**2 / (2 * sp.Rational("1e-3"))
"""
)
PLANTS = {
    "pendulum": (BASE + "domain = {p: (-2, 2)}\n", "pi/4"),
    "cart and crane": (CART_AND_CRANE, "q1=pi/3,q2=-0.5"),
    "RLC": (RLC, "q=2e-6,p=0"),
}
#: Regions of plants with more states than a grid has axes take long to prove.
WITH_REGION = {"pendulum": True, "cart and crane": False, "RLC": True}
SMALL = Options(hidden_k=(8,), hidden_h=(6,))


@pytest.fixture(scope="module", params=PLANTS)
def plant(request, tmp_path_factory):
    return read(tmp_path_factory, request.param, WITH_REGION[request.param])


def read(tmp_path_factory, name, region):
    """(model, target, whether to prove a region, what comes of it in the units of the text)."""
    text, target = PLANTS[name]
    path = tmp_path_factory.mktemp("models") / "model.py"
    path.write_text(text, encoding="utf-8")
    model = load_model(path)
    x_star = parse_target(model.loop.plant, target)
    return model, x_star, region, outcome(model, x_star, region)


def outcome(model, x_star, region=True):
    """Everything dimensionless about one run, and the design."""
    casimirs = find_casimirs(model.loop, (), x_star)
    verdict = judge(model.loop, casimirs, x_star)
    made = design(model.loop, casimirs, verdict, x_star, SMALL)
    certificate = certify(made, region=region)
    natural = made.natural
    responses = [simulate(made, x0) for x0 in random_states(made, 3)]
    return made, {
        "verdict": (verdict.assignable, verdict.reason, verdict.stability),
        "claims": [(claim.name, claim.holds) for claim in certificate.claims],
        "share": certificate.obstacle_share,
        "sampled": sampled_share(made, certificate),
        "settling": [r.settling_time / made.units.time for r in responses],
        "weights": natural.weights.tolist(),
        "damping": [natural.D.tolist(), natural.Dc.tolist()],
        "region": certificate.region,
        "proof": (certificate.mu, certificate.radius, certificate.enclosure),
        "spectrum": natural.spectrum.tolist(),
    }


def change_of(model, factors, time, energy) -> Change:
    names = model.loop.plant.states
    return Change(dict(zip(names, factors, strict=False)), time, energy)


POWERS = st.integers(-30, 30).map(lambda k: sp.Integer(2) ** k)


@given(factors=st.lists(POWERS, min_size=4, max_size=4), time=POWERS, energy=POWERS)
@settings(max_examples=4, deadline=None)
def test_powers_of_two_change_no_bit_of_what_has_no_dimension(plant, factors, time, energy):
    model, x_star, region, (made, plain) = plant
    change = change_of(model, factors, time, energy)
    new = converted(model, change), converted_target(x_star, change)
    other_made, other = outcome(*new, region)
    assert other == plain
    scale = np.array([float(change.of(s)) for s in model.loop.plant.x])
    n = len(scale)
    assert (other_made.z_star[:n] == made.z_star[:n] * scale).all()
    assert other_made.units.time == made.units.time * float(time)


def check_other_factors(plant, seed, share):
    """Factors between 1e-9 and 1e9: the same claims, shares nearly, settling within 5 %."""
    model, x_star, region, (made, plain) = plant
    rng = np.random.default_rng(seed)
    draws = [sp.Rational(f"{10 ** rng.uniform(-9, 9):.3g}") for _ in range(6)]
    change = change_of(model, draws[:4], draws[4], draws[5])
    new = converted(model, change), converted_target(x_star, change)
    other_made, other = outcome(*new, region)
    assert other["verdict"] == plain["verdict"]
    assert other["claims"] == plain["claims"]
    if plain["share"] is not None:
        assert other["share"] == pytest.approx(plain["share"], rel=share)
    else:
        assert other["share"] is None
    one, two = (
        np.array(r["settling"]) * m.units.time for r, m in ((plain, made), (other, other_made))
    )
    assert two / float(change.time) == pytest.approx(one, rel=0.05)


@pytest.mark.parametrize("seed", range(4))
def test_other_factors_change_shares_by_little(plant, seed):
    check_other_factors(plant, seed, share=0.02)


@pytest.mark.slow
def test_small_regions_in_many_states_depend_on_the_rounding_of_units(tmp_path_factory):
    """Less than 0.1 % of the domain in cells whose sides are powers of two: a factor of 1.5."""
    crane = read(tmp_path_factory, "cart and crane", True)
    for seed in range(3):
        check_other_factors(crane, seed, share=0.5)
