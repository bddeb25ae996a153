"""The gallery's regions: almost all of the height of a named obstacle, or the whole space."""

import itertools

import pytest
from helpers.certificates import altered, verdicts, written
from helpers.constructed import EXAMPLES

from necc_casadi import Options, certify, find_casimirs, judge, load_model, paper_options
from necc_casadi import design as synthesised
from necc_casadi.certificate.claims.regions import packed
from necc_casadi.certificate.prover.arithmetic.potential import Potential
from necc_casadi.certificate.prover.equilibrium import prove_equilibrium
from necc_casadi.certificate.prover.region.curved import Curved
from necc_casadi.certificate.prover.region.partial import Components
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
    "neural": ("pendulum", "pi/4", Options(phi="neural"), "critical_point", 0.95, 2),
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
        ("quarter_car", None, "converges"),
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


#: Examples of which a region is proved, by what ends it; of the others the whole space is.
ENDED = {
    "ball_screw": "domain",
    "buck_filter": "input_limits",
    "cart_pole": "critical_point",
    "damped_pendulum": "critical_point",
    "dc_motor": "critical_point",
    "maglev": "critical_point",
    "overhead_crane": "domain",
    "pelican_arm": "domain",
    "pendulum": "critical_point",
    "port_crane": "critical_point",
    "robot_joint": "critical_point",
    "satellite": "singularity",
    "two_link_arm": "domain",
}
WHOLE = {
    "hydraulic_cylinder", "mass_spring_chain", "mems_comb", "quarter_car", "qube_pendulum",
    "series_rlc", "symmetric_chain", "tora",
}  # fmt: skip
#: Those that the published loop does not hold; tests/methods/test_examples.py has them.
OTHERWISE = {
    "ball_and_beam", "boost", "buck_boost", "cstr", "cuk", "flexible_joint", "furuta",
    "generator_excitation", "induction_motor", "inertia_wheel", "maglev_voltage", "mems_switch",
    "parallel_rlc", "pmsm", "quadruple_tank", "rlc_ladder", "servo_pendulum", "three_tanks",
    "turbine_generator", "vtol",
}  # fmt: skip
REAL = [name for name, kind in ENDED.items() if kind != "input_limits"]
#: As a share of the obstacle's height above V(z̄): beyond it, by more than any rounding.
BEYOND = 1.02


def test_every_example_is_named():
    assert {path.stem for path in EXAMPLES.glob("*.py")} == ENDED.keys() | WHOLE | OTHERWISE


def default(name):
    return made(name, "pi/4" if name == "pendulum" else None)


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(ENDED.keys() | WHOLE))
def test_no_region_of_an_example_ends_where_arithmetic_does(name):
    obstacle = certify(default(name)).obstacle
    assert (None if obstacle is None else obstacle.kind) == ENDED.get(name)


def raised(certificate, units) -> float:
    """A level beyond the obstacle, in natural units."""
    beyond = (BEYOND - certificate.obstacle_share) * certificate.obstacle.level_above_minimum
    return certificate.region.level + beyond / units.energy


@pytest.mark.slow
@pytest.mark.parametrize("name", REAL)
def test_the_prover_proves_nothing_beyond_a_real_obstacle(name):
    """Its searches put aside: it is asked for the component there, by the split that proved Ω."""
    design = default(name)
    certificate = certify(design)
    level = raised(certificate, certificate.units)
    potential = Potential(design.natural, design.momenta)
    minimum = prove_equilibrium(Potential(design.natural)).box
    if certificate.region.method == "curved":
        curved = Curved.of(potential, minimum)
        assert curved.region(certificate.region.level) is not None
        assert curved.region(level) is None
        return
    components = Components(potential, minimum[list(potential.active)])
    known = components.largest()
    proved_it = [b for b in components.candidates if b.reduced.kept == known.reduced.kept]
    vars(components)["candidates"] = proved_it
    assert components.at(known.level, known.obstacle) is not None
    assert components.at(level, known.obstacle) is None


@pytest.mark.slow
@pytest.mark.parametrize("name", REAL)
def test_the_checker_accepts_nothing_beyond_a_real_obstacle(name, tmp_path):
    """With the cells as they are, and with all cells of a box of three times its sides."""
    design = default(name)
    folder, certificate = written(design, tmp_path / "as_it_is"), certify(design)
    assert all(verdicts(folder).values())
    level, share = raised(certificate, certificate.units), certificate.obstacle_share

    def higher(data):
        data["region"]["level"] = level
        data["level"] = level * certificate.units.energy
        data["level_above_minimum"] *= BEYOND / share
        data["reach"] = {
            k: v and [3 * v[0] - 2 * v[1], 3 * v[1] - 2 * v[0]] for k, v in data["reach"].items()
        }
        if "height" in data["region"]:
            data["region"]["height"] *= BEYOND / share

    def wider(data):
        higher(data)
        region = data["region"]
        box, axes = region["box"], len(region["kept"])
        box["lo"] = [lo - side for lo, side in zip(box["lo"], box["side"], strict=True)]
        box["side"] = [3 * side for side in box["side"]]
        cells = itertools.product(range(box["parts"]), repeat=axes)
        region["cells"] = packed((0, index) for index in cells)

    changes = [higher] if certificate.region.method == "curved" else [higher, wider]
    for change in changes:
        (tmp_path / change.__name__).mkdir()
        assert not altered(folder, tmp_path / change.__name__, change)["region"]
