import pytest
import sympy as sp
from helpers.symbolic_plants import EXAMPLES, best_hessian_eigenvalue, load

from necc_casadi.casimirs.find import find_casimirs
from necc_casadi.verdict.judge import judge

VERDICTS = {
    "damped_pendulum": ("ok", "asymptotic", 1),
    "two_link_arm": ("ok", "asymptotic", 2),
    "cart_pole": ("ok", "asymptotic", 1),
    "series_rlc": ("ok", "asymptotic", 1),
    "parallel_rlc": ("invisible_gradient", None, 0),
    "mass_spring_chain": ("ok", "asymptotic", 1),
    "symmetric_chain": ("ok", "stable", 1),
    "maglev": ("ok", "asymptotic", 1),
    "tora": ("ok", "asymptotic", 1),
    "dc_motor": ("ok", "asymptotic", 1),
    "satellite": ("ok", "asymptotic", 3),
    "robot_joint": ("ok", "asymptotic", 1),
    "ball_screw": ("ok", "asymptotic", 1),
    "overhead_crane": ("ok", "asymptotic", 2),
    "pelican_arm": ("ok", "asymptotic", 2),
    "port_crane": ("ok", "asymptotic", 1),
    "quarter_car": ("ok", "asymptotic", 1),
    "mems_comb": ("ok", "asymptotic", 1),
    "hydraulic_cylinder": ("ok", "asymptotic", 1),
    "buck_filter": ("ok", "asymptotic", 1),
    "qube_pendulum": ("ok", "asymptotic", 1),
    "inertia_wheel": ("invisible_negative_curvature", None, 1),
    "vtol": ("invisible_gradient", None, 0),
    "ball_and_beam": ("invisible_flat_curvature", None, 1),
    "furuta": ("invisible_negative_curvature", None, 1),
    "rlc_ladder": ("invisible_gradient", None, 0),
    "servo_pendulum": ("invisible_gradient", None, 0),
    "mems_switch": ("invisible_gradient", None, 0),
    "generator_excitation": ("invisible_gradient", None, 0),
    "quadruple_tank": ("invisible_gradient", None, 0),
    "three_tanks": ("invisible_gradient", None, 0),
    "maglev_voltage": ("invisible_gradient", None, 0),
    "flexible_joint": ("invisible_negative_curvature", None, 1),
}
#: Those that take more than a few seconds.
LONG = {"satellite", "overhead_crane"}
#: Plants with inputs in J, sources, or no energy: the published loop is not defined for them.
OF_OTHER_METHODS = {
    "boost",
    "buck_boost",
    "cuk",
    "pmsm",
    "cstr",
    "turbine_generator",
    "induction_motor",
}


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=pytest.mark.slow if n in LONG else ()) for n in VERDICTS]
)
def test_example_shows_what_it_says(name):
    reason, stability, count = VERDICTS[name]
    plant, loop, target = load(name)
    casimirs = find_casimirs(loop, (), target)
    verdict = judge(loop, casimirs, target)
    assert (verdict.reason, verdict.stability, len(casimirs.functions)) == (
        reason,
        stability,
        count,
    )
    assert set(target) == set(plant.x)
    if verdict.xi_star is None:
        assert (best_hessian_eigenvalue(loop, casimirs, target) > 0) == (reason == "ok")


def test_satellite_without_the_copied_kinematics_is_refused():
    _, loop, target = load("satellite", integrators=True)
    verdict = judge(loop, find_casimirs(loop, (), target), target)
    assert (verdict.assignable, verdict.reason) == (False, "invisible_flat_curvature")


def test_levitation_casimir_is_the_one_of_its_docstring():
    _, loop, _ = load("maglev")
    (c,) = find_casimirs(loop).functions
    q, _p, xi1 = loop.z
    expected = xi1 - sp.Rational(1, 20) / (sp.Rational(1, 2) + q)
    ratio = sp.simplify(sp.diff(c, q) / sp.diff(expected, q))
    assert sp.simplify(sp.diff(c, xi1) - ratio) == 0


def test_every_example_is_judged_here():
    stems = {path.stem for path in EXAMPLES.glob("*.py")}
    assert stems == {*VERDICTS, *OF_OTHER_METHODS, "pendulum"}


def test_every_example_has_a_source_and_a_title():
    for path in EXAMPLES.glob("*.py"):
        text = path.read_text(encoding="utf-8")
        assert "Source:" in text
        assert "Try: necc-design" in text
        assert "name = " in text
