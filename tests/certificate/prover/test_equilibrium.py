"""z̄ and the ball around z*: what must be proved, and what must never be."""

import dataclasses

import numpy as np
import pytest
from helpers.constructed import (
    fitted,
    make_design,
    mechanical,
    quadratic_pendulum,
    trained_like_pendulum,
    two_link_arm,
)

from necc_casadi.certificate.claims.certificate import Certificate
from necc_casadi.certificate.prover.certify import certify
from necc_casadi.lyapunov.networks import Network
from necc_casadi.lyapunov.parameterization import Form


def holds(certificate: Certificate) -> dict[str, bool]:
    return {claim.name: claim.holds for claim in certificate.claims}


def local(design) -> Certificate:
    return certify(design, region=False)


def test_closed_form_pendulum_is_proved_with_the_figures_known_by_hand():
    design = quadratic_pendulum(k=4, h=4)
    certificate = local(design)
    assert all(holds(certificate).values())
    assert certificate.certified
    assert certificate.stability == "asymptotic"
    assert certificate.mu == pytest.approx(0.5)
    assert certificate.bound_rigorous < 1e-13
    # det = (cos q + 4)·8 − 16 vanishes at cos q = −2: convex for every q
    assert certificate.radius == 2.0


@pytest.mark.parametrize("hidden", [(64,), (64, 64)])
def test_networks_of_the_paper_are_proved(hidden):
    design = trained_like_pendulum(hidden)
    certificate = local(design)
    assert certificate.certified
    assert certificate.radius > 0.01
    assert np.linalg.norm(design.z_bar - design.z_star) <= certificate.bound_rigorous + 1e-15


@pytest.mark.parametrize("share", [2.0, 1.0])
def test_saddle_and_flat_point_are_not_proved(share):
    """det ∇²V = c(k + h) + kh vanishes at h = −ck/(c + k), c = cos q*."""
    c, k = np.cos(np.pi / 4), 4.0
    certificate = local(quadratic_pendulum(k=k, h=-share * c * k / (c + k)))
    assert not holds(certificate)["equilibrium"]
    assert not certificate.certified
    assert certificate.stability is None


def test_critical_point_away_from_the_target_is_measured_not_hidden():
    design = quadratic_pendulum()
    moved = dataclasses.replace(design, xi_star=design.xi_star + 0.1)
    certificate = local(moved)
    distance = np.linalg.norm(moved.z_bar - moved.z_star)
    assert distance > 0.05
    assert distance <= certificate.bound_rigorous


def test_two_minima_leave_a_ball_that_holds_only_one():
    plant = mechanical(lambda q, p: p**2 / 2 + (q**2 - 1) ** 2, 1)
    form = Form(Network(1, (), quadratic=True), Network(1, (), quadratic=True))
    zero_slopes = [0, 0, 1.0, 0.0, 0, 0, 1.0, 1.0]
    design = make_design(plant, (1, 0), form, zero_slopes, [0.0])
    certificate = local(design)
    assert certificate.certified
    assert certificate.radius < 2.0  # the other minimum is at distance 2


def test_two_link_arm_in_six_dimensions():
    form = Form(Network(2, (32,)), Network(2, (32,)))
    curvature = np.zeros((6, 6))
    base = make_design(two_link_arm(), ("pi/4", "pi/6", 0, 0), form, np.zeros(form.size), [0, 0])
    curvature[:] = np.asarray(base.lyapunov.hessian(base.z_star), float)
    k, h = 4 * np.eye(2), 6 * np.eye(2)
    curvature[:2, :2] += k
    curvature[:2, 4:] -= k
    curvature[4:, :2] -= k
    curvature[4:, 4:] += k + h
    design = fitted(two_link_arm(), ("pi/4", "pi/6", 0, 0), form, [0, 0], curvature)
    certificate = local(design)
    assert all(holds(certificate).values()), certificate
    assert certificate.certified
