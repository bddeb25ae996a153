"""Cells are exact, and the flood from z̄ fills its own well only."""

import numpy as np
from helpers.constructed import make_design, mechanical
from helpers.oscillators import QUADRATIC

from necc_casadi.arrays import Truth
from necc_casadi.certificate.prover.arithmetic.intervals import Interval
from necc_casadi.certificate.prover.arithmetic.potential import Potential
from necc_casadi.certificate.prover.region.grid import Grid, boxes_of, cells_met, flood, make_grid


def test_cells_outside_the_component_but_below_the_level_are_left_out():
    """Two wells of equal depth: the flood fills one of them."""
    plant = mechanical(lambda q, p: p**2 / 2 + (q**2 - 1) ** 2 / 4, 1)
    weights = [0, 0, 1.0, 0.0, 0, 0, 1e-3, 1.0]
    design = make_design(plant, (1, 0), QUADRATIC, weights, [0.0])
    reduced = Potential(design, design.momenta)
    grid = make_grid(np.array([-1.8, -1.0]), np.array([1.8, 1.0]), 64**2)
    at = design.z_bar[[0, 2]]
    found = flood(reduced, grid, Interval(at - 1e-9, at + 1e-9))
    mask: Truth = found.cells
    q = (np.argwhere(mask)[:, 0] + grid.first[0]) * grid.step[0]
    assert q.min() > 0 - grid.step[0]


def test_grid_cells_are_exact():
    grid = make_grid(np.array([-1.9, 0.3]), np.array([2.2, 1.7]), 1000)
    boxes = boxes_of(grid, np.arange(grid.size))
    assert boxes.lo.min(0)[0] >= -1.9
    assert boxes.hi.max(0)[1] <= 1.7
    middle = (boxes.lo[7] + boxes.hi[7]) / 2
    assert cells_met(grid, Interval(middle, middle)).tolist() == [7]
    assert cells_met(Grid((0,), (4,), (1.0,)), Interval(np.array([3.5]), np.array([4.5]))).size == 0
