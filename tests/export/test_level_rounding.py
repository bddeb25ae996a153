"""Rounding in the test of the level: bounded, and on the safe side."""

from dataclasses import replace

import numpy as np
import pytest
import sympy as sp
from helpers.certificates import of_small_level
from helpers.velocity import arm, pendulum, pendulum_with_load

from necc_casadi.certificate.claims.claim import Claim
from necc_casadi.export.casadi2c import Real
from necc_casadi.export.compiled import compile_controller
from necc_casadi.export.governor import Governor
from necc_casadi.export.header import header
from necc_casadi.export.level_rounding import level_rounding
from necc_casadi.export.level_set import level_set
from necc_casadi.export.source import Source
from necc_casadi.lyapunov.networks import Network
from necc_casadi.lyapunov.parameterization import Form

MOVES = {"q": (sp.Integer(-2), sp.Integer(2))}


def loaded():
    told = pendulum_with_load(l=(sp.Rational(-1, 5), sp.Rational(1, 2)))
    return replace(pendulum(), setpoints=MOVES, told=told)


def with_networks(activation, offset=0.0):
    """Hidden layers of random weights, and values that cancel where `offset` is large."""
    net, rng = Network(1, (8, 8), activation, quadratic=True), np.random.default_rng(0)
    form = Form(net, net)
    weights = []
    for sign in (1, -1):
        own = net.initial(rng)
        own[-3] = sign * offset  # the bias of the last layer
        own[-2:] = 4.0, 0.1
        weights.append(own)
    made = replace(pendulum(), form=form, weights=np.concatenate(weights), setpoints=MOVES)
    return replace(made, damping=np.diag([2.0, 0.5]))


def two_links():
    made = arm()
    return replace(made, setpoints={"q1": (sp.Integer(-1), sp.Integer(1))})


def claimed(made):
    k = made.loop.plant.n // 2
    data = {"level": 1.0, "half_widths": [1.5] * 2 * k, "mu": 0.1, "away": 1e-9}
    proof = of_small_level(made)
    held = Claim("setpoints", True, "of a level, in a box", data)
    return replace(proof, claims=(*proof.claims[:-1], held))


@pytest.mark.parametrize(
    "make",
    [loaded, two_links, *(lambda a=a: with_networks(a) for a in ("tanh", "sin", "squareplus")),
     lambda: with_networks("tanh", 2e3)],
    ids=["load", "arm", "tanh", "sin", "squareplus", "cancelling"],
)  # fmt: skip
def test_the_code_is_off_by_no_more_than_the_bound(make):
    """V over the level in float beside double, at states of the box; the bound is no wild one."""
    made = make()
    proof = claimed(made)
    found, real = level_set(made, proof), Real("float")
    bound = level_rounding(found, real)
    code, governor = (
        compile_controller(made, certificate=proof, real="float"),
        Governor(made, proof),
    )
    k, rng, worst = found.k, np.random.default_rng(1), 0.0
    inflated = found.level - bound
    for _ in range(400):
        running = code.running()
        r, near = rng.uniform(*found.sides), rng.uniform(0, 1)
        away = near * rng.uniform(-1, 1, 3 * k) * [*found.half, *[0.5] * k]
        x = np.concatenate([r + away[:k], away[2 * k :]])
        x = np.float32(x).astype(float)
        xi = np.float32(made.xi_star + away[k : 2 * k]).astype(float)
        running.state[:k] = list(xi)
        running.state[k : 2 * k] = list(np.float32(r).astype(float))
        told = np.array([running.state[2 * k + i] for i in range(len(found.told[0]))], float)
        margin = running.margin(x)
        exact = governor.above(x, xi, np.float32(r).astype(float), told)
        if margin == -1 or not exact <= 2:
            continue
        computed = (1 - margin) * inflated * (1 - real.eps)
        worst = max(worst, abs(computed - exact * found.level))
        assert margin < 0 or exact <= 1  # what the code takes is within the level
    assert 0 < worst <= bound
    assert bound < 1e4 * worst


def test_where_rounding_is_all_of_the_level_nothing_moves():
    made = with_networks("tanh", 2e7)
    proof = claimed(made)
    text = header(Source(made, certificate=proof, real="float"))
    assert "#define NECC_HAS_TARGET 0" in text
    assert "rounding may be all of it" in text
    assert "#define NECC_HAS_TARGET 1" in header(Source(made, certificate=proof))
