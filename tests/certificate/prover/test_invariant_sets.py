"""Which solutions can stay where V is constant: claimed where no rank drops, and nowhere else."""

import dataclasses
import json

import numpy as np
import pytest
import sympy as sp
from helpers.certificates import worded
from helpers.constructed import EXAMPLES, make_design, two_link_arm
from helpers.geared import geared

from necc_casadi.casimirs.casimirs import Casimirs
from necc_casadi.casimirs.find import find_casimirs
from necc_casadi.certificate.checker import invariant_sets as check_motion
from necc_casadi.certificate.checker.check import check
from necc_casadi.certificate.checker.model import StoredDesign
from necc_casadi.certificate.prover.arithmetic.intervals import Interval
from necc_casadi.certificate.prover.certify import certify
from necc_casadi.certificate.prover.invariant_sets import (
    OverBox,
    largest_invariant_set_is_critical,
    loop_is_defined,
)
from necc_casadi.lyapunov.networks import Network
from necc_casadi.lyapunov.parameterization import Form
from necc_casadi.model.closed_loop import interconnect
from necc_casadi.model.controller import default_controller
from necc_casadi.model.model_file import load_model


def both(design, half, center=None) -> bool:
    """What maker and checker say on a box around z̄, which must be the same."""
    center = design.z_star if center is None else center
    lo, hi = np.asarray(center - half, float), np.asarray(center + half, float)
    resting = design.momenta
    box = tuple((float(a), float(b)) for a, b in zip(lo, hi, strict=True))
    place, model = OverBox(design.loop.z, Interval(lo, hi)), StoredDesign(json.loads(design.text))
    made = largest_invariant_set_is_critical(design, resting, place)
    checked = check_motion.largest_invariant_set_is_critical(
        model, resting, check_motion.OverBox(model.z, box)
    )
    assert made == checked
    return made


def test_a_gear_that_depends_on_the_position_is_covered_until_it_vanishes():
    design = geared(lambda q: 1 - q)
    assert isinstance(design.casimirs, Casimirs)
    assert both(design, 0.9)
    assert not both(design, 1.1)  # the gear is 0 at q = 1


def test_a_pole_inside_the_box_leaves_no_claim():
    design = geared(lambda q: 1 / (1 - q) ** 2)
    assert both(design, 0.9)
    assert not both(design, 1.1)


def test_a_second_mass_that_no_input_moves_is_not_covered():
    """A free rotor turns for ever, whatever the gear of the other mass."""
    assert not both(geared(lambda q: 2 + q, masses=2), 0.5)


def test_where_R_depends_on_the_state_it_counts_where_it_does_not_vanish():
    """Friction (q − 1)² p: the momentum would be seen through R alone away from q = 1."""
    design = geared(lambda q: 2 + q)
    q = design.loop.plant.x[0]
    plant = dataclasses.replace(design.loop.plant, R=sp.ImmutableMatrix(sp.diag(0, (q - 1) ** 2)))
    loop = interconnect(plant, design.loop.controller)
    assert both(dataclasses.replace(design, loop=loop), 1.5)  # the input sees it everywhere


@pytest.mark.parametrize(("half", "covered"), [(0.5, True), (1.7, False)])
def test_kinematics_of_a_body_are_covered_away_from_their_poles(half, covered):
    """Gc = the Euler kinematics of ξ: rank 3 where cos ξ2 ≠ 0; on the plant's side the same."""
    model = load_model(EXAMPLES / "satellite.py", {})
    form = Form(Network(3, (), quadratic=True), Network(3, (), quadratic=True))
    casimirs = find_casimirs(interconnect(two_link_arm(), default_controller(two_link_arm())))
    z = model.loop.z  # only which states they contain matters here
    casimirs = dataclasses.replace(casimirs, functions=tuple(z[i] - z[6 + i] for i in range(3)))
    rows = [0, 0, 0, 0, 1, 1, 1, 0, 0, 0]
    design = make_design(
        model.loop.plant, [0] * 6, form, 2 * rows, [0] * 3, casimirs=casimirs, loop=model.loop
    )
    assert both(design, half) == covered
    lo, hi = np.full(9, -half), np.full(9, half)
    box = tuple(zip(lo.tolist(), hi.tolist(), strict=True))
    assert loop_is_defined(design, Interval(lo, hi)) == covered  # 1/cos ξ2 has a pole at π/2
    assert check_motion.loop_is_defined(StoredDesign(json.loads(design.text)), box) == covered


def test_constant_structure_is_covered_on_the_whole_space():
    plant = two_link_arm()
    form = Form(Network(2, (), quadratic=True), Network(2, (), quadratic=True))
    design = make_design(plant, [0] * 4, form, 2 * [0, 0, 0, 1, 1, 0, 0], [0, 0])
    assert largest_invariant_set_is_critical(design, design.momenta)
    assert check_motion.largest_invariant_set_is_critical(
        StoredDesign(json.loads(design.text)), design.momenta, None
    )
    assert not largest_invariant_set_is_critical(geared(lambda q: 2 + q), (1,))


DOMAINS = {True: (-0.9, 0.9), False: (-1.5, 1.5)}


@pytest.mark.parametrize("covered", DOMAINS)
def test_the_claim_follows_the_region_and_a_false_one_is_rejected(covered, tmp_path):
    """A weak gear near q = 1, which only the larger domain's region contains."""
    lo, hi = (sp.Rational(str(v)) for v in DOMAINS[covered])
    roomy = {"p1": (sp.Integer(-9), sp.Integer(9)), "xi1": (sp.Integer(-9), sp.Integer(9))}
    design = geared(lambda q: (1 - q) / 4, {"q1": (lo, hi), **roomy})
    certificate = certify(design)
    claim = next(c for c in certificate.claims if c.name == "region")
    assert certificate.certified
    assert ("converges" in claim.statement) == covered
    design.save(tmp_path / "design.json")
    text = certificate.to_json()
    (tmp_path / "certificate.json").write_text(text, encoding="utf-8")
    assert all(result.holds for result in check(tmp_path))
    if not covered:
        data = json.loads(text)
        region = next(c for c in data["claims"] if c["name"] == "region")

        region["data"]["follows"] = "converges"
        region["statement"] = worded(data, "converges")
        (tmp_path / "certificate.json").write_text(json.dumps(data), encoding="utf-8")
        found = {result.name: result for result in check(tmp_path)}
        assert not found["region"].holds
        assert found["region"].statement.endswith("not proved: no motion but rest keeps V constant")
