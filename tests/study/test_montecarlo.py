"""One design on many plants: the physics, by second routes."""

import pickle

import numpy as np
import pytest

from necc_casadi import Design, load_model, simulate
from necc_casadi.designs.plant_file import PLANT_FILE, read_plant
from necc_casadi.errors import OutputError
from necc_casadi.performance.steady_error import perturbed_error
from necc_casadi.simulation.perturbed import OtherPlants
from necc_casadi.simulation.responses import random_states
from necc_casadi.study.montecarlo import MonteCarlo
from necc_casadi.study.vary import read_bands


@pytest.fixture(scope="module")
def plants(weighed):
    _, out = weighed
    made = Design.load(out)
    return OtherPlants(made, read_plant(out, made)[0])


def study(weighed, vary="m=10%,g=5%", starts=4, seed=0):
    _, out = weighed
    made = Design.load(out)
    plant, text = read_plant(out, made)
    return MonteCarlo(made.text, text, read_bands(vary, plant.values), starts, seed)


def theta(plants, **values):
    return np.array([values.get(n, v) for n, v in zip(plants.names, plants.nominal, strict=True)])


def test_the_models_own_plant_is_that_of_the_design(plants):
    """Same responses as of the design itself, by its own integrator."""
    made, starts = plants.design, random_states(plants.design, 4)
    found = plants.follow(plants.nominal, starts)
    assert np.abs(found.offset).max() < 1e-9
    time = plants.grid[-1]
    each = [simulate(made, x0, time=time, points=4001) for x0 in starts]
    for seconds, response in zip(found.settling_times, each, strict=True):
        assert seconds == pytest.approx(response.settling_time, abs=2 * time / 4000)
    assert found.peak_input == pytest.approx(max(r.peak_input for r in each), rel=1e-3)


@pytest.mark.parametrize(("m", "g"), [(1.4, 9.81), (1.1, 9.5), (1.25, 10.2)])
def test_where_another_plant_rests(weighed, plants, m, g):
    """As the model file itself gives it with these parameters, by Newton's method and in time."""
    model, _ = weighed
    other = load_model(model, {"m": str(m), "g": str(g)}).system
    error = perturbed_error(plants.design, other) * plants.design.sizes.state[:2]
    found = plants.follow(theta(plants, m=m, g=g), random_states(plants.design, 2))
    assert np.abs(found.offset) == pytest.approx(error, rel=1e-6, abs=1e-9)
    assert found.share == 1.0
    z = plants._response(plants._natural.z_bar, theta(plants, m=m, g=g))
    end = z[-1, :2] * plants.design.units.state[:2]
    assert end - plants.design.z_star[:2] == pytest.approx(found.offset, rel=1e-3, abs=1e-5)


def test_a_plant_that_does_not_settle_says_so(plants):
    """A hundred times as heavy, one swings on for longer than anybody waits, inputs at a limit."""
    found = plants.follow(theta(plants, m=125.0), random_states(plants.design, 2))
    assert np.isinf(found.settling_times).any()
    assert found.share < 1.0
    assert (found.peak_input <= 30).all()


def test_a_row_is_a_function_of_its_number(weighed):
    one, other = study(weighed), pickle.loads(pickle.dumps(study(weighed)))
    rows = {index: one.row(index) for index in (0, 3, 1)}
    for index in (1, 0, 3):
        assert other.row(index) == rows[index]
    assert study(weighed, seed=1).drawn(0) != one.drawn(0)
    assert len(one.columns) == len(rows[0])


def test_parameters_fill_their_bands(weighed):
    job = study(weighed)
    drawn = np.array([job.drawn(index) for index in range(400)])
    lo, hi = np.array([(band.lo, band.hi) for band in job.bands]).T
    assert (drawn >= lo).all()
    assert (drawn <= hi).all()
    assert (np.abs(drawn.mean(0) - (lo + hi) / 2) < 0.1 * (hi - lo)).all()


def test_a_plant_file_of_another_design_is_refused(weighed, tmp_path):
    _, out = weighed
    made = Design.load(out)
    text = (out / PLANT_FILE).read_text(encoding="utf-8")
    for spoiled, message in (
        (text.replace(made.hash, "0" * 64), "is of another design"),
        (text.replace('"5/4"', '"2"'), "is of another design"),
        (text[:-20], "cannot be read"),
    ):
        assert spoiled != text
        (tmp_path / PLANT_FILE).write_text(spoiled, encoding="utf-8")
        with pytest.raises(OutputError, match=message):
            read_plant(tmp_path, made)
    with pytest.raises(OutputError, match="names no parameters"):
        read_plant(tmp_path / "nowhere", made)


def test_a_design_can_be_sent(weighed):
    """Through pickle it is the same bit for bit, and works."""
    made = Design.load(weighed[1])
    made.control([0.1, 0.2], [0.3])
    again = pickle.loads(pickle.dumps(made))
    assert again.hash == made.hash
    np.testing.assert_array_equal(
        again.control([0.1, 0.2], [0.3])[0], made.control([0.1, 0.2], [0.3])[0]
    )
