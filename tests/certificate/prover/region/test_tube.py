"""Regions where V is convex near the minimum only: proved, checked, and refused when changed."""

import json
from dataclasses import replace

import numpy as np
import pytest
from helpers.problems import problem, solve
from helpers.symbolic_plants import EXAMPLES
from scipy.optimize import minimize

from necc_casadi.certificate.checker.check import check
from necc_casadi.certificate.prover.arithmetic.intervals import Interval
from necc_casadi.certificate.prover.arithmetic.potential import Potential
from necc_casadi.certificate.prover.certify import certify
from necc_casadi.certificate.prover.region.split import Splits
from necc_casadi.certificate.prover.region.tube import bent_split, convex_over
from necc_casadi.errors import OutputError
from necc_casadi.methods.find import find_method
from necc_casadi.model.model_file import load_model
from necc_casadi.synthesis.options import paper_options
from necc_casadi.synthesis.synthesis import design

MAGLEV = EXAMPLES / "maglev.py"


@pytest.fixture(scope="module")
def made():
    """Plain networks, which are convex near the target only."""
    return solve(problem(load_model(MAGLEV), None), paper_options(1))


@pytest.fixture(scope="module")
def certificate(made):
    return certify(made)


@pytest.fixture
def checked(made, certificate, tmp_path):
    """(change of the region) -> names of what the checker does not prove."""

    def run(change):
        data = json.loads(certificate.to_json())
        change(data["region"])
        made.save(tmp_path / "design.json")
        (tmp_path / "certificate.json").write_text(json.dumps(data), encoding="utf-8")
        return {result.name for result in check(tmp_path) if not result.holds}

    return run


def test_the_region_ends_at_a_pass(certificate):
    region = certificate.region
    assert len(region.tube) == len(region.floor) == 1
    assert certificate.obstacle.kind == "critical_point"
    assert certificate.obstacle_share >= 0.95


def test_it_is_proved_again(checked):
    assert checked(lambda region: None) == set()


@pytest.mark.parametrize("factor", [0.5, 30.0])
def test_a_tube_of_another_width_is_refused(checked, factor):
    """Too narrow: V ≤ c on a side. Too wide: V is not convex there."""

    def change(region):
        ((lo, hi),) = region["tube"]
        middle, half = (lo + hi) / 2, factor * (hi - lo) / 2
        region["tube"] = [[middle - half, middle + half]]

    assert "region" in checked(change)


@pytest.mark.parametrize("tube", [[], [[-1e9, 1e9]], [[1.0, 2.0]]])
def test_another_tube_is_refused(checked, tube):
    assert "region" in checked(lambda region: region.update(tube=tube))


@pytest.mark.parametrize("tube", [[[0.2, 0.1]], [[0.1, 0.1]], [[0, 1], [0, 1]], [[0]], 3])
def test_a_tube_that_is_none_is_not_read(checked, tube):
    with pytest.raises(OutputError):
        checked(lambda region: region.update(tube=tube))


def test_bends_beside_a_tube_are_not_read(checked):
    """Nothing rests on them, so nothing proves them."""
    with pytest.raises(OutputError):
        checked(lambda region: region.update(bends=[1.0, 1.0]))


def test_a_tube_around_another_well_is_refused(checked):
    def change(region):
        ((lo, hi),) = region["tube"]
        region["tube"] = [[lo + 2 * (hi - lo), hi + 2 * (hi - lo)]]

    assert "region" in checked(change)


def test_a_steeper_floor_is_refused(checked):
    def change(region):
        region["floor"] = [[4 * region["floor"][0][0]]]

    assert "region" in checked(change)


def test_states_beside_the_tube_are_not_in_the_region(made, certificate):
    z, (lo, hi) = made.z_bar, certificate.region.tube[0]
    unit = made.units.state[2]
    assert certificate.contains(made.V, z)
    for beside in (lo, hi):
        away = z.copy()
        away[2] = beside * unit + 0.01 * (beside - (lo + hi) / 2) * unit
        assert not certificate.contains(lambda v: made.V(made.z_bar), away)


def test_v_is_convex_in_what_is_minimised_out(made, certificate):
    """The floor against the Hessian in plain numbers, over the cells and the tube."""
    natural, region = made.natural, certificate.region
    rng = np.random.default_rng(0)
    box = np.array([*region.box.whole, *region.tube])
    for q, xi in rng.uniform(box[:, 0], box[:, 1], (200, 2)):
        assert natural.lyapunov.hessian([q, 0.0, xi])[2, 2] >= region.floor[0][0]


def around(made):
    y = made.natural.z_star[[0, 2]]
    return Interval(y - 0.1, y + 0.1)


def test_no_floor_where_v_curves_downwards(made):
    splits = Splits(Potential(made.natural, tuple(made.momenta)))
    split = bent_split(splits, around(made))
    assert split.kept == (0,)
    y = made.natural.z_star[[0, 2]]
    s = Interval(y[:1] - 0.01, y[:1] + 0.01)
    near, far = (Interval(y[1:] - r, y[1:] + r) for r in (0.01, 20.0))
    assert convex_over(split, s, near, y) is not None
    assert convex_over(split, s, far, y) is None


def test_no_split_where_nothing_is_minimised_out(made):
    splits = Splits(Potential(made.natural, tuple(made.momenta)))
    assert bent_split(splits, around(made)) is not None
    everywhere = replace(splits)
    object.__setattr__(everywhere, "bends_with", lambda symbol: True)
    assert bent_split(everywhere, around(made)) is None


def test_a_convex_energy_keeps_none_of_more_states_than_a_region_may():
    """Outflows that go with the root of the level: ∇²H depends on all four of them.

    The region ends where a level meets its bound, at the least of V there, found otherwise.
    """
    model = load_model(EXAMPLES / "quadruple_tank.py")
    target = {s: model.target[str(s)] for s in model.system.x}
    method = find_method(model, target).chosen
    made = design(method.loop, method.casimirs, method.verdict, target)
    certificate = certify(made)
    assert certificate.region.kept == ()
    assert len(certificate.region.tube) == 6
    assert certificate.obstacle.kind == "domain"
    assert certificate.obstacle_share > 0.9
    lower = {s: float(lo) for s, (lo, _) in made.loop.plant.domain.items()}
    sizes, z_bar = made.sizes.state, made.z_bar
    least = []
    for i, name in enumerate(made.loop.plant.states):
        free = [k for k in range(6) if k != i]

        def value(w, i=i, name=name, free=free):
            z = np.zeros(6)
            z[i], z[free] = lower[name], z_bar[free] + w * sizes[free]
            inside = all(z[k] > 0 for k in range(4))
            return (made.V(z) - made.V(z_bar)) / made.sizes.energy if inside else np.inf

        found = minimize(value, np.zeros(5), method="Nelder-Mead", options={"maxiter": 8000})
        least.append(found.fun * made.sizes.energy)
    assert certificate.obstacle.level_above_minimum == pytest.approx(min(least), rel=1e-3)
