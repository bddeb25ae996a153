"""The sampled loop: Π against what a step does, and {W < w₀} against responses."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from helpers.sampled import (
    held_input,
    limited_around,
    plant_after,
    quick_proofs,
    sampled_step,
    share,
    with_limits,
)
from helpers.velocity import arm
from hypothesis import given
from hypothesis import strategies as st

from necc_casadi.certificate.claims.sampled import walk
from necc_casadi.certificate.prover.arithmetic.affine import (
    Affine,
    affine_matrices,
    negative_definite,
)
from necc_casadi.certificate.prover.arithmetic.intervals import Interval, point
from necc_casadi.certificate.prover.arithmetic.potential import Potential
from necc_casadi.certificate.prover.certify import certify, with_sampled_loop
from necc_casadi.certificate.prover.sampled import prove
from necc_casadi.certificate.prover.sampled.step import Step
from necc_casadi.export.compiled import compile_controller

T = 0.04
#: Designs with Φ = H + Hc + C; a neural Φ is refused in words.
SUMS = ("paper", "default", "joint", "coupled", "beta-sum")


@pytest.fixture(scope="module")
def certified(default_design):
    """Of the part of Ω up to a third of its height, and no longer periods: fewer boxes."""
    with quick_proofs():
        return part_of(default_design, certify(default_design), 1 / 3)


def part_of(design, certificate, share, sample_time=T):
    """With what is proved of the sampled loop up to a share of the height of Ω."""
    part = replace(certificate, level_above_minimum=share * certificate.level_above_minimum)
    return with_sampled_loop(design, part, sample_time, "heun")


def W(design, Q, z):
    g = design.lyapunov.gradient(z)
    return design.lyapunov.V(z) + np.einsum("bi,ij,bj->b", g, Q, g) / 2


def drawn(A, rng):
    """A member of each matrix in affine form, all by the same numbers."""
    e = rng.uniform(-1, 1, (len(A.center), A.parts.shape[1]))
    return e, lambda B: B.center + np.einsum("bk,bkij->bij", e, B.parts)


@given(st.integers(0, 10_000))
def test_products_of_affine_matrices_hold_their_members(seed):
    rng = np.random.default_rng(seed)
    boxes = []
    for symmetric in (True, False):
        middle, radius = rng.normal(size=(4, 3, 3)), rng.uniform(0, 0.5, (4, 3, 3))
        if symmetric:
            middle, radius = (v + v.transpose(0, 2, 1) for v in (middle, radius))
        boxes.append(Interval(middle - radius, middle + radius))
    (A, B), count = affine_matrices(boxes, [True, False])
    assert count == 6 + 9
    _, member = drawn(A, rng)
    a, b = member(A), member(B)
    for made, exact in (
        (A @ B, a @ b),
        (A + B.T, a + b.transpose(0, 2, 1)),
        (A @ B @ A, a @ b @ a),
        ((A @ B).symmetric(), (a @ b + (a @ b).transpose(0, 2, 1)) / 2),
    ):
        assert (np.abs(member(made) - exact) <= made.error).all()
    lowest = np.linalg.eigvalsh((a + a.transpose(0, 2, 1)) / 2)[:, -1]
    assert not (negative_definite(A) & (lowest >= 0)).any()


@given(st.integers(0, 10_000))
def test_what_is_found_definite_is_so_for_the_worst_signs(seed):
    """All signs of five parts; at a size where it is often found, and often not."""
    rng = np.random.default_rng(seed)
    parts = rng.normal(size=(5, 3, 3)) * rng.uniform(0.02, 0.3)
    parts = parts + parts.transpose(0, 2, 1)
    A = Affine(-np.eye(3)[None] * 1.2, parts[None], np.full((1, 3, 3), 1e-3))
    signs = np.array(list(product([-1, 1], repeat=5)))
    worst = np.linalg.eigvalsh(A.center[0] + np.einsum("sk,kij->sij", signs, parts))[:, -1].max()
    assert not negative_definite(A)[0] or worst < 0


def test_parts_that_act_apart_do_not_add_up():
    """−I + diag(±0.9, ±0.9, ±0.9): each alone would leave 0.1, their lengths together exceed 1."""
    parts = 0.9 * np.eye(3)[:, :, None] * np.eye(3)[:, None, :]
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    A = Affine(-np.eye(3)[None], (turn @ parts @ turn.T)[None], np.zeros((1, 3, 3)))
    assert negative_definite(A)[0]
    assert not negative_definite(Affine(A.center, 1.2 * A.parts, A.error))[0]


def test_a_definite_matrix_is_found_definite():
    """−I ± 0.3 in each entry is; −I ± 0.4 may be singular, in (1, 1, 1)."""
    for radius, proved in ((0.3, True), (0.4, False)):
        box = Interval(-np.eye(3)[None] - radius, -np.eye(3)[None] + radius)
        (A,), _ = affine_matrices([box], [True])
        assert bool(negative_definite(A)[0]) is proved


@pytest.mark.parametrize("form", SUMS)
@pytest.mark.parametrize("integrator", ["euler", "heun"])
@pytest.mark.parametrize("width", [0.0, 0.2])
@pytest.mark.parametrize("clipped", [False, True])
def test_the_form_says_what_a_step_does_to_w(designs, form, integrator, width, clipped):
    """W(z⁺) − W(z) = s ∇VᵀΠ∇V, by simulation of plant and controller."""
    design = designs[form].natural
    rng, count = np.random.default_rng(3), 12
    z = design.z_bar + rng.uniform(-0.5, 0.5, (count, design.loop.n))
    if clipped:
        n = design.loop.plant.n
        z[:, n:] = design.z_bar[n:] + 0.1 * (z[:, n:] - design.z_bar[n:])
        design = limited_around(design, z, 0.1)
        asked, held = design.control(z[:, :n], z[:, n:])[0], held_input(design, z)[0]
        assert (asked != held).mean() > 0.2
    s = rng.uniform(0, 0.1, count)
    Q = rng.normal(size=(design.loop.n,) * 2) * 0.2
    Q = Q + Q.T
    shift = rng.uniform(-0.5, 0.5, z.shape) * width
    Z = Interval(z + shift - width / 2, z + shift + width / 2)
    apart = rng.uniform(0, 1, count) * 0.02 * (width > 0)
    period = Interval(np.maximum(s - apart, 0.0), s + 0.02 * (width > 0) - apart)
    sample = Step(Potential(design), integrator).over(Z, period)
    form = sample.form(Q)
    g = design.lyapunov.gradient(z)
    after = sampled_step(design, z, s, integrator)
    change = W(design, Q, after) - W(design, Q, z)
    said = s * np.einsum("bi,bij,bj->b", g, form.center, g)
    parts = np.abs(np.einsum("bi,bkij,bj->bk", g, form.parts, g)).sum(1)
    slack = s * (parts + np.einsum("bi,bij,bj->b", np.abs(g), form.error, np.abs(g)))
    known = ~np.isnan(sample.shares.lo).any(-1)  # a wide box may reach beyond the limits
    assert (np.abs(change - said)[known] <= slack[known] + 1e-12).all()
    if width == 0.0:  # and the enclosure is worth something
        assert known.all()
        assert np.median(slack) < 0.3 * np.median(np.abs(change))


@pytest.mark.parametrize("integrator", ["euler", "heun"])
@pytest.mark.parametrize("coupled", [False, True])
def test_damping_is_scaled_alike_in_all_inputs(integrator, coupled):
    """𝒟 neither symmetric nor, in turns, without a block between the inputs and ξ."""
    design, rng, count = arm(), np.random.default_rng(3), 20
    object.__setattr__(design.loop.plant, "inertia", None)  # the law is fed p
    root, skew = rng.normal(size=(2, 4, 4))
    damping = root @ root.T + np.eye(4) + skew - skew.T
    if not coupled:
        damping[:2, 2:], damping[2:, :2] = 0.0, 0.0
    design = replace(design, damping=damping).natural
    z = design.z_bar + rng.uniform(-0.3, 0.3, (count, 6)) * [1, 1, 1, 1, 0.1, 0.1]
    design = limited_around(design, z, 0.2)
    left = share(design, z)
    assert (left < 0.9).mean() > 0.5
    s = rng.uniform(0, 0.02, count)
    sample = Step(Potential(design), integrator).over(point(z), point(s))
    g, moved = design.lyapunov.gradient(z), sampled_step(design, z, s, integrator) - z
    said = s[:, None] * np.einsum("bij,bj->bi", sample.step.center, g)
    parts = np.abs(np.einsum("bkij,bj->bki", sample.step.parts, g)).sum(1)
    slack = s[:, None] * (parts + np.einsum("bij,bj->bi", sample.step.error, np.abs(g)))
    assert (np.abs(moved - said) <= slack + 1e-12).all()
    assert np.median(slack) < 1e-3 * np.median(np.abs(moved))


def test_nothing_is_said_where_the_law_without_damping_is_beyond_the_limits(default_design):
    design = with_limits(default_design.natural, [(-0.1, 0.1)])  # u holds with 0.7 at z̄
    z = design.z_bar[None]
    sample = Step(Potential(design), "heun").over(Interval(z, z), Interval(*np.zeros((2, 1))))
    assert np.isnan(sample.shares.lo).all()
    assert not negative_definite(sample.form(np.zeros((3, 3)))).any()


def test_the_sampled_loop_is_proved(certified, default_design):
    region, units = certified.sampled, default_design.units
    assert region.period * units.time == T
    assert region.height == pytest.approx(certified.level_above_minimum / units.energy, rel=1e-5)


@pytest.mark.slow
def test_all_of_the_height_of_the_region_is_proved(default_design):
    """W is V at the saddle that ends both regions; and for longer periods than were asked for."""
    certificate = certify(default_design, sample_time=0.02)
    height = certificate.level_above_minimum / default_design.units.energy
    assert certificate.sampled.height > 0.99 * height
    assert certificate.sampled.period * default_design.units.time > 0.05


def test_the_boxes_fill_the_whole(certified):
    region = certified.sampled
    total = sum(
        np.prod([hi - lo for lo, hi in cell]) for cell, _ in walk(region.root, region.nodes)
    )
    assert total == pytest.approx(np.prod([hi - lo for lo, hi in region.root]), rel=1e-12)


def starts(design, region, count, seed=0):
    """States of {W < w₀} in the box, natural units."""
    rng, Q = np.random.default_rng(seed), np.array(region.metric)
    lo, hi = np.array(region.box).T
    found = np.empty((0, len(lo)))
    while len(found) < count:
        z = rng.uniform(lo, hi, (4 * count, len(lo)))
        found = np.vstack([found, z[W(design, Q, z) < region.level]])
    return found[:count]


def test_w_falls_at_every_step_whatever_the_periods(certified, default_design):
    design, region = default_design.natural, certified.sampled
    z, Q = starts(design, region, 200), np.array(region.metric)
    rng = np.random.default_rng(1)
    lo, hi = np.array(region.box).T
    before = W(design, Q, z)
    for _ in range(60):
        s = region.period * rng.uniform(0, 1, len(z)) ** rng.choice([0.2, 1, 4])
        z = sampled_step(design, z, s)
        after = W(design, Q, z)
        assert (after <= before + 1e-12).all()
        assert ((z > lo) & (z < hi)).all()
        before = after


@pytest.fixture(scope="module")
def clipped(default_design):
    """A small region of a design whose damping alone takes u to its limits in it."""
    limited = with_limits(default_design, [(-1.0, 1.0)])
    return limited, up_to(limited, 0.05)


def up_to(design, height):
    """What is proved of the sampled loop up to a height above V(z̄), with no region beside it."""
    certificate = replace(certify(design, region=False), level_above_minimum=height)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(prove, "_TRIALS", 0)
        return with_sampled_loop(design, certificate, 0.01, "heun")


@pytest.mark.slow
def test_clipped_inputs_are_covered(clipped):
    limited, certificate = clipped
    region, design = certificate.sampled, limited.natural
    (claim,) = [c for c in certificate.claims if c.name == "sampled"]
    assert region.clipped
    assert "u is clipped to [-1, 1]" in claim.statement
    z, Q = starts(design, region, 300), np.array(region.metric)
    n = design.loop.plant.n
    assert (design.control(z[:, :n], z[:, n:])[0] != held_input(design, z)[0]).sum() > 10
    rng, before = np.random.default_rng(1), W(design, Q, z)
    for _ in range(20):
        z = sampled_step(design, z, region.period * rng.uniform(0, 1, len(z)))
        after = W(design, Q, z)
        assert (after <= before + 1e-12).all()
        before = after


@pytest.mark.slow
def test_a_small_region_is_found_far_below_a_height_that_is_not_proved(default_design):
    """Damping that is scaled leaves little near the height at which the limits bind."""
    between = 0.4 * np.sqrt(default_design.damping[0, 0] * default_design.damping[1, 1])
    full = replace(
        default_design, damping=default_design.damping + np.array([[0, between], [0, 0]])
    )
    found = up_to(with_limits(full, [(-0.9, 0.9)]), 2.0)
    assert found.sampled.clipped
    assert 0.015 < found.sampled.height * default_design.units.energy < 0.2


@pytest.mark.slow
def test_limits_that_are_never_met_are_said_to_be_kept(default_design):
    found = up_to(with_limits(default_design, [(-20.0, 20.0)]), 0.05)
    (claim,) = [c for c in found.claims if c.name == "sampled"]
    assert not found.sampled.clipped
    assert "u stays within [-20, 20] there" in claim.statement


@pytest.mark.slow
def test_responses_from_the_region_converge(certified, default_design):
    design, region = default_design.natural, certified.sampled
    z, rng = starts(design, region, 50), np.random.default_rng(2)
    for _ in range(1500):
        z = sampled_step(design, z, region.period * rng.uniform(0, 1, len(z)))
    assert np.linalg.norm(z - design.z_bar, axis=1).max() < 1e-3


@pytest.mark.slow
def test_w_falls_in_the_compiled_code_at_samples_and_between(certified, default_design):
    """Periods of 1e-9 of the longest, the longest itself and any other; x in the projection."""
    design, region, units = default_design.natural, certified.sampled, default_design.units
    compiled, n = compile_controller(default_design), design.loop.plant.n
    rng, Q, (lo, hi) = np.random.default_rng(5), np.array(region.metric), np.array(region.box).T

    def sampled(z, s):
        made = [compiled.step(row[n:], row[:n], dt) for row, dt in zip(z, s, strict=True)]
        u, xi = (np.array([one[k] for one in made]) for k in (0, 1))
        return np.hstack([plant_after(default_design, z[:, :n], u, s), xi])

    z = starts(design, region, 400) * units.state
    before = W(design, Q, z / units.state)
    for _ in range(60):
        shares = rng.uniform(size=len(z))
        kinds = (np.full(len(z), 1e-9), np.ones(len(z)), shares, shares**6)
        s = region.period * units.time * np.choose(rng.integers(0, 4, len(z)), kinds)
        for each in (sampled(z, s * rng.uniform(size=len(z))), z := sampled(z, s)):
            seen = each / units.state
            assert (W(design, Q, seen) <= np.minimum(before + 1e-12, region.level)).all()
            assert ((seen > lo) & (seen < hi)).all()
        before = W(design, Q, z / units.state)


def test_nothing_is_proved_of_periods_beyond_the_stable_ones(default_design):
    with quick_proofs():
        found = certify(default_design, sample_time=50.0)
    (claim,) = [c for c in found.claims if c.name == "sampled"]
    assert not claim.holds
    assert found.sampled is None


def test_what_is_not_covered_is_said(default_design, designs):
    neural = certify(designs["neural"], region=False, sample_time=0.01)
    others = (
        certify(default_design, region=False, sample_time=0.01, integrator=integrator)
        for integrator in ("rk4", "casimir")
    )
    for found, why in ((neural, "Φ = H + Hc + C"), *((other, "Heun") for other in others)):
        (claim,) = [c for c in found.claims if c.name == "sampled"]
        assert not claim.holds
        assert why in claim.statement


def test_a_design_that_does_not_decrease_has_no_sampled_claim(default_design):
    broken = replace(default_design, damping=-default_design.damping)
    (claim,) = [
        c for c in certify(broken, region=False, sample_time=0.01).claims if c.name == "sampled"
    ]
    assert not claim.holds
