"""Designs for a range of a: bounds, and what is proved of each."""

import pytest


def test_the_sweep_keeps_the_bounds_above_the_distance(everything):
    sweep = everything[1]["sweep"]
    assert [point["a"] for point in sweep] == pytest.approx([0.2, 0.5, 0.8])
    for point in sweep:
        assert point["loss"] <= 1e-9
        assert point["distance"] <= point["bound_rigorous"]
        assert point["bound_paper"] == pytest.approx(
            point["loss"] / (point["a"] - point["loss"]), rel=1e-6
        )


def test_the_sweep_says_what_is_proved_and_simulated_for_each_a(everything):
    """No start of the proved region may fail to converge, so it cannot exceed the simulated one."""
    for point in everything[1]["sweep"]:
        assert 0.05 < point["domain_share"] <= point["simulated_share"] + 0.05
        whole = point["domain_share"] == 1
        assert point["limited_by"] is None if whole else "critical point" in point["limited_by"]
