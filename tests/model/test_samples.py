"""Points that fill a box more evenly than random ones."""

import numpy as np
import pytest

from necc_casadi.model.samples import quasi_random


@pytest.mark.parametrize("d", [1, 3, 15])
def test_points_of_the_unit_cube(d):
    points = quasi_random(200, d, 0)
    assert points.shape == (200, d)
    assert points.min() >= 0
    assert points.max() < 1
    assert not np.array_equal(points, quasi_random(200, d, 1))


def test_every_interval_gets_its_share():
    """Halton points of base 2 and 3: any interval of length 1/8 or 1/9 to within two points."""
    points = quasi_random(720, 2, 3)
    for axis, cells in ((0, 8), (1, 9)):
        counts, _ = np.histogram(points[:, axis], bins=cells, range=(0, 1))
        assert np.abs(counts - 720 / cells).max() <= 2
