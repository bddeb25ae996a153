"""Components of cells: against a search that compares every pair."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from necc_casadi.certificate.prover.arithmetic.intervals import Interval
from necc_casadi.certificate.prover.region.leaves import Base, _component


def cells(d, seed, rounds):
    """Cells of which random ones were cut, as (depth, index)."""
    rng = np.random.default_rng(seed)
    index = np.stack(np.meshgrid(*[np.arange(4)] * d, indexing="ij"), -1).reshape(-1, d)
    depth = np.zeros(len(index), dtype=int)
    corners = np.stack(np.meshgrid(*[np.arange(2)] * d, indexing="ij"), -1).reshape(-1, d)
    for _ in range(rounds):
        cut = rng.random(len(index)) < 0.3
        smaller = (2 * index[cut][:, None] + corners).reshape(-1, d)
        index = np.concatenate([index[~cut], smaller])
        depth = np.concatenate([depth[~cut], np.repeat(depth[cut] + 1, 2**d)])
    return depth, index


def flooded(boxes, open_, home):
    """The same cells, by comparing each with each."""
    below = boxes.lo[:, None] <= boxes.hi[None]
    above = boxes.hi[:, None] >= boxes.lo[None]
    touching = (below & above).all(-1)
    marked = open_ & home
    while True:
        wider = open_ & (marked | touching[marked].any(0))
        if (wider == marked).all():
            return marked
        marked = wider


@settings(max_examples=25, deadline=None)
@given(
    d=st.integers(1, 3),
    seed=st.integers(0, 10**6),
    share=st.floats(0.2, 0.9),
    side=st.floats(1e-6, 1e6),
)
def test_cells_that_touch_are_connected(d, seed, share, side):
    rng = np.random.default_rng(seed)
    base = Base(rng.normal(size=d) * side, side * rng.uniform(0.5, 2.0, d), 4)
    boxes = base.boxes(*cells(d, seed, 2 if d < 3 else 1))
    open_ = rng.random(len(boxes.lo)) < share
    at = base.lo + base.side * rng.random(d)
    s_bar = Interval(at - 1e-3 * side, at + 1e-3 * side)
    home = ((boxes.lo <= s_bar.hi) & (boxes.hi >= s_bar.lo)).all(1)
    assert (_component(boxes, open_, s_bar) == flooded(boxes, open_, home)).all()


@pytest.mark.parametrize("gap", [0, 1])
def test_a_closed_row_of_cells_parts_two_components(gap):
    boxes = Base(np.zeros(1), np.ones(1), 8).boxes(np.zeros(8, dtype=int), np.arange(8)[:, None])
    open_ = np.ones(8, dtype=bool)
    open_[5] = not gap
    marked = _component(boxes, open_, Interval(np.array([0.1]), np.array([0.1])))
    assert marked.sum() == (5 if gap else 8)
