"""V̇ ≤ 0: what must be proved of the loop, and what must never be."""

import dataclasses

import numpy as np
import pytest
import sympy as sp
from helpers.constructed import (
    quadratic_pendulum,
)

from necc_casadi.casimirs.casimirs import Casimirs
from necc_casadi.certificate.claims.certificate import Certificate
from necc_casadi.certificate.prover.certify import certify
from necc_casadi.model.closed_loop import ClosedLoop


def holds(certificate: Certificate) -> dict[str, bool]:
    return {claim.name: claim.holds for claim in certificate.claims}


def local(design) -> Certificate:
    return certify(design, region=False)


@pytest.mark.parametrize(
    "damping",
    [
        np.diag([-1.0, 1.0]),
        np.diag([1.0, 0.0]),
        np.diag([np.nan, 1.0]),
        np.array([[1.0, 3.0], [1.0, 1.0]]),  # symmetric part with the eigenvalue -1
        np.array([[1.0, np.inf], [-np.inf, 1.0]]),
    ],
)
def test_damping_that_is_not_positive_definite(damping):
    design = dataclasses.replace(quadratic_pendulum(), damping=damping)
    certificate = local(design)
    assert not holds(certificate)["damping"]
    assert not holds(certificate)["decrease"]
    assert not certificate.certified


def test_an_approximate_casimir_is_not_one():
    design = quadratic_pendulum()
    q, _, xi = design.loop.z
    tampered = Casimirs((q - xi * sp.Rational(1000001, 1000000),), 1, 1)
    certificate = local(dataclasses.replace(design, casimirs=tampered))
    assert not holds(certificate)["casimir"]
    assert not certificate.certified


def test_a_property_that_was_only_sampled_is_named():
    design = quadratic_pendulum()
    plant = design.loop.plant
    q, _ = plant.x
    hidden = sp.Function("f")(q)  # a sign that nobody can decide
    odd = dataclasses.replace(plant, R=sp.ImmutableMatrix([[0, 0], [0, hidden]]))
    loop = ClosedLoop(odd, design.loop.controller)
    from necc_casadi.certificate.prover.decrease import prove_decrease

    claims = {c.name: c for c in prove_decrease(dataclasses.replace(design, loop=loop)).claims}
    assert not claims["structure"].holds
    assert "R" in claims["structure"].statement
    assert not claims["decrease"].holds
