"""The governor: what it answers, what it applies, and that V never is above the level."""

from dataclasses import replace

import numpy as np
import pytest
import sympy as sp
from helpers.velocity import pendulum

from necc_casadi.certificate.prover.certify import certify
from necc_casadi.designs.family import lift
from necc_casadi.errors import OptionError
from necc_casadi.export.governor import Governor
from necc_casadi.model.ranges import Ranges


@pytest.fixture(scope="module")
def moving():
    made = replace(pendulum(), setpoints={"q": (sp.Integer(-2), sp.Integer(2))})
    certificate = certify(made)
    claim = next(c for c in certificate.claims if c.name == "setpoints")
    data = {**claim.data, "level": claim.data["level"] / 16}  # a proof of less, to be met often
    claims = tuple(replace(c, data=data) if c is claim else c for c in certificate.claims)
    return made, replace(certificate, claims=claims)


def test_it_is_V_of_the_family(moving):
    """The same V as the family's member has, seen from its rest."""
    made, certificate = moving
    governor, rng = Governor(made, certificate), np.random.default_rng(0)
    family = lift(made, Ranges(setpoints=made.setpoints))
    level = next(c for c in certificate.claims if c.name == "setpoints").data["level"]
    for _ in range(5):
        r, q, v, xi = rng.uniform(-1, 1, 4)
        member = family.member({"q": float(r)})
        x_hat = np.array([q - r + made.z_star[0], v])
        wanted = member.V([*x_hat, xi]) - member.V(made.z_star)
        assert governor.above([q, v], [xi], [r]) * level == pytest.approx(wanted, abs=1e-12)
        governor.r = np.array([r])
        u, rate = governor.control([q, v], [xi])
        family_u, family_rate = family.control([q, v], [xi], [r])
        assert u == pytest.approx(family_u, abs=1e-12)
        assert rate == pytest.approx(family_rate, abs=1e-12)


def test_answers(moving):
    made, certificate = moving
    governor = Governor(made, certificate)
    assert governor.set_target([0.75, 0], made.xi_star, [0.8]) == "ok"
    assert governor.r == pytest.approx([0.8])
    assert governor.set_target([0.75, 0], made.xi_star, [-2]) == "limited"
    assert -2 < governor.r[0] < 0.75
    applied = governor.r.copy()
    assert governor.set_target([0.75, 50], made.xi_star, [0.8]) == "refused"
    assert governor.set_target([0.75, 0], made.xi_star, [2.5]) == "outside"
    assert governor.r == pytest.approx(applied)
    with pytest.raises(OptionError, match="nothing is proved"):
        Governor(pendulum(), certify(pendulum(), region=False))


@pytest.mark.slow
def test_under_any_command_V_stays_below_the_level(moving):
    """Short steps of the continuous loop, commands at random times."""
    made, certificate = moving
    governor, rng = Governor(made, certificate), np.random.default_rng(3)
    x, xi, command, worst, words = np.array([0.75, 0.0]), made.xi_star.copy(), [0.75], 0.0, set()
    for step in range(600):
        if step % 60 == 0:
            command = [rng.uniform(-2, 2)]
        words.add(governor.set_target(x, xi, command))
        worst = max(worst, governor.above(x, xi))
        u, rate = governor.control(x, xi)
        x = x + 0.02 * np.array([x[1], u[0] - np.sin(x[0]) - 0.1 * x[1]])
        xi = xi + 0.02 * rate
    assert 0.9 < worst <= 1 + 1e-9
    assert {"ok", "limited"} <= words
