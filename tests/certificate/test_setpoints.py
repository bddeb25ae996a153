"""Set-points that move: their claim, and that it is what the family of the design says."""

import json
from dataclasses import replace

import numpy as np
import pytest
import sympy as sp
from helpers.certificates import claim, verdicts, written
from helpers.velocity import arm, mechanical_loop, pendulum, sprung

from necc_casadi.certificate.claims import statements
from necc_casadi.certificate.prover.setpoints import prove_setpoints
from necc_casadi.designs.design import Design
from necc_casadi.designs.family import Family, lift
from necc_casadi.errors import ModelError
from necc_casadi.model.model_file import load_model
from necc_casadi.model.ranges import Ranges
from necc_casadi.model.setpoints import set_points
from necc_casadi.symbolic.floats import to_floats

RANGE = {"q": (sp.Integer(-2), sp.Integer(2))}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return written(replace(pendulum(), setpoints=RANGE), tmp_path_factory.mktemp("moving"))


def test_one_box_is_proved_for_the_range_and_proved_again(folder):
    data = json.loads((folder / "certificate.json").read_text(encoding="utf-8"))
    found = claim(data, "setpoints")
    assert found["holds"]
    assert found["data"]["away"] < 1e-9
    assert all(verdicts(folder).values())
    assert Design.load(folder).setpoints == RANGE


@pytest.mark.parametrize(("key", "factor"), [("level", 1.5), ("mu", 100.0), ("away", 1e-6)])
def test_numbers_that_were_not_proved_are_found_out(folder, tmp_path, key, factor):
    made = Design.load(folder)
    data = json.loads((folder / "certificate.json").read_text(encoding="utf-8"))
    held = claim(data, "setpoints")
    held["data"][key] *= factor
    widths = dict(zip(("q", "xi1"), held["data"]["half_widths"], strict=True))
    ranges = {"q": ("-2", "2")}
    level = held["data"]["level"] * made.units.energy
    held["statement"] = statements.setpoints(level, widths, held["data"]["away"], ranges)
    (tmp_path / "certificate.json").write_text(json.dumps(data), encoding="utf-8")
    (tmp_path / "design.json").write_bytes((folder / "design.json").read_bytes())
    assert verdicts(tmp_path)["setpoints"] is False


def test_set_points_that_move_need_their_claim(folder, tmp_path):
    data = json.loads((folder / "certificate.json").read_text(encoding="utf-8"))
    data["claims"] = [c for c in data["claims"] if c["name"] != "setpoints"]
    (tmp_path / "certificate.json").write_text(json.dumps(data), encoding="utf-8")
    (tmp_path / "design.json").write_bytes((folder / "design.json").read_bytes())
    assert verdicts(tmp_path)["setpoints"] is False


@pytest.mark.parametrize("make", [pendulum, arm], ids=["pendulum", "arm"])
def test_shift_and_feedforward_are_those_of_the_family(make):
    made = make()
    plant, m = made.loop.plant, made.loop.plant.m
    ranges = {str(s): (sp.Integer(-1), sp.Integer(1)) for s in plant.x[:m]}
    family = lift(made, Ranges(setpoints=ranges))
    assert isinstance(family, Family)
    points = set_points(plant, made.z_star[:m], ranges)
    rng = np.random.default_rng(0)
    for _ in range(3):
        r = rng.uniform(-1, 1, m)
        at = dict(zip(points.r, map(float, r), strict=True))
        values = dict(zip(ranges, map(float, r), strict=True))
        shift = to_floats([v.subs(at) for v in points.shift])
        forward = to_floats([v.subs(at) for v in points.feedforward])
        assert shift == pytest.approx(family.shift(values)[:m], abs=1e-12)
        assert forward == pytest.approx(family.feedforward(values), abs=1e-12)


def test_weak_springs_are_not_proved_to_hold_every_set_point():
    """Held at 0.75 with less stiffness than gravity has upside down."""
    weak = pendulum()
    weights = weak.weights.copy()
    weights[[2, 6]] = 0.6  # curvatures of Hc and K
    made = replace(weak, weights=weights, setpoints={"q": (sp.Integer(-3), sp.Integer(3))})
    assert prove_setpoints(made).statement == statements.NO_SETPOINTS
    assert prove_setpoints(weak) is None


@pytest.mark.parametrize(
    ("line", "piece"),
    [
        ("setpoints = {l: (1, 2)}", "names l, which is no state"),
        ("setpoints = {q: (2, 1)}", "is not a pair (lo, hi) with lo < hi"),
    ],
)
def test_set_points_that_are_none(tmp_path, line, piece):
    text = f"import sympy as sp\nq, l = sp.symbols('q l')\nM, V, B = 1, -sp.cos(q), 1\n{line}\n"
    (tmp_path / "own.py").write_text(text, encoding="utf-8")
    with pytest.raises(ModelError) as fault:
        load_model(tmp_path / "own.py")
    assert (fault.value.code, piece in str(fault.value)) == ("domain", True)


def test_no_box_reaches_where_the_inertia_is_negative():
    """Beyond |q| = 1 the whole energy is below E, however high E is there."""
    q = sp.Symbol("q", real=True)
    loop, casimirs = mechanical_loop(1 - q**2, q**2 / 2, 1, q)
    made = sprung(loop, casimirs, [sp.Integer(0)], 4, 4, 2, 0.5)
    reach = {"q": (sp.Rational(-1, 10), sp.Rational(1, 10))}
    found = prove_setpoints(replace(made, setpoints=reach))
    assert found.holds
    assert found.data["half_widths"][0] * made.units.state[0] < 0.9
