"""Which stability is within reach."""

import pytest
import sympy as sp
from helpers.symbolic_plants import (
    load,
    verdict_of,
)


@pytest.mark.parametrize(
    ("name", "target", "stability"),
    [
        ("tora", (0, 0, 0, 0), "asymptotic"),
        ("tora", (0, sp.pi / 2, 0, 0), "stable"),
        ("symmetric_chain", (sp.Rational(1, 2), 1, sp.Rational(1, 2), 0, 0, 0), "stable"),
        ("cart_pole", (1, sp.pi, 0, 0), "asymptotic"),
        ("damped_pendulum", (sp.pi / 4, 0), "asymptotic"),
    ],
)
def test_stability_that_the_structure_can_reach(name, target, stability):
    verdict = verdict_of(load(name)[1], target)
    assert verdict.stability == stability
    assert (verdict.witness is None) == (stability == "asymptotic")
