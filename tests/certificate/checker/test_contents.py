"""Every entry of a certificate that holds is used by the proof that it is a hint for."""

import dataclasses

import pytest
from helpers.certificates import verdicts
from helpers.constructed import make_design, mechanical, quadratic_pendulum

from necc_casadi.certificate.claims.certificate import Certificate
from necc_casadi.certificate.claims.claim import Claim
from necc_casadi.certificate.claims.regions import (
    ChartRegion,
    EllipsoidRegion,
    GridRegion,
    LimitedBy,
)
from necc_casadi.certificate.prover.certify import certify
from necc_casadi.lyapunov.networks import Network
from necc_casadi.lyapunov.parameterization import Form

QUADRATIC = Form(Network(1, (), quadratic=True), Network(1, (), quadratic=True))


def chain():
    """Three coupled masses, whose region is an ellipsoid."""
    plant = mechanical(
        lambda q1, q2, q3, p1, p2, p3: (
            (p1**2 + p2**2 + p3**2 + q1**2 + (q2 - q1) ** 2 + (q3 - q2) ** 2) / 2
        ),
        3,
        inputs=[0],
    )
    return make_design(plant, [0] * 6, QUADRATIC, [0, 0, 1.0, 0, 0, 0, 1.0, 0], [0.0])


def free_joints():
    """Two joints without potential, whose region is one in the coordinates (c, ξ)."""
    plant = mechanical(lambda q1, q2, p1, p2: (p1**2 + p2**2) / 2, 2)
    form = Form(Network(2, (), quadratic=True), Network(2, (), quadratic=True))
    return make_design(plant, [0] * 4, form, 2 * [0, 0, 0, 1.0, 1.0, 0, 0], [0.0, 0.0])


CASES = [
    (quadratic_pendulum, GridRegion),
    (chain, EllipsoidRegion),
    pytest.param(free_joints, ChartRegion, marks=pytest.mark.slow),
]


@pytest.mark.parametrize(("make", "kind"), CASES)
def test_the_checker_looks_at_every_entry(make, kind, tmp_path, monkeypatch):
    design = make()
    certificate = certify(design)
    assert type(certificate.region) is kind
    design.save(tmp_path / "design.json")
    (tmp_path / "certificate.json").write_text(certificate.to_json(), encoding="utf-8")
    looked_at = set()
    for recorded in (Certificate, Claim, LimitedBy, kind):

        def spy(self, name, recorded=recorded):
            looked_at.add((recorded, name))
            return object.__getattribute__(self, name)

        monkeypatch.setattr(recorded, "__getattribute__", spy, raising=False)
    assert all(verdicts(tmp_path).values())
    entries = {
        (recorded, field.name)
        for recorded in (Certificate, Claim, LimitedBy, kind)
        for field in dataclasses.fields(recorded)
    }
    assert entries <= looked_at, entries - looked_at
