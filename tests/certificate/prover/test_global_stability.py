"""What bounds of networks below their curvature prove of V on the whole space."""

import json

import numpy as np
import pytest
from helpers.certificates import verdicts, written
from helpers.constructed import EXAMPLES, quadratic_pendulum
from helpers.geared import geared
from helpers.oscillators import oscillator, sides

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


def follows(design) -> str | None:
    """What is proved of the whole space; None: nothing."""
    claims = {claim.name: claim for claim in certify(design).claims}
    return claims["global"].data.get("follows") if "global" in claims else None


@pytest.mark.parametrize(
    ("k", "h"), [(4, 4), (1.4, 4), (1.3, 4), (1.0, 1.0), (0.9, 1.2), (0.8, 0.9), (-2, -2)]
)
def test_the_pendulum_is_global_exactly_where_one_critical_point_is_left(k, h):
    """Springs in series ρ = kh/(k + h): w′ has one zero iff ρ > ρ*, found here by counting."""
    design = quadratic_pendulum(k, h)
    rho, slope = k * h / (k + h), np.sin(np.pi / 4)
    s = np.linspace(-40, 40, 400_001)
    w1 = np.sin(s) - slope + rho * (s - np.pi / 4)
    zeros = int((np.diff(np.sign(w1)) != 0).sum())
    expected = "converges" if rho > 0 and k + h > 0 and zeros == 1 else None
    assert follows(design) == expected


def test_uniqueness_needs_no_convexity():
    """k = h = 1: ρ = ½ < 1, so w″ = cos q + ½ is negative beyond 2π/3, and yet V is global."""
    design = quadratic_pendulum(1.0, 1.0)
    z = np.array([np.pi, 0.0, 1.0])
    assert np.linalg.eigvalsh(design.lyapunov.hessian(z))[0] < 0
    assert follows(design) == "converges"


def test_a_gear_that_varies_is_out_of_reach():
    claims = {c.name: c for c in certify(geared(lambda q: 2 + q)).claims}
    assert not claims["global"].holds
    assert "depend on the state" in claims["global"].statement


def test_bounds_and_the_whole_space_are_claimed_beside_each_other(tmp_path):
    folder = written(oscillator(domain=sides(q1=1.0)), tmp_path)
    assert all(verdicts(folder).values())
    data = json.loads((folder / "certificate.json").read_text(encoding="utf-8"))
    assert data["is_global"]
    assert data["obstacle"]["kind"] == "domain"
    assert max(data["reach"]["q1"]) <= 1.0
