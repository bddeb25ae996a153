"""Every entry of a certificate that holds is used by the proof that it is a hint for."""

import dataclasses

import pytest
from helpers.certificates import verdicts, written
from helpers.oscillators import chain, limited, oscillator, sides, soft_pendulum

from necc_casadi.certificate.claims.certificate import Certificate
from necc_casadi.certificate.claims.claim import Claim
from necc_casadi.certificate.claims.regions import CellBox, GlobalClaim, Obstacle, Region

REGION = (Certificate, Claim, Obstacle, Region, CellBox)
CASES = {
    "pass": (lambda: limited(soft_pendulum(), (-9.0, 9.0)), REGION),
    "bound": (lambda: chain(sides(q1=1.0)), (Certificate, Claim, Obstacle, Region, GlobalClaim)),
    "inputs": (lambda: limited(oscillator(), (-1.0, 1.0)), (*REGION, GlobalClaim)),
}


@pytest.mark.parametrize("case", CASES)
def test_the_checker_looks_at_every_entry(case, tmp_path, monkeypatch):
    make, kinds = CASES[case]
    folder = written(make(), tmp_path)
    looked_at = set()
    for recorded in kinds:

        def spy(self, name, recorded=recorded):
            looked_at.add((recorded, name))
            return object.__getattribute__(self, name)

        monkeypatch.setattr(recorded, "__getattribute__", spy, raising=False)
    assert all(verdicts(folder).values())
    entries = {(kind, field.name) for kind in kinds for field in dataclasses.fields(kind)}
    assert entries <= looked_at, entries - looked_at
