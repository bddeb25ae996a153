"""Regions: levels known by hand, counterexamples that must not certify, and simulation."""

import dataclasses

import numpy as np
import pytest
from helpers.constructed import make_design, mechanical, quadratic_pendulum, trained_like_pendulum
from helpers.geared import geared
from helpers.oscillators import QUADRATIC, chain, double_well, oscillator, sides, soft_pendulum

from necc_casadi.certificate.claims.certificate import Certificate
from necc_casadi.certificate.prover.certify import certify
from necc_casadi.certificate.prover.invariant_sets import largest_invariant_set_is_critical
from necc_casadi.lyapunov.networks import MonotonePhi


def claim_of(certificate: Certificate, name: str = "region"):
    return {claim.name: claim for claim in certificate.claims}[name]


@pytest.mark.parametrize(
    ("domain", "by_hand", "state"),
    [
        (sides(q1=2, xi1=2, p1=2), 2.0, "p1"),
        (sides(q1=2, xi1=9, p1=9), 3.0, "q1"),
        (sides(q1=9, xi1=2, p1=9), 3.0, "xi1"),
    ],
)
def test_the_level_at_which_a_bound_is_met_is_the_one_known_by_hand(domain, by_hand, state):
    """min V on |q| = 2, |ξ| = 2, |p| = 2 is ½·4·(1 + ½), ½·4·(1 + ½) and 2."""
    certificate = certify(oscillator(domain=domain))
    assert certificate.certified
    assert certificate.obstacle.kind == "domain"
    assert abs(certificate.obstacle.at[state]) == pytest.approx(2.0)
    assert certificate.obstacle.level_above_minimum == pytest.approx(by_hand, rel=1e-6)
    assert 0.99 * by_hand < certificate.level <= by_hand
    assert certificate.is_global  # beside it


def test_a_bound_of_a_momentum_whose_inertia_varies_is_met_where_it_is_lightest():
    """V = q²/2 + q²/4 + p²/2(1 + q²) with |p| ≤ 2.2: least at 1 + q² = 2.2 √(2/3)."""
    plant = mechanical(lambda q, p: p**2 / (2 * (1 + q**2)) + q**2 / 2, 1)
    bounded = dataclasses.replace(plant, domain=sides(p1="11/5"))
    design = make_design(bounded, (0, 0), QUADRATIC, [0, 0, 1.0, 0, 0, 0, 1.0, 0], [0.0])
    certificate = certify(design)
    u = 2.2 * np.sqrt(2 / 3)
    assert certificate.obstacle.kind == "domain"
    assert certificate.obstacle.level_above_minimum == pytest.approx(
        0.75 * (u - 1) + 2.42 / u, rel=1e-3
    )
    assert certificate.obstacle_share > 0.99


def test_how_far_a_quadratic_reaches_is_known_by_hand():
    """|zᵢ| ≤ √(2c(P⁻¹)ᵢᵢ) on ½zᵀPz ≤ c; the fibres of a constant V_ee waste little."""
    design = chain(sides(q1=1.0))
    certificate = certify(design)
    P = design.lyapunov.hessian(np.zeros(7))
    exact = np.sqrt(2 * certificate.level * np.diagonal(np.linalg.inv(P)))
    for half, (lo, hi) in zip(exact, certificate.reach.values(), strict=True):
        assert half <= hi <= 1.05 * half
        assert -1.05 * half <= lo <= -half


def test_another_minimum_ends_the_region_at_the_pass():
    """Double well of depth ¼ at q = ±1: no level above the saddle, and 99 % of it."""
    design = double_well()
    certificate = certify(design)
    obstacle = certificate.obstacle
    assert obstacle.kind == "critical_point"
    saddle = np.array(list(obstacle.at.values()))
    assert np.linalg.norm(design.lyapunov.gradient(saddle)) < 1e-7
    assert np.linalg.eigvalsh(design.lyapunov.hessian(saddle))[0] < 0
    height = design.V(saddle) - design.V(design.z_bar)
    assert obstacle.level_above_minimum == pytest.approx(height, rel=1e-6)
    assert 0.98 * height < certificate.level_above_minimum < height
    assert 0.98 < certificate.obstacle_share < 1


def test_a_pole_of_the_loop_ends_the_region():
    """The gear 1/(3 − q)² has its pole at q = 3, where V is smooth."""
    certificate = certify(geared(lambda q: 1 / (3 - q) ** 2))
    assert certificate.certified
    assert certificate.obstacle.kind == "singularity"
    assert certificate.reach["q1"][1] < 3


def test_a_periodic_orbit_inside_leaves_no_claim_of_convergence():
    """A free rotor beside the oscillator turns for ever: all solutions are bounded, at most."""
    plant = mechanical(lambda q1, q2, p1, p2: (p1**2 + p2**2 + q1**2 + q2**2) / 2, 2, inputs=[0])
    design = make_design(plant, (0, 0, 0, 0), QUADRATIC, [0, 0, 1.0, 0, 0, 0, 1.0, 0], [0.0])
    certificate = certify(design)
    assert certificate.stability is None
    assert not certificate.certified
    assert not claim_of(certificate).holds
    stable = dataclasses.replace(
        design, verdict=dataclasses.replace(design.verdict, stability="stable", witness="q2, p2")
    )
    certificate = certify(stable)
    assert certificate.stability == "stable"
    assert not certificate.is_global
    assert claim_of(certificate, "global").holds
    assert "converges" not in claim_of(certificate, "global").statement
    assert not largest_invariant_set_is_critical(design, design.momenta)


def test_no_region_where_the_local_proof_fails():
    certificate = certify(quadratic_pendulum(k=4, h=-4))
    assert certificate.region is None
    assert not claim_of(certificate).holds


def test_more_states_than_cells_can_cover_are_named():
    """Four wells in a row: none of the four coordinates can be minimised out."""
    plant = mechanical(
        lambda *z: sum((q**2 - 1) ** 2 for q in z[:4]) / 4 + sum(p**2 for p in z[4:]) / 2, 4
    )
    form = dataclasses.replace(QUADRATIC)
    form = type(form)(*(dataclasses.replace(net, inputs=4) for net in (form.hc, form.k)))
    hc, k = ([0] * 5 + [v] * 4 + [c] * 4 for v, c in ((1.0, 0.0), (0.01, 1.0)))
    certificate = certify(make_design(plant, [1] * 4 + [0] * 4, form, hc + k, [0.0] * 4))
    assert certificate.region is None
    assert "at most 3 states" in claim_of(certificate).statement


@pytest.mark.parametrize(
    "options", [{"quadratic": False}, {"quadratic": True, "phi": MonotonePhi(4)}], ids=str
)
def test_forms_without_a_floor_keep_every_state(options):
    """Plain networks and a neural Φ: cells of angle and controller state both."""
    design = trained_like_pendulum((8,), **options)
    certificate = certify(design)
    assert certificate.certified
    assert certificate.region.kept == (0, 1)
    assert certificate.region.floor == ()
    assert certificate.obstacle_share > 0.9
    assert certificate.reach["q"][1] - certificate.reach["q"][0] > 2


@pytest.mark.parametrize("hidden", [(16,), pytest.param((64, 64), marks=pytest.mark.slow)])
def test_no_state_of_the_region_leaves_it_and_all_converge(hidden):
    """Many states inside, integrated by RK4 with the closed loop as it is built."""
    design = trained_like_pendulum(hidden)
    certificate = certify(design)
    rng = np.random.default_rng(1)
    lo, hi = np.array(list(certificate.reach.values())).T
    samples = rng.uniform(lo, hi, (800, 3))
    z = np.array([s for s in samples if certificate.contains(design.V, s)])
    assert len(z) > 20
    field, V = design.lyapunov.vector_field, design.lyapunov.V
    before, step = V(z), 0.02
    for _ in range(1500):
        k1 = field(z)
        k2 = field(z + step / 2 * k1)
        k3 = field(z + step / 2 * k2)
        z = z + step / 6 * (k1 + 2 * k2 + 2 * k3 + field(z + step * k3))
        after = V(z)
        assert np.all(after <= before + 1e-6)
        assert np.all((lo <= z) & (z <= hi))
        before = after
    assert np.abs(z - design.z_bar).max() < 0.2


def test_what_lies_beyond_the_pass_is_not_in_the_region():
    """Membership is by the cells of s: below the level, but in another well, is outside."""
    design = double_well()
    certificate = certify(design)
    assert certificate.contains(design.V, design.z_bar)
    other = np.array([-1.0, 0.0, 0.0])
    assert not certificate.contains(design.V, other)
    assert not certificate.region.covers(np.array([[-1.0]]))[0]
    high = design.z_bar + np.array([0.0, 3.0, 0.0])
    assert not certificate.contains(design.V, high)


def test_the_region_does_not_depend_on_the_box_of_the_picture():
    """A domain that only says what is drawn must not bind: none is named here."""
    design = soft_pendulum()
    certificate = certify(design)
    assert certificate.obstacle.kind == "critical_point"
    assert certificate.obstacle.at["q"] > np.pi
