"""w(s) = min V(s, ·): random points lie in its enclosures, whatever the hints were."""

import numpy as np
import pytest
from flint import arb
from helpers.constructed import EXAMPLES, trained_like_pendulum
from hypothesis import given, settings
from hypothesis import strategies as st

from necc_casadi import Options, find_casimirs, judge, load_model
from necc_casadi import design as synthesised
from necc_casadi.certificate.checker.arithmetic.potential import Energy
from necc_casadi.certificate.checker.model import StoredDesign
from necc_casadi.certificate.checker.region.reduced import Reduced as InBalls
from necc_casadi.certificate.prover.arithmetic.intervals import Interval
from necc_casadi.certificate.prover.arithmetic.potential import Potential
from necc_casadi.certificate.prover.region import reduced as module
from necc_casadi.certificate.prover.region.landscape import Landscape, Minima
from necc_casadi.certificate.prover.region.split import Splits
from necc_casadi.model.target import target_from_model


def made(name):
    model = load_model(EXAMPLES / f"{name}.py")
    target = target_from_model(model.loop.plant, model.target)
    casimirs = find_casimirs(model.loop, model.casimirs, target)
    verdict = judge(model.loop, casimirs, target)
    return synthesised(model.loop, casimirs, verdict, target, Options()).natural


@pytest.fixture(scope="module", params=["pendulum", "dc_motor", "two_link_arm"])
def reduced(request):
    if request.param == "pendulum":
        design = trained_like_pendulum((16,), quadratic=True)
    else:
        design = made(request.param)
    potential = Potential(design, design.momenta)
    around = design.domain.of(potential.active)
    found = next(Splits(potential).candidates(Interval(around.lo, around.hi)))
    assert found.kept
    assert found.gone
    return found


def inner(reduced, cells, seed, count=20):
    """Random points of each cell and w, ∇w, ∇²w, ε there, by Newton's method."""
    rng = np.random.default_rng(seed)
    shares = rng.uniform(size=(count, *cells.shape))
    s = (cells.lo + shares * (cells.hi - cells.lo)).reshape(-1, cells.shape[1])
    return Landscape.minima(reduced.landscape, s)


def cells_of(reduced, width, seed, count=8):
    rng = np.random.default_rng(seed)
    design, kept = reduced.potential.design, list(reduced.kept)
    around = design.domain.of(reduced.potential.active)
    lo, hi = around.lo[kept], around.hi[kept]
    middle = lo + rng.uniform(0.2, 0.8, (count, len(kept))) * (hi - lo)
    half = width * (hi - lo) / 2
    return Interval(middle - half, middle + half)


def assert_inside(cover, found, count):
    """Every enclosure holds what was found in its cell."""
    rows = np.tile(np.arange(len(cover.ok)), count)
    slack = 1e-7
    good = cover.ok[rows]
    for name, values in (("w", found.w), ("grad", found.grad), ("e", found.e)):
        box = getattr(cover, name)
        lo, hi = box.lo[rows][good], box.hi[rows][good]
        assert (lo - slack <= values[good]).all(), name
        assert (values[good] <= hi + slack).all(), name
    low = cover.schur.mid[rows][good] - (cover.schur.hi - cover.schur.lo)[rows][good]
    width = np.abs(cover.schur.hi - cover.schur.lo)[rows][good].sum((-1, -2))
    gap = np.linalg.eigvalsh(found.hess[good] - cover.schur.mid[rows][good])[:, 0]
    assert (gap >= -width - slack).all()
    assert low.shape == found.hess[good].shape


@pytest.mark.parametrize("width", [0.05, 0.02, 0.005])
def test_random_points_lie_in_the_enclosures(reduced, width):
    cells = cells_of(reduced, width, 1)
    cover = reduced.cover(cells)
    assert cover.ok.any()
    assert_inside(cover, inner(reduced, cells, 2), 20)


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 1000), off=st.floats(0, 0.3))
def test_wrong_hints_widen_the_enclosures_and_nothing_else(reduced, seed, off):
    """The sheet is where floating point says, right or not: a liar must not make a proof wrong."""
    rng = np.random.default_rng(seed)
    cells = cells_of(reduced, 0.05, seed)
    truth = inner(reduced, cells, seed)

    def lying(self, s, start=None):
        found = honest(self, s, start)
        e = found.e + off * rng.uniform(-1, 1, found.e.shape)
        tangent = found.tangent + off * rng.uniform(-1, 1, found.tangent.shape)
        return Minima(e, tangent, found.w, found.grad, found.hess)

    honest = Landscape.minima
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module.Landscape, "minima", lying)
        cover = reduced.cover(cells)
    assert_inside(cover, truth, 20)


def test_the_enclosure_of_w_errs_by_the_third_power_of_the_width(reduced):
    """Halving a cell divides what is lost below the least w on it by about eight."""
    losses = []
    for width in (0.04, 0.02, 0.01):
        cells = cells_of(reduced, width, 3)
        cover, found = reduced.cover(cells), inner(reduced, cells, 4, 400)
        least = found.w.reshape(400, -1).min(0)
        losses.append(np.median((least - cover.w.lo)[cover.ok]))
    assert losses[2] < losses[0] / 6  # sampling leaves a part that falls with the width alone


def test_maker_and_checker_enclose_the_same(reduced):
    """Both hold w at random points; neither is much wider than the other."""
    import json

    design, kept = reduced.potential.design, reduced.kept
    energy = Energy(StoredDesign(json.loads(design.text)), reduced.potential.active)
    start = design.z_bar[list(reduced.potential.active)].tolist()
    balls = InBalls(energy, kept, [tuple(map(float, row)) for row in reduced.floor], start)
    cells = cells_of(reduced, 0.02, 5)
    cover, found = reduced.cover(cells), inner(reduced, cells, 6)
    for k in range(len(cells.lo)):
        box = tuple(zip(cells.lo[k].tolist(), cells.hi[k].tolist(), strict=True))
        other = balls.cover(box)
        if other is None or not cover.ok[k]:
            continue
        values = found.w.reshape(20, -1)[:, k]
        assert bool(other.low <= arb(float(values.min())) + 1e-7)
        assert float(other.low) == pytest.approx(cover.w.lo[k], abs=2 * np.ptp(values) + 1e-6)
        assert bool(other.low > cover.w.lo[k] - 2 * (cover.w.hi - cover.w.lo)[k] - 1e-6)
