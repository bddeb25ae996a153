"""Regions: levels known by hand, counterexamples that must not certify, and simulation."""

import dataclasses

import numpy as np
import pytest
import sympy as sp
from helpers.constructed import make_design, mechanical, quadratic_pendulum, trained_like_pendulum
from helpers.oscillators import QUADRATIC, oscillator

from necc_casadi.certificate.claims.certificate import Certificate
from necc_casadi.certificate.prover.certify import certify
from necc_casadi.certificate.prover.global_stability import prove_global_stability
from necc_casadi.certificate.prover.invariant_sets import largest_invariant_set_is_critical


def region_claim(certificate: Certificate):
    return {claim.name: claim for claim in certificate.claims}["region"]


def test_level_of_a_quadratic_is_the_one_known_by_hand():
    """min V on |q| = 2, |ξ| = 2, |p| = 2 is ½·4·(1 + hk/(h+k)), ½·4·(h + k/(1+k)) and 2."""
    h, k = 1.0, 1.0
    by_hand = min(2 * (1 + h * k / (h + k)), 2 * (h + k / (1 + k)), 2.0)
    certificate = certify(oscillator(h, k))
    assert certificate.certified
    assert by_hand * 0.999 < certificate.level <= by_hand
    assert certificate.limited_by == "the domain, in p1"


def test_level_where_the_domain_binds_in_the_position():
    roomy = {"p1": (sp.Integer(-9), sp.Integer(9))}
    certificate = certify(oscillator(domain=roomy))
    assert 3.0 * 0.95 < certificate.level <= 3.0
    assert "near" in certificate.limited_by


def test_share_of_the_domain_is_a_lower_bound_of_the_ellipse():
    certificate = certify(oscillator())
    # area of {½yᵀAy ≤ c} is 2πc/√det A, A = [[2, −1], [−1, 2]]
    area = 2 * np.pi * certificate.level / np.sqrt(3)
    assert 0.9 * area / 16 < certificate.domain_share <= area / 16


def test_another_minimum_limits_the_level():
    """Double well of depth ¼ at q = ±1: no level above the saddle."""
    plant = mechanical(lambda q, p: p**2 / 2 + (q**2 - 1) ** 2 / 4, 1)
    roomy = {"p1": (sp.Integer(-9), sp.Integer(9))}
    plant = dataclasses.replace(plant, domain=roomy)
    weights = [0, 0, 1.0, 0.0, 0, 0, 0.25, 1.0]
    certificate = certify(make_design(plant, (1, 0), QUADRATIC, weights, [0.0]))
    design = make_design(plant, (1, 0), QUADRATIC, weights, [0.0])
    grid = [[(q, 0, xi) for xi in np.linspace(-1, 1, 81)] for q in np.linspace(-1.0, 0.9, 77)]
    saddle = max(min(design.V(z) for z in row) for row in grid)  # every path west climbs it
    assert certificate.certified
    assert certificate.level <= saddle + 1e-3
    assert certificate.level > 0.8 * saddle


def test_a_periodic_orbit_inside_leaves_no_claim_of_convergence():
    """A free rotor beside the oscillator turns for ever: invariance at most."""
    plant = mechanical(lambda q1, q2, p1, p2: (p1**2 + p2**2 + q1**2 + q2**2) / 2, 2, inputs=[0])
    design = make_design(plant, (0, 0, 0, 0), QUADRATIC, [0, 0, 1.0, 0, 0, 0, 1.0, 0], [0.0])
    certificate = certify(design)
    assert certificate.stability is None
    assert not certificate.certified
    assert not region_claim(certificate).holds
    stable = dataclasses.replace(
        design, verdict=dataclasses.replace(design.verdict, stability="stable", witness="q2, p2")
    )
    certificate = certify(stable)
    assert certificate.stability == "stable"
    assert "converges" not in region_claim(certificate).statement
    assert not largest_invariant_set_is_critical(design, design.momenta)


def test_no_region_where_the_local_proof_fails():
    certificate = certify(quadratic_pendulum(k=4, h=-4))
    assert certificate.region is None
    assert not region_claim(certificate).holds


@pytest.mark.parametrize("hidden", [(16,), pytest.param((64, 64), marks=pytest.mark.slow)])
def test_no_state_of_the_region_leaves_it_and_all_converge(hidden):
    """Many states inside, integrated by RK4 with the closed loop as it is built."""
    design = trained_like_pendulum(hidden)
    certificate = certify(design)
    region = certificate.region
    rng = np.random.default_rng(1)
    samples = design.z_bar + rng.uniform(-2, 2, (800, 3))
    z = np.array([s for s in samples if region.contains(design.V, s)]).T
    assert z.shape[1] > 20
    field = design.lyapunov.vector_field_function.map(z.shape[1])
    V = design.lyapunov.V_function.map(z.shape[1])
    before, step = np.asarray(V(z)).ravel(), 0.02
    for _ in range(900):
        k1 = np.asarray(field(z))
        k2 = np.asarray(field(z + step / 2 * k1))
        k3 = np.asarray(field(z + step / 2 * k2))
        k4 = np.asarray(field(z + step * k3))
        z = z + step / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        after = np.asarray(V(z)).ravel()
        assert np.all(after <= before + 1e-6)
        before = after
    assert np.abs(z.T - design.z_bar).max() < 0.2


def test_coupled_masses_in_more_dimensions_use_the_ellipsoid():
    """Four coupled states: V is quadratic, so the whole ellipsoid in the domain is proved."""
    plant = mechanical(
        lambda q1, q2, q3, p1, p2, p3: (
            (p1**2 + p2**2 + p3**2 + q1**2 + (q2 - q1) ** 2 + (q3 - q2) ** 2) / 2
            + (q1**4 + q2**4) / 40
        ),
        3,
        inputs=[0],
    )
    design = make_design(plant, [0] * 6, QUADRATIC, [0, 0, 1.0, 0, 0, 0, 1.0, 0], [0.0])
    certificate = certify(design)
    assert certificate.region.method == "ellipsoid"
    assert certificate.certified
    reach = region_claim(certificate).data
    assert all(reach[f"reach_{s}"] > 0.4 for s in ("q1", "q2", "q3", "xi1"))
    assert certificate.region.contains(design.V, design.z_bar)


@pytest.mark.parametrize(("k", "h"), [(4, 4), (1.4, 4), (1.3, 4), (2.1, 2.1), (1.9, 2), (-2, -2)])
def test_pendulum_is_global_exactly_where_theory_says(k, h):
    """∇²V ≻ 0 for every q iff (k − 1)(h − 1) > 1 and k > 1."""
    design = quadratic_pendulum(k, h)
    missing = prove_global_stability(design, design.momenta).missing
    assert (missing is None) == ((k - 1) * (h - 1) > 1 and k > 1)
