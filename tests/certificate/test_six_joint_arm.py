"""Twelve plant states from the model to a checked certificate, in a minute."""

import time

import pytest
import sympy as sp
from helpers.certificates import verdicts
from helpers.six_joint_arm import TARGET, six_joint_arm

from necc_casadi import certify, design, find_casimirs, judge
from necc_casadi.model.closed_loop import interconnect
from necc_casadi.model.controller import default_controller

#: CPU seconds for everything; a third of it was measured.
BUDGET = 60


@pytest.mark.slow
def test_an_arm_of_six_joints_is_designed_proved_and_checked_in_time(tmp_path):
    start = time.process_time()
    plant = six_joint_arm()
    loop = interconnect(plant, default_controller(plant))
    x_star = dict(zip(plant.x, (*TARGET, *[sp.Integer(0)] * 6), strict=True))
    casimirs = find_casimirs(loop)
    verdict = judge(loop, casimirs, x_star)
    made = design(loop, casimirs, verdict, x_star)
    certificate = certify(made)
    made.save(tmp_path / "design.json")
    (tmp_path / "certificate.json").write_text(certificate.to_json(), encoding="utf-8")
    assert all(verdicts(tmp_path).values())
    assert time.process_time() - start < BUDGET
    assert certificate.certified
    assert certificate.stability == "asymptotic"
    assert certificate.obstacle.kind == "critical_point"
    assert certificate.obstacle_share > 0.98
    assert len(certificate.region.kept) == 2  # the joints on which gravity depends
