"""What bounds of networks below their curvature prove of V on the whole space."""

import json

import pytest
from helpers.constructed import EXAMPLES

from necc_casadi import Options, design, find_casimirs, judge, load_model
from necc_casadi.certificate.checker.check import check
from necc_casadi.certificate.prover.certify import certify
from necc_casadi.model.target import parse_target

DEEP = {"hidden_k": (64, 64), "hidden_h": (32, 32)}


@pytest.fixture(scope="module")
def pendulum():
    model = load_model(EXAMPLES / "pendulum.py")
    return model, find_casimirs(model.loop, model.casimirs)


def made_for(pendulum, target, **options):
    model, casimirs = pendulum
    x_star = parse_target(model.loop.plant, target)
    verdict = judge(model.loop, casimirs, x_star)
    return design(model.loop, casimirs, verdict, x_star, Options(convex=True, **options))


@pytest.mark.parametrize("target", ["pi/4", "-pi/4", "2.5"])
def test_two_hidden_layers_are_proved_globally(pendulum, target, tmp_path):
    made = made_for(pendulum, target, **DEEP)
    certificate = certify(made)
    assert certificate.certified
    assert certificate.is_global
    made.save(tmp_path / "design.json")
    data = json.loads(certificate.to_json())
    data.update(region=None, level=None, limited_by=None, domain_share=None)  # tested elsewhere
    data["claims"] = [claim for claim in data["claims"] if claim["name"] != "region"]
    (tmp_path / "certificate.json").write_text(json.dumps(data), encoding="utf-8")
    assert all(result.holds for result in check(tmp_path))
    found = next(claim for claim in data["claims"] if claim["name"] == "global")
    for bends in ([-1e-4, found["data"]["bends"][1]], [0.0, 0.0], [None, None], [-5.0, -5.0]):
        found["data"]["bends"] = bends
        (tmp_path / "certificate.json").write_text(json.dumps(data), encoding="utf-8")
        assert not {r.name: r.holds for r in check(tmp_path)}["global"]


def test_a_deep_design_that_is_not_convex_is_not_proved_globally(pendulum):
    model, casimirs = pendulum
    x_star = parse_target(model.loop.plant, "pi/4")
    verdict = judge(model.loop, casimirs, x_star)
    made = design(model.loop, casimirs, verdict, x_star, Options(**DEEP))
    assert not certify(made).is_global
