"""The gallery's regions: almost all of the height of a named obstacle, or the whole space."""

import pytest
from helpers.certificates import verdicts, written
from helpers.constructed import EXAMPLES

from necc_casadi import Options, certify, find_casimirs, judge, load_model, paper_options
from necc_casadi import design as synthesised
from necc_casadi.model.target import parse_target, target_from_model

DEEP = Options(hidden_k=(64, 64), hidden_h=(32, 32))


def made(name, target=None, options=None):
    model = load_model(EXAMPLES / f"{name}.py")
    plant = model.loop.plant
    x = parse_target(plant, target) if target else target_from_model(plant, model.target)
    casimirs = find_casimirs(model.loop, model.casimirs, x)
    verdict = judge(model.loop, casimirs, x)
    return synthesised(model.loop, casimirs, verdict, x, options or Options())


def held(certificate, name):
    return next((c for c in certificate.claims if c.name == name and c.holds), None)


#: plant, target, options → kind of the obstacle, the least share of its height, kept states
REGIONS = {
    "pendulum": ("pendulum", "pi/4", None, "critical_point", 0.99, 1),
    "damped": ("damped_pendulum", None, None, "critical_point", 0.99, 1),
    "paper": ("pendulum", "pi/4", paper_options(1), "critical_point", 0.95, 2),
    "deep": ("pendulum", "pi/4", DEEP, "critical_point", 0.95, 1),
    "motor": ("dc_motor", None, None, "critical_point", 0.99, 1),
    "cart": ("cart_pole", None, None, "critical_point", 0.99, 1),
    "maglev": ("maglev", None, None, "critical_point", 0.99, 1),
    "arm": ("two_link_arm", None, None, "domain", 0.985, 2),
    "satellite": ("satellite", None, None, "singularity", 0.95, 0),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", REGIONS)
def test_regions_reach_almost_all_of_a_real_obstacle(case, tmp_path):
    name, target, options, kind, share, kept = REGIONS[case]
    design = made(name, target, options)
    certificate = certify(design)
    assert certificate.certified
    assert certificate.obstacle.kind == kind
    assert certificate.obstacle_share >= share
    assert len(getattr(certificate.region, "kept", ())) <= kept
    assert all(verdicts(written(design, tmp_path)).values())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "target", "follows"),
    [
        ("pendulum", "pi", "converges"),
        ("mass_spring_chain", None, "converges"),
        ("series_rlc", None, "converges"),
        ("symmetric_chain", None, "stable"),
        ("tora", None, "converges"),
    ],
)
def test_the_whole_space_is_proved_where_nothing_ends_a_region(name, target, follows, tmp_path):
    design = made(name, target)
    certificate = certify(design)
    assert certificate.certified
    assert certificate.region is None
    assert held(certificate, "global").data["follows"] == follows
    assert certificate.is_global == (follows == "converges")
    assert all(verdicts(written(design, tmp_path)).values())
